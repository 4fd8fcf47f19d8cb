"""Runs in another Python: how it is made, found, and kept apart."""

from __future__ import annotations

import json
import os
import sys
import venv
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from gpusimbench.recorder.environments.choice import check_known, interpreter_for
from gpusimbench.recorder.environments.interpreter import Interpreter, at, own
from gpusimbench.recorder.environments.setup import set_up, size_of
from gpusimbench.recorder.environments.store import (
    FOLDER_VARIABLE,
    SPECIFICATIONS,
    Prepared,
    Specification,
    find,
    folder_of,
    prepared,
)
from gpusimbench.recorder.simulators.registry import BUILT_IN, Entry
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.conftest import SMALL, Command, finished

specifications = pytest.mark.parametrize("specification", SPECIFICATIONS.values(), ids=lambda s: s.simulator)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for environments."""
    place = tmp_path / "environments"
    monkeypatch.setenv(FOLDER_VARIABLE, str(place))
    return place


@pytest.fixture(scope="module")
def borrowing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment that has the packages of this one, but not this project."""
    place = tmp_path_factory.mktemp("borrowing") / "env"
    venv.create(place, with_pip=False, symlinks=True)
    site = next(place.glob("lib/python*/site-packages"))
    theirs = next(Path(path) for path in sys.path if path.endswith("site-packages"))
    for package in theirs.iterdir():
        if not package.name.startswith(("__editable__", "gpusimbench", "_virtualenv")) and package.suffix != ".pth":
            (site / package.name).symlink_to(package)
    return place


def _make(simulator: str, python: Path, requirements: str = "") -> Prepared:
    # an environment as set_up leaves it, without an installation
    folder = folder_of(simulator)
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "python").symlink_to(python)
    if (cfg := python.parent.parent / "pyvenv.cfg").exists():
        (folder / "pyvenv.cfg").symlink_to(cfg)
        (folder / "lib").symlink_to(cfg.parent / "lib")
    made = Prepared(
        simulator=simulator,
        requirements=requirements or SPECIFICATIONS[simulator].sha256(),
        python="3.11.0",
        versions={"numpy": "2.0"},
        size=1_500_000_000,
        created="2026-01-01T00:00:00Z",
    )
    made.write()
    return made


@specifications
def test_requirements_are_pinned_and_hashed(specification: Specification) -> None:
    """Pin every requirement of an environment, with a hash, without an index."""
    text = specification.requirements.read_text()
    lines = [line for line in text.replace("\\\n", " ").splitlines() if line and not line.startswith("#")]
    assert lines
    for line in lines:
        requirement = Requirement(line.partition("--hash=")[0].strip())
        assert [s.operator for s in requirement.specifier] == ["=="], line
        assert "--hash=sha256:" in line
    assert "://" not in text


@specifications
def test_requirements_are_those_asked_for(specification: Specification) -> None:
    """Have every requirement of the .in file in the .txt file, at its version."""
    given = [Requirement(line) for line in _lines(specification.requirements.with_suffix(".in"))]
    pinned: dict[str, set[str]] = {}
    for line in _lines(specification.requirements):
        requirement = Requirement(line.partition(" \\")[0])
        pinned.setdefault(requirement.name, set()).add(next(iter(requirement.specifier)).version)
    assert given
    for requirement in given:
        assert any(requirement.specifier.contains(version) for version in pinned[requirement.name]), requirement


def _lines(path: Path) -> list[str]:
    lines = (line.strip() for line in path.read_text().splitlines())
    return [line for line in lines if line and not line.startswith(("#", "--"))]


@specifications
def test_environments_are_for_simulators(specification: Specification) -> None:
    """Tell users of a simulator with an environment how to set it up."""
    entry = next(entry for entry in BUILT_IN if entry.name == specification.simulator)
    assert f"gsb-record --setup {entry.name}" in entry.install


def test_an_engine_of_this_python_needs_no_other(folder: Path) -> None:
    """Take this Python where it has what a simulator needs."""
    assert interpreter_for(Entry("here", "", "x:Y", requires=("json",))) == own()


