"""Makes the environment of a simulator: a virtual environment with pinned requirements, each checked by its hash."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gpusimbench.recorder.environments.interpreter import RECORDING, Interpreter, at, forget
from gpusimbench.recorder.environments.store import (
    FOLDER_VARIABLE,
    MANIFEST,
    Prepared,
    Specification,
    find,
    folder_of,
    specification_of,
    store,
)
from gpusimbench.recorder.plan import utc_now
from gpusimbench.recorder.probes.host import NUMERIC_PACKAGES
from gpusimbench.recorder.sets.progress import say
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.writing import open_lock

_ELSEWHERE = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PIP_USER", "PIP_TARGET", "PIP_PREFIX", "PIP_ROOT")
"""Variables that would lead Python or pip into another environment."""

_VERSIONS = """
import json, sys
from importlib import metadata
there = {}
for name in sys.argv[1:]:
    try:
        there[name] = metadata.version(name)
    except metadata.PackageNotFoundError:
        pass
print(json.dumps(there))
"""


def set_up(simulator: str, python: Path | None = None) -> Prepared:
    """The environment of a simulator, made unless it is there already.

    python  to make it with; None: this one or another on PATH, of a version that the requirements are for

    UsageError where there is nothing to make it from or no such Python, or where its folder holds something else;
    GsbError where an installation fails. What was made by then is removed, and an older environment is back.
    """
    specification = specification_of(simulator)
    with _alone(simulator):
        there = find(simulator)
        if there and there.current and python is None and _has_all_packages(there):
            return there
        base = _base(specification, python)
        folder = folder_of(simulator)
        with _replaced(folder):
            made = _make(specification, base, folder)
    return made


def _has_all_packages(there: Prepared) -> bool:
    # an upgrade of the Python that it is of, or a hand, may have taken something away
    try:
        return not Interpreter(there.interpreter).missing((*RECORDING, *find_simulator(there.simulator).requires))
    except UsageError:
        return False


@contextmanager
def _replaced(folder: Path) -> Iterator[None]:
    # what lies there is kept until the new one is whole
    if folder.is_symlink() or (folder.exists() and not _is_ours(folder)):
        raise UsageError(
            f"{folder} is no environment that gsb-record made; move it away, or name a folder with {FOLDER_VARIABLE}"
        )
    aside = folder.with_name(f".{folder.name}.old")
    shutil.rmtree(aside, ignore_errors=True)
    if folder.exists():
        say(f"replacing {folder}")
        folder.rename(aside)
    forget()
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        if aside.exists():
            aside.rename(folder)
        raise
    finally:
        forget()
    shutil.rmtree(aside, ignore_errors=True)


def _is_ours(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    marks = (MANIFEST, "pyvenv.cfg")  # the second is what a setup that was killed leaves at least
    return any((folder / mark).exists() for mark in marks) or not any(folder.iterdir())


def size_of(folder: Path) -> int:
    """Bytes of all files below; links count nothing."""
    return sum(
        (Path(place) / name).lstat().st_size
        for place, _, names in os.walk(folder)
        for name in names
        if not (Path(place) / name).is_symlink()
    )


def _make(specification: Specification, base: Interpreter, folder: Path) -> Prepared:
    simulator = specification.simulator
    version = ".".join(map(str, base.version()))
    say(f"{simulator}: an environment of Python {version} in {folder}")
    uv = shutil.which("uv")
    if uv:
        _call([uv, "venv", "--quiet", "--seed", "--python", str(base.python), str(folder)])
    else:
        _call([str(base.python), "-m", "venv", str(folder)])
    made = Interpreter(folder / "bin" / "python")
    pip = [str(made.python), "-m", "pip", "install", "--disable-pip-version-check", "--quiet"]
    if specification.beforehand:
        # By pip also where there is uv, which does not read pip's configuration: the index or folder that has the
        # build of torch for this machine is named there.
        say(f"{simulator}: {', '.join(specification.beforehand)}, as the configured index has it")
        _call([*pip, *specification.beforehand])
    locked = ["--no-deps", "--require-hashes", "-r", str(specification.requirements)]
    say(f"{simulator}: {_count(specification.requirements)} pinned requirements, each checked by its hash")
    _call([uv, "pip", "install", "--quiet", "--python", str(made.python), *locked] if uv else [*pip, *locked])
    if lost := made.missing((*RECORDING, *find_simulator(simulator).requires)):
        raise GsbError(f"the environment of '{simulator}' was made, but has no {', '.join(lost)}")
    prepared = Prepared(
        simulator=simulator,
        requirements=specification.sha256(),
        python=version,
        versions=_versions(made.python),
        size=size_of(folder),
        created=utc_now(),
    )
    prepared.write()
    return prepared


def _base(specification: Specification, given: Path | None) -> Interpreter:
    wanted = ", ".join(f"3.{minor}" for minor in specification.pythons)
    if given is not None:
        chosen = at(given)
        if not _fits(chosen, specification):
            version = ".".join(map(str, chosen.version()))
            raise UsageError(f"{given} is Python {version}; '{specification.simulator}' wants {wanted}")
        return chosen
    for path in (Path(sys.executable), *(Path(f"python3.{minor}") for minor in specification.pythons)):
        try:
            found = at(path)
        except UsageError:  # such as a shim of a version that is not there
            continue
        if _fits(found, specification):
            return found
    raise UsageError(
        f"the environment of '{specification.simulator}' is of Python {wanted}, and none is on PATH; name one: "
        f"gsb-record --setup {specification.simulator} --python PATH"
    )


def _fits(interpreter: Interpreter, specification: Specification) -> bool:
    major, minor, _ = interpreter.version()
    return major == 3 and minor in specification.pythons


def _count(requirements: Path) -> int:
    return sum("==" in line for line in requirements.read_text().splitlines() if not line.startswith("#"))


def _versions(python: Path) -> dict[str, str]:
    said: dict[str, str] = json.loads(_call([str(python), "-c", _VERSIONS, *NUMERIC_PACKAGES]))
    return said


def _call(command: list[str]) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in _ELSEWHERE} | {"PYTHONSAFEPATH": "1"}
    try:
        child = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
        )
    except OSError as error:
        raise GsbError(f"cannot run {command[0]}: {error.strerror}") from None
    try:
        out, complaints = child.communicate()
    except BaseException:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)  # with what it started, or that would go on installing
        child.wait()
        raise
    if child.returncode:
        said = [line for line in complaints.splitlines() if line.strip()] or ["it said nothing"]
        raise GsbError(f"'{' '.join(command[:4])} ...' failed: " + " ".join(said[-6:]))
    return out


@contextmanager
def _alone(simulator: str) -> Iterator[None]:
    # two commands that make the same environment at once would make a broken one
    folder = store()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open_lock(folder / f".{simulator}.lock")
    except OSError as error:
        raise GsbError(f"cannot write to {folder}: {error.strerror}; name another with GSB_ENVIRONMENTS") from None
    with os.fdopen(lock):
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
