"""Real recordings, made once, and the commands as a user calls them."""

from __future__ import annotations

import atexit
import fcntl
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import HealthCheck, Phase, settings

from gpusimbench.recorder.capture import work_process
from gpusimbench.schemas.scratch import scratch_folder
from tests.browser import Browser
from tests.in_process import in_process

# The machine that runs the tests may be slow or busy; a test says what is right, not how fast. Every run draws the same
# examples: new ones are for tests.hostile.soak and tests.hostile.fuzz, which say how to see again what they found.
settings.register_profile("any-machine", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")
settings.register_profile(  # for make mutants, which asks whether a test fails and not of what
    "mutants",
    settings.get_profile("any-machine"),
    phases=(Phase.explicit, Phase.generate),
)

# Tests put errors where states are worked on, in this process; test_work_process.py lets another one do it.
work_process.LEAST_CPUS = sys.maxsize

# Tests interrupt commands as a user does. A shell that starts the tests in the background has them ignore SIGINT, and
# every process that they start would inherit it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What all processes of these tests share, workers of pytest-xdist too, and nothing that another run of them left.
if "GSB_TESTS_SHARE" not in os.environ:
    _left = ExitStack()
    os.environ["GSB_TESTS_SHARE"] = str(_left.enter_context(scratch_folder())[0])
    atexit.register(_left.close)
SHARE = Path(os.environ["GSB_TESTS_SHARE"])
os.environ["GSB_CACHE"] = str(SHARE / "results")
os.environ.pop("GSB_CUBE_TOSS", None)  # the measured tosses of this machine: tests name those that they read
os.environ["GSB_PROGRESS"] = "off"  # what is printed does not depend on how fast this machine is
os.environ.update(  # what XLA compiles
    JAX_COMPILATION_CACHE_DIR=str(SHARE / "jax"),
    JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0.1",
    JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES="-1",
)

UNOPTIMISED = " ".join(
    filter(
        None,
        [os.environ.get("XLA_FLAGS"), "--xla_backend_optimization_level=0", "--xla_cpu_use_fusion_emitters=false"],
    )
)
"""XLA_FLAGS of a process that leaves XLA's optimisations out; see the fixture `unoptimised`."""

Command = Callable[..., subprocess.CompletedProcess[str]]

SMALL = ("--steps", "100", "--warmup", "10", "--timed-steps", "20")
"""A run of a second of simulated time; evaluated with --sample-time 1."""


def command(name: str) -> list[str]:
    """The installed command of that name."""
    return [str(Path(sys.executable).parent / name)]


def call(name: str, *arguments: object, code: int | None = None, **keywords: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; AssertionError where it ends with another exit code than `code`, if that is given.

    It runs in this process where nothing but its working directory and its environment is asked for (see in_process),
    and in a process of its own with any other keyword of subprocess.run.
    """
    if keywords.keys() - {"cwd", "env"}:
        return finished([*command(name), *arguments], code=code, **{"timeout": 600, **keywords})
    done = in_process(name, *arguments, **keywords)
    assert code in (None, done.returncode), f"{name} ended with {done.returncode}: {done.stdout}{done.stderr}"
    return done


def finished(words: Sequence[object], *, code: int | None = 0, **keywords: Any) -> subprocess.CompletedProcess[str]:
    """Run a program of these words to its end, within 600 s where nothing else is said; AssertionError where it ends
    with another exit code than `code`."""
    given = {"capture_output": True, "text": True, "timeout": 600, **keywords}
    done: subprocess.CompletedProcess[str]
    done = subprocess.run(list(map(str, words)), **given)
    assert code in (None, done.returncode), f"{words[0]} ended with {done.returncode}: {done.stdout}{done.stderr}"
    return done


def run_python(
    program: str, *arguments: object, code: int | None = 0, **keywords: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program in a Python of its own; AssertionError where it ends with another exit code than `code`."""
    return finished([sys.executable, "-c", program, *arguments], code=code, **keywords)


def distribution(folder: Path, name: str, points: str, source: str = "") -> dict[str, str]:
    """Lay an installed distribution of a third party into a folder; the environment in which Python finds it.

    points  its entry_points.txt
    source  of its module, which has the distribution's name with underscores
    """
    module = name.replace("-", "_")
    if source:
        (folder / f"{module}.py").write_text(source)
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)
    return {**os.environ, "PYTHONPATH": searched(folder)}


def searched(*folders: Path) -> str:
    """A PYTHONPATH with these folders first: what tests run with it is this checkout, not one that is installed."""
    return os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until the condition holds; AssertionError after five minutes."""
    for _ in range(3000):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError("it did not happen within five minutes")


def has_ended(process: psutil.Process) -> bool:
    """Whether a process has ended, though nobody may have waited for it, as the first process of many a container does
    not for those whose parent has ended."""
    with suppress(psutil.NoSuchProcess):
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    return True


@pytest.fixture(scope="session")
def gsb_record() -> Command:
    """Call gsb-record with the given arguments."""
    return lambda *arguments, **keywords: call("gsb-record", *arguments, **keywords)


@pytest.fixture(scope="session")
def gsb_probe() -> Command:
    """Call gsb-probe with the given arguments."""
    return lambda *arguments, **keywords: call("gsb-probe", *arguments, **keywords)


@pytest.fixture(scope="session")
def gsb_eval() -> Command:
    """Call gsb-eval with the given arguments."""
    return lambda *arguments, **keywords: call("gsb-eval", *arguments, **keywords)


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """A folder that the first process which asks for it fills, for all processes of these tests.

    make  fills the folder, which exists; where it fails, the next that asks for the folder tries anew
    """
    folder, whole = SHARE / name, SHARE / f"{name}.whole"
    with (SHARE / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not whole.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            whole.touch()
    return folder


def recorded(*arguments: object) -> list[Path]:
    """The recordings that gsb-record makes of these arguments, in their names' order; must not be written to.

    They are made once, for all that ask for the same.
    """

    def record(folder: Path) -> None:
        call("gsb-record", *arguments, "--out", folder, code=0)

    name = hashlib.sha256(json.dumps([str(argument) for argument in arguments]).encode()).hexdigest()
    return sorted(made_once(name[:16], record).glob("*.mcap"))


@pytest.fixture
def unoptimised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let XLA leave out its optimisations in the processes that a test starts: they compile a program in a third of the
    time, and step it for moments. Recordings state the flags.

    It is not for tests that compare two programs bit by bit, as one that steps with one that keeps what it sees:
    without the optimisations they round differently.
    """
    monkeypatch.setenv("XLA_FLAGS", UNOPTIMISED)


@pytest.fixture(scope="session")
def small_set() -> list[Path]:
    """Three runs of four environments of inclined-collision, 1 s each; must not be written to."""
    return recorded("--sim", "mujoco", "--n-env", "4", "--runs", "3", *SMALL)


@pytest.fixture(scope="session")
def small(small_set: list[Path]) -> Path:
    """The first of the small set."""
    return small_set[0]


@pytest.fixture(scope="session")
def arms() -> Path:
    """Two arms of the scene franka, 50 captured steps of MuJoCo C; must not be written to."""
    (path,) = recorded(
        "--sim", "mujoco", "--scene", "franka", "--n-env", 2, "--steps", 50, "--phases", "capture", "--runs", 1
    )
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for all tests of a file that need one."""
    with Browser() as opened:
        yield opened


loaded_by_reading: set[str] = set()
"""Engines that were imported while the files of tests were read; see test_start_up.py."""

_LONGEST = "test_simulators"
_ENGINES = ("test_warp", "test_newton", "test_mjx", "test_brax")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest file; end with tests that load an engine into this process.

    JAX minds every fork that comes after it. Newton's tests take as long as the two files that follow them where a
    worker runs each.
    """
    loaded_by_reading.update({"brax", "jax", "newton", "warp"} & sys.modules.keys())

    def turn(item: pytest.Item) -> int:
        name = item.path.stem
        return _ENGINES.index(name) + 1 if name in _ENGINES else -int(name == _LONGEST)

    items.sort(key=turn)