def test_a_prepared_environment_is_found(
    folder: Path, borrowing: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Take a simulator's environment where this Python lacks its engine, and say nothing of it."""
    made = _make("genesis", borrowing / "bin" / "python")
    assert find("genesis") == made
    assert [p.simulator for p in prepared()] == ["genesis"]
    monkeypatch.setattr(Entry, "missing", lambda self: ("json",))
    assert interpreter_for(Entry("genesis", "", "x:Y", requires=("json",))).python == made.interpreter
    assert capsys.readouterr().err == ""


def test_an_environment_that_lost_something_is_made_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Name what an environment lacks and how to mend it, and mend it so."""
    made = _make("sapien", Path(sys.executable))
    away = Entry("sapien", "", "x:Y", requires=("an_engine_that_is_not_there",))
    with pytest.raises(UsageError, match="any more; gsb-record --setup sapien"):
        interpreter_for(away)
    monkeypatch.setattr(
        "gpusimbench.recorder.environments.setup._make", lambda *_: _make("sapien", Path(sys.executable))
    )
    monkeypatch.setattr("gpusimbench.recorder.environments.setup.find_simulator", lambda name: away)
    (made.folder / "old").touch()
    set_up("sapien")
    assert not (made.folder / "old").exists()


@pytest.mark.parametrize("kind", ["folder", "link", "file"])
def test_what_is_no_environment_stays(folder: Path, tmp_path: Path, kind: str) -> None:
    """Refuse to make an environment where something else lies, and leave that alone."""
    folder.mkdir()
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "notes").write_text("mine")
    match kind:
        case "folder":
            (tmp_path / "precious").rename(folder / "sapien")
        case "link":
            (folder / "sapien").symlink_to(tmp_path / "precious")
        case "file":
            (folder / "sapien").write_text("mine")
    with pytest.raises(UsageError, match="no environment that gsb-record made"):
        set_up("sapien", Path(sys.executable))
    kept = folder / "sapien" if kind == "file" else folder / "sapien" / "notes"
    assert kept.read_text() == "mine"


def test_a_failed_installation_brings_the_old_one_back(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep an environment of other requirements where the new one cannot be made."""
    made = _make("sapien", Path(sys.executable), requirements="0" * 64)

    def fail(*_: object) -> None:
        made.folder.mkdir()
        raise GsbError("no network")

    monkeypatch.setattr("gpusimbench.recorder.environments.setup._make", fail)
    with pytest.raises(GsbError, match="no network"):
        set_up("sapien")
    assert find("sapien") == made
    assert [path.name for path in folder.iterdir() if path.is_dir()] == ["sapien"]


def test_a_folder_of_an_engine_s_name_is_no_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for engines neither in the present folder nor in folders without a package."""
    (tmp_path / "an_engine").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = Entry("x", "", "x:Y", requires=("an_engine",), install="somehow")
    assert entry.missing() == ("an_engine",)
    assert own().missing(("an_engine",)) == ("an_engine",)


def test_another_python_has_to_know_what_is_added(borrowing: Path) -> None:
    """Refuse a Python that lacks a third party's scene or simulator before any run is made of it."""
    other = at(borrowing)
    check_known(other, "mujoco", "free-fall")
    with pytest.raises(UsageError, match="install the package there too: there is no scene 'theirs'"):
        check_known(other, "mujoco", "theirs")
    with pytest.raises(UsageError, match="there is no simulator 'theirs'"):
        check_known(other, "theirs", "free-fall")


def test_an_engine_that_is_nowhere_says_how_to_get_it(folder: Path) -> None:
    """Say how to set an environment up where there is none."""
    entry = Entry("genesis", "", "x:Y", requires=("an_engine_that_is_not_there",), install="gsb-record --setup genesis")
    with pytest.raises(UsageError, match="an_engine_that_is_not_there.*gsb-record --setup genesis"):
        interpreter_for(entry)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"simulator": "sapien"}', "\x00"])
