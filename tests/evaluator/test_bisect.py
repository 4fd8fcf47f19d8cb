"""gsb-bisect: the search by halves, what it is asked of, and real recordings of environments that are there already."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.bisect.bisection import Bisection, bisect_document, most, search, verdict_of
from gpusimbench.evaluator.bisect.environment import (
    RECORDING,
    NotInstalled,
    between,
    environment_of,
    releases,
    with_options,
)
from gpusimbench.evaluator.bisect.predicates import ReleaseVerdict, first_number, predicate_of
from gpusimbench.evaluator.compute.recorder import about
from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.recorder.simulators.registry import BUILT_IN
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.conftest import call
from tests.synthetic import grid, write_recording

ROOT = Path(__file__).resolve().parent.parent.parent


@given(st.data())
def test_finds_the_change(data: st.DataObject) -> None:
    """Name the first release that differs, with at most ceil(log2 n) + 2 recordings."""
    count = data.draw(st.integers(2, 300))
    change = data.draw(st.integers(1, count - 1))
    asked = [0]

    def judge(index: int) -> bool:
        assert index not in asked
        asked.append(index)
        return index >= change

    found = search(count, judge)
    assert (found.same, found.different, found.skipped) == (change - 1, change, ())
    assert asked[1] == count - 1
    assert len(asked) <= most(count)
    assert most(count) == 2 + min(k for k in range(10) if 2**k >= count)


@given(st.lists(st.sampled_from([True, False, None]), min_size=1, max_size=60))
def test_any_verdicts(verdicts: list[bool | None]) -> None:
    """End with two releases that were judged, and nothing but skipped ones between them, whatever is in between."""
    judged = [False, *verdicts, True]
    asked = []

    def judge(index: int) -> bool | None:
        asked.append(index)
        return judged[index]

    found = search(len(judged), judge)
    assert found.different is not None
    assert (judged[found.same], judged[found.different]) == (False, True)
    assert found.skipped == tuple(range(found.same + 1, found.different))
    assert all(judged[index] is None for index in found.skipped)
    assert len(asked) == len(set(asked))


def test_nothing_to_find() -> None:
    """Ask the last release alone where it does not differ, or cannot be judged."""
    assert search(9, lambda index: False).different is None
    unknown = search(9, lambda index: None)
    assert (unknown.different, unknown.skipped) == (None, (8,))


def test_releases_in_between() -> None:
    """Take releases from good to bad, and refuse those that do not exist or are in the wrong order."""
    known = ("3.2.0", "3.2.1", "3.3.0", "3.10.0")
    assert between(known, "3.2.1", "3.10.0") == known[1:]
    with pytest.raises(UsageError, match="not later"):
        between(known, "3.10.0", "3.2.1")
    with pytest.raises(UsageError, match="--bad 3.1.0: there is no such release; there are 3.2.0 to 3.10.0"):
        between(known, "3.2.0", "3.1.0")


def test_options_that_releases_share() -> None:
    """Ask for the path that all releases have, unless the user says otherwise."""
    assert with_options(("cone=pyramidal",), {"stepping": "mj_step"}) == ("stepping=mj_step", "cone=pyramidal")
    assert with_options(("stepping=batch",), {"stepping": "mj_step"}) == ("stepping=batch",)


def _shipped(name: str) -> list[Recording]:
    return [Recording(str(ROOT / "recordings" / f"mujoco-{name}.mcap"))]


def test_states() -> None:
    """Tell recordings whose states differ from those whose states do not, and say by how much."""
    judge = predicate_of("states")
    assert judge(_shipped("amd-r0"), _shipped("amd-r1")) == ReleaseVerdict(False, "all states are bit-identical")
    found = judge(_shipped("amd-r0"), _shipped("pyramidal-r0"))
    assert found.different
    one, another = (
        np.concatenate([np.asarray(run.state(group, "position")) for group in ("ball", "cubes")], axis=2)
        for (run,) in (_shipped("amd-r0"), _shipped("pyramidal-r0"))
    )  # [step, env, body, 3]
    fell = np.logical_or.accumulate(np.minimum(one, another)[..., 2] < 0.02)  # the top of the board
    apart = np.where(fell, 0.0, np.linalg.norm(one - another, axis=-1)).max(axis=(1, 2))
    assert found.evidence.startswith(
        f"from step 1 on; bodies up to {100 * apart.max():.3g} cm apart at {apart.argmax() / 100:g} s, "
        f"without {fell[-1].sum()} bodies that fell off the board, 1 mm at {(apart > 1e-3).argmax() / 100:g} s"
    )
    assert "ULP" in first_number(*_shipped("amd-r0"), *_shipped("pyramidal-r0"))
    assert first_number(*_shipped("amd-r0"), *_shipped("amd-r1")) == ""
    noisy = [*_shipped("amd-r0"), *_shipped("pyramidal-r0")]
    assert judge(noisy, noisy).different is None
    late = [*_shipped("amd-r0"), *_shipped("amd-r1"), *_shipped("pyramidal-r0")]
    assert judge(late, late).different is None  # not the second run, but the third differs


def test_states_between_recorded_ones(tmp_path: Path) -> None:
    """Say that steps between the last equal states and the first that differ are not known, where no hashes tell."""

    def at(step: int, since: int, dtype: str) -> Any:
        positions = grid(3).astype(dtype)
        positions[1, 4, 0] += step >= since
        return positions

    one, another = (
        Recording(
            write_recording(
                tmp_path, at(30, since, dtype), steps=30, stride=10, name=f"{dtype}.mcap",
                path_of=lambda _, step, since=since, dtype=dtype: at(step, since, dtype),
            )
        )
        for dtype, since in (("float64", 99), ("float32", 13))
    )  # fmt: skip
    found = predicate_of("states")([one], [another])
    assert found.evidence == (
        "from step 20 on; equal up to step 10, no step in between is known; bodies up to 1 m apart at 30 s, "
        "1 mm at 20 s"
    )


@pytest.mark.parametrize(("code", "different"), [(0, False), (1, True), (3, True), (125, None)])
def test_a_command(code: int, different: bool | None) -> None:
    """Take the exit code of a command for its answer, and the last line that it prints for the evidence."""
    text = f"""sh -c 'echo first; echo "$(basename $0) $(basename $1)"; exit {code}'"""
    found = predicate_of(text)(_shipped("amd-r0"), _shipped("amd-r1"))
    assert found == ReleaseVerdict(different, "recordings recordings")


@pytest.mark.parametrize(
    ("command", "message"),
    [("sh -c 'exit 127'", "exit code 127"), ("sh -c 'kill -9 $$'", "exit code -9"), ("/no/such", "cannot start")],
)
def test_a_command_that_does_not_run(command: str, message: str) -> None:
    """Take a command that cannot be run, or is killed, for no answer."""
    with pytest.raises(GsbError, match=message):
        predicate_of(command)(_shipped("amd-r0"), _shipped("amd-r1"))


@pytest.mark.slow
def test_gsb_compare(tmp_path: Path) -> None:
    """Take the verdict of gsb-compare, in its own words."""
    sets = []
    for name in ("amd", "xeon", "pyramidal"):
        (tmp_path / name).mkdir()
        for path in sorted((ROOT / "recordings").glob(f"mujoco-{name}-*.mcap")):
            shutil.copyfile(path, tmp_path / name / path.name)
        sets.append([Recording(str(path)) for path in sorted((tmp_path / name).iterdir())])
    for other in sets[1:]:
        found = predicate_of("gsb-compare")(sets[0], other)
        done = call("gsb-compare", Path(str(sets[0][0].path)).parent, Path(str(other[0].path)).parent)
        assert found.different == {0: False, 4: True, 5: None}[done.returncode]
        assert done.stdout.startswith(found.evidence[:40])


def _found(**other: object) -> Bisection:
    changed = (Setting("mujoco", "1", "2"), Setting("mujoco-core", "(not set)", "2"), Setting("numpy", "2.0", "2.1"))
    given = {
        "package": "mujoco", "simulator": "mujoco", "scene": "franka", "predicate": "states", "options": (),
        "versions": ("1", "1.5", "2"),
        "tested": {"1.5": ReleaseVerdict(False, "same"), "2": ReleaseVerdict(True, "step 1")},
        "files": {}, "same": "1.5", "different": "2", "skipped": (), "step": "step 3", "first": "step 3, x",
        "packages": changed,
        "settings": (),
    }  # fmt: skip
    return Bisection(**{**given, **other})  # type: ignore[arg-type]


def test_several_packages_changed(capsys: pytest.CaptureFixture[str]) -> None:
    """Say so where the first release that differs came with other packages."""
    print_document(bisect_document(_found()), sys.stdout)
    said = " ".join(capsys.readouterr().out.split())
    assert "mujoco 2 is the first release whose states in franka differ from those of 1." in said
    assert "several packages changed at once: mujoco 1 to 2, mujoco-core (not set) to 2, numpy 2.0 to 2.1" in said
    assert "1.5 to 2 step 3 first number step 3, x" in said
    skipped = verdict_of(_found(same="1", skipped=("1.5",)))
    assert skipped == "The states in franka changed after mujoco 1 and up to 2; 1.5 could not be judged."


def test_one_run_of_an_engine_that_nothing_shows_to_repeat_itself() -> None:
    """Say that runs of one release may differ as well, unless two runs, or two releases, have the same states."""
    told = "Whether runs of one release differ as well is not known: --runs 2 tells."
    differing = {"1.5": ReleaseVerdict(True, "step 1"), "2": ReleaseVerdict(True, "step 1")}
    once = dict.fromkeys(("1", "1.5", "2"), ("a.mcap",))
    assert told in verdict_of(_found(tested=differing, files=once, same="1", different="1.5"))
    twice = dict.fromkeys(once, ("a.mcap", "b.mcap"))
    assert told not in verdict_of(_found(tested=differing, files=twice, same="1", different="1.5"))
    assert told not in verdict_of(_found(files=once))
    assert told not in verdict_of(_found(tested=differing, files=once, predicate="gsb-compare"))


def _arguments(out: Path, *environments: str) -> list[object]:
    given = [f"--environment={name}={sys.executable}" for name in environments]
    return ["--sim", "mujoco", "--scene", "free-fall", "--n-env", "2", "--steps", "20", "--out", out, *given]


@pytest.mark.slow
def test_environments_that_are_the_same(tmp_path: Path) -> None:
    """Record two environments once, by mj_step, and find that nothing differs."""
    arguments = _arguments(tmp_path / "out", "one", "other")
    done = call("gsb-bisect", *arguments, code=5)
    assert "mujoco other does not differ from one in free-fall, judged by states" in " ".join(done.stdout.split())
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.mcap")}
    assert sorted(path.parent.name for path in files) == ["one", "other"]
    assert all(Recording(str(path)).simulation.options["stepping"] == "mj_step" for path in files)  # type: ignore[union-attr]
    assert call("gsb-bisect", *arguments).returncode == 5
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.mcap")} == files
    assert call("gsb-bisect", *arguments, "--runs", "2").returncode == 5
    assert len(list((tmp_path / "out" / "one").iterdir())) == 2
    assert call("gsb-bisect", *arguments).returncode == 5
    assert len(list((tmp_path / "out").rglob("*.mcap"))) == 4
    refused = call("gsb-bisect", *arguments, "--seed", "1", code=2)
    assert "is of another bisection" in refused.stderr


@pytest.mark.slow
def test_a_command_finds_an_environment(tmp_path: Path) -> None:
    """Name the first environment that a command tells apart; skip one that cannot record."""
    judge = tmp_path / "judge.py"
    judge.write_text("import sys\nprint('looked')\nsys.exit(sys.argv[2][-1] >= 'd')\n", encoding="utf-8")
    arguments = _arguments(tmp_path / "out", *"abcdefgh")
    target = tmp_path / "found.json"
    done = call("gsb-bisect", *arguments, "--predicate", f"{sys.executable} {judge}", "--json", target, code=0)
    assert "mujoco d is the first release whose recordings in free-fall differ from those of a." in done.stdout
    assert len(done.stdout.splitlines()) <= 15
    found = json.loads(target.read_text())
    assert (found["same"], found["different"], found["exact"], found["step"]) == (
        "c",
        "d",
        True,
        "all states are bit-identical",
    )
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(found["files"])
    assert len(found["files"]) <= most(8)
    empty = tmp_path / "empty"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", empty], check=True, timeout=300)
    arguments = [f"--environment=c={empty}" if a == f"--environment=c={sys.executable}" else a for a in arguments]
    for path in (tmp_path / "out" / "c").iterdir():
        path.unlink()
    done = call("gsb-bisect", *arguments, "--predicate", f"{sys.executable} {judge}", "--json", target, code=5)
    assert "changed after mujoco b and up to d; c could not be judged" in " ".join(done.stdout.split())


def test_what_no_release_can_do(tmp_path: Path) -> None:
    """Pass on why gsb-record refuses, as wrong usage."""
    done = call("gsb-bisect", *_arguments(tmp_path / "out", "one", "other"), "--option", "stepping=slow", code=2)
    assert "mujoco one cannot be recorded" in done.stderr and "stepping is one of auto, batch, mj_step" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sim", "mujoco"), "name the releases"),
        (("--sim", "mujoco", "--environment", "1=python"), "one --environment is nothing to compare"),
        (("--sim", "mujoco", "--environment", "python"), "VERSION=PATH"),
        (("--sim", "mujoco", "--environment", "1=a", "--environment", "1=b"), "given twice"),
        (("--sim", "mujoco", "--good", "../3", "--bad", "4"), "is no version"),
        (("--sim", "mujoco", "--good", "3", "--bad", "4", "--n-env", "0"), "--n-env is at least 1"),
        (("--sim", "mujoco", "--good", "3", "--bad", "4", "--predicate", "'"), "--predicate is no command"),
        (("--sim", "mujoco", "--good", "3", "--bad", "4", "--predicate", ""), "--predicate is empty"),
        (("--sim", "mujco", "--environment", "1=a", "--environment", "2=b"), "did you mean 'mujoco'"),
        (("--sim", "madrona", "--good", "1", "--bad", "2"), "pip has no releases of madrona"),
    ],
)
def test_wrong_usage(arguments: tuple[str, ...], message: str) -> None:
    """Refuse what cannot be before anything is installed or recorded."""
    done = call("gsb-bisect", *arguments, code=2)
    assert message in done.stderr


@pytest.mark.parametrize(("simulator", "package"), [("warp", "mujoco-warp"), ("mjx", "mujoco-mjx"), ("brax", "brax")])
def test_pip_is_asked_for_the_engine(simulator: str, package: str) -> None:
    """Install the distribution that the engine's module is of, which other names on the index are not."""
    (engine,) = (entry for entry in BUILT_IN if entry.name == simulator)
    assert engine.adapter().distribution == about(simulator)["distribution"] == package
    files = [str(file) for file in metadata.files(package) or []]
    assert any(file.startswith(engine.requires[-2].replace(".", "/")) for file in files)