def test_an_unfinished_environment_is_none(folder: Path, text: str) -> None:
    """Overlook an environment whose making was cut short."""
    made = _make("genesis", Path(sys.executable))
    (made.folder / "gsb-environment.json").write_text(text)
    assert find("genesis") is None


def test_an_environment_of_other_requirements_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], borrowing: Path
) -> None:
    """Use an environment that an older version made, and say that it is one."""
    made = _make("genesis", borrowing / "bin" / "python", requirements="0" * 64)
    assert not made.current
    absent = Entry("genesis", "", "x:Y", requires=("pip",))
    monkeypatch.setattr(Entry, "missing", lambda self: ("pip",))
    assert interpreter_for(absent).python == made.interpreter
    assert "other requirements" in capsys.readouterr().err


def test_the_user_s_python_goes_first(borrowing: Path) -> None:
    """Take the Python that the user names, a virtual environment's folder too."""
    entry = Entry("here", "", "x:Y", requires=("json",))
    assert interpreter_for(entry, borrowing).python == borrowing / "bin" / "python"
    assert interpreter_for(entry, borrowing / "bin" / "python").python == borrowing / "bin" / "python"


def test_a_python_without_the_engine_is_refused(borrowing: Path) -> None:
    """Name what the user's Python lacks."""
    entry = Entry("away", "", "x:Y", requires=("an_engine_that_is_not_there",))
    with pytest.raises(UsageError, match="cannot record 'away': it has no an_engine_that_is_not_there"):
        interpreter_for(entry, borrowing)


def test_a_python_without_what_records_says_how_to_get_it(tmp_path: Path) -> None:
    """Give the command that installs, by the names of packages, into the Python that the user named."""
    venv.create(tmp_path, with_pip=False, symlinks=True)
    with pytest.raises(UsageError) as refused:
        interpreter_for(Entry("here", "", "x:Y", requires=("json",)), tmp_path)
    command = f"{tmp_path / 'bin' / 'python'} -m pip install protobuf lz4 mcap numpy psutil zstandard"
    assert str(refused.value).endswith(f"; {command}")


@pytest.mark.parametrize("path", ["/nowhere/python", "/dev/null", "/bin/false", "/bin/true", "no-such-python"])
def test_what_is_no_python_is_refused(path: str) -> None:
    """Refuse a --python that does not run, in one sentence."""
    with pytest.raises(UsageError, match="no Python that runs"):
        at(Path(path))


def test_another_python_gets_our_code_and_nothing_else(borrowing: Path, tmp_path: Path) -> None:
    """Import gpusimbench from here, and no other package of this Python."""
    other = Interpreter(borrowing / "bin" / "python")
    code = "import gpusimbench.recorder, gpusimbench.schemas; print(gpusimbench.__file__); import importlib.util as u; "
    code += "print(u.find_spec('recorder'), u.find_spec('tests'))"
    done = finished(other.command("-c", code), env=other.environment(tmp_path))
    where, others = done.stdout.splitlines()
    assert where.startswith(str(tmp_path))
    assert others == "None None"
    assert other.software()["python"] == sys.version.split()[0]


def test_records_in_another_python(borrowing: Path, tmp_path: Path, gsb_record: Command, gsb_eval: Command) -> None:
    """Make runs in a Python that does not have this project, whole from command to table."""
    gsb_record(
        "--sim", "mujoco", "--python", borrowing, "--n-env", 2, "--runs", 1, *SMALL, "--out", tmp_path / "out", code=0
    )
    gsb_eval(*(tmp_path / "out").glob("*.mcap"), "--sample-time", 1, code=0)


def test_a_sweep_goes_on_in_the_same_python_only(borrowing: Path, tmp_path: Path, gsb_record: Command) -> None:
    """Find a sweep's runs again by the packages of the Python that makes them."""
    sweep = ("--sim", "mujoco", "--python", borrowing, "--sweep", "1..1", "--runs", 1, *SMALL, "--json")
    for found in (False, True):
        done = gsb_record(*sweep, "--out", tmp_path, code=0)
        assert [run["found"] for run in json.loads(done.stdout)["runs"]] == [found]