def _wheel(folder: Path, name: str, version: str) -> None:
    # the smallest that pip installs: a module and what it is
    about = f"{name}-{version}.dist-info"
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{name}.py", f"VERSION = {version!r}\n")
        wheel.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        wheel.writestr(
            f"{about}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        wheel.writestr(f"{about}/RECORD", "")


@pytest.mark.slow
def test_environments_of_releases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """List what pip can install, the oldest first, and make an environment of a release once."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    for version in ("1.10", "1.2", "1.9"):
        _wheel(wheels, "tiny", version)
    for name in RECORDING:  # of a version that is not the one of this Python: pip has to choose
        _wheel(wheels, name, "0.0.1")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(wheels))
    assert releases("tiny") == ("1.2", "1.9", "1.10")
    python = environment_of(tmp_path / "made", "tiny", "1.9")
    said = subprocess.run(
        [python, "-c", "import tiny, numpy; print(tiny.VERSION, numpy.VERSION)"], capture_output=True, text=True
    )
    assert said.stdout == "1.9 0.0.1\n"
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))  # nothing is installed again
    assert environment_of(tmp_path / "made", "tiny", "1.9") == python


@pytest.mark.slow
def test_a_release_that_cannot_be_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make an environment, say what pip says, and leave alone a folder that is something else."""
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(NotInstalled, match="No matching distribution"):
        environment_of(tmp_path / "made", "mujoco", "0.0.0")
    assert not (tmp_path / "made" / "gsb-bisect.txt").exists()
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match="no environment that gsb-bisect made"):
        environment_of(tmp_path / "mine", "mujoco", "0.0.0")