def test_conformance_runs_in_another_python(borrowing: Path, tmp_path: Path) -> None:
    """Check an adapter in the Python that has its engine."""
    command = [sys.executable, "-m", "gpusimbench.recorder.conformance", "--sim", "mujoco", "--json"]
    done = finished([*command, "--python", str(borrowing)])
    assert {check["outcome"] for check in json.loads(done.stdout)["checks"]} <= {"ok", "skipped"}


def test_conformance_asks_once(borrowing: Path, tmp_path: Path) -> None:
    """Check in the Python that was named, though it goes by another name in there."""
    wrapper = tmp_path / "python"
    wrapper.write_text(f'#!/bin/sh\nexec {borrowing}/bin/python "$@"\n')
    wrapper.chmod(0o755)
    command = [sys.executable, "-m", "gpusimbench.recorder.conformance", "--sim", "mujoco", "--option", "no=1"]
    done = finished([*command, "--python", str(wrapper)], code=2, timeout=300)
    assert "has no option 'no'" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [("--setup", "sapien", "--sim", "mujoco"), ("--list", "--setup", "sapien"), ("--list", "--python", "x"),
     ("--sim", "real", "--python", "x")],
)  # fmt: skip
def test_one_command_at_a_time(folder: Path, gsb_record: Command, arguments: tuple[str, ...]) -> None:
    """Refuse what would be ignored."""
    done = gsb_record(*arguments, code=2)
    assert not done.stdout
    assert not folder.exists()


def test_list_shows_environments(folder: Path, gsb_record: Command) -> None:
    """Show where an environment lies, its versions and its size."""
    _make("genesis", Path(sys.executable))
    done = gsb_record("--list", env={**os.environ})
    assert f"environment: {folder}/genesis (1.50 GB; Python 3.11.0)" in done.stdout
    assert "packages: numpy 2.0" in done.stdout
    listed = json.loads(gsb_record("--list", "--json").stdout)["simulators"]
    environment = next(about for about in listed if about["name"] == "genesis")["environment"]
    assert environment["size_bytes"] == 1_500_000_000
    assert environment["current"]


def test_there_is_nothing_to_set_up_for_others(folder: Path, gsb_record: Command) -> None:
    """Name the simulators that have an environment."""
    done = gsb_record("--setup", "mujoco", code=2)
    assert "genesis" in done.stderr
    assert not folder.exists()


def test_set_up_wants_a_python_that_fits(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a Python for which the requirements were not made."""
    monkeypatch.setitem(SPECIFICATIONS, "sapien", Specification("sapien", pythons=(99,)))
    with pytest.raises(UsageError, match=r"'sapien' wants 3\.99"):
        set_up("sapien", Path(sys.executable))
    with pytest.raises(UsageError, match=r"is of Python 3\.99, and none is on PATH"):
        set_up("sapien")
    assert find("sapien") is None


@pytest.mark.slow
def test_a_failed_installation_leaves_nothing(folder: Path, gsb_record: Command, tmp_path: Path) -> None:
    """Remove an environment whose installation failed, and say why it did."""
    nothing = {**os.environ, "PIP_INDEX_URL": "file:///nowhere", "PIP_FIND_LINKS": "", "PIP_RETRIES": "0"}
    nothing |= {"UV_OFFLINE": "1", "UV_CACHE_DIR": str(tmp_path / "cache"), "PIP_CONFIG_FILE": os.devnull}
    done = gsb_record("--setup", "sapien", env=nothing, code=1)
    assert "failed" in done.stderr
    assert not (folder / "sapien").exists()


def test_size_counts_files_not_links(tmp_path: Path) -> None:
    """Count the bytes of files once."""
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert size_of(tmp_path) == 5
