"""Runs that take longer than they may: ended by themselves, or killed where their engine never returns."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.sets.finished import read_end
from tests.conftest import Command, distribution, run_python
from tests.reading import verified

pytestmark = pytest.mark.alone

_PLUGIN = '''
"""A third party's simulator that does not come to an end."""
import atexit, hashlib, os, time
from dataclasses import dataclass
import numpy as np
from gpusimbench.recorder.simulators.base import Ability, Description, Simulator
from gpusimbench.schemas.fields import body_field

def compute_for_long():
    # native code: as long as it runs, Python handles no signal
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)

@dataclass(frozen=True)
class Options:
    mode: str = "compile"
    from_n_env: int = 1

class Endless(Simulator):
    Options = Options
    abilities = frozenset(Ability)

    def build(self):
        self.slow = self.n_env >= self.options.from_n_env
        if self.slow and self.options.mode == "exit":
            atexit.register(compute_for_long)
        field = body_field("cubes", "position", "float32", ("a",))
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def compile(self, phase):
        if self.slow and self.options.mode == "compile":
            if not os.fork():  # a process of its own that holds everything open
                time.sleep(600)
                os._exit(0)
            compute_for_long()

    def step(self, n_step):
        while self.slow and self.options.mode == "careless":
            try:
                time.sleep(0.01)
            except Exception:
                pass

    def state(self):
        return (np.zeros((self.n_env, 1, 3), dtype=np.float32),)
'''

_IMPATIENT = (
    "import sys; from gpusimbench.recorder.process import launch; launch.GRACE_S = 1.0; "
    "from gpusimbench.recorder.cli import main; sys.exit(main())"
)
"""gsb-record with less time between the timeout and the end of patience."""

_TIMEOUT_S = 20
"""Enough for a process to start and for a small run to end while other tests load the machine."""

_SMALL = ("--steps", "5", "--warmup", "1", "--timed-steps", "2", "--phases", "timed")


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "endless"."""
    folder = tmp_path_factory.mktemp("plugin")
    return distribution(folder, "endless-simulator", "[gsb.simulators]\nendless = endless_simulator:Endless\n", _PLUGIN)


def _impatient(environment: dict[str, str], *arguments: object, code: int) -> subprocess.CompletedProcess[str]:
    return run_python(_IMPATIENT, "--sim", "endless", *_SMALL, *arguments, code=code, env=environment)


@pytest.mark.parametrize(
    ("phases", "more"),
    [
        (["baseline", "init", "capture"], ("--phases", "capture", "--steps", 10_000_000)),
        (["baseline", "init", "warmup", "timed"], ("--warmup", 1, "--timed-steps", 3_000_000)),
        (["baseline", "init", "warmup"], ("--warmup", 3_000_000)),
    ],
)
def test_a_run_ends_itself(gsb_record: Command, tmp_path: Path, phases: list[str], more: tuple[object, ...]) -> None:
    """End the recording with the phase that was cut short, keep the states so far, and end with 1."""
    done = gsb_record(
        "--sim", "mujoco", "--scene", "free-fall", "--n-env", 16, "--runs", 1, "--timeout", 4, *more, "--out", tmp_path
    )
    assert done.returncode == 1, done.stderr
    (file,) = tmp_path.iterdir()
    assert str(file) == done.stdout.strip()
    recording = verified(file)
    began = [event.phase for event in recording.events if event.kind == "PHASE_BEGIN"]
    assert (recording.status, recording.reason) == ("failed", f"timeout: more than 4 s, in phase {began[-1]}")
    assert read_end(file).outcome.cause == "TIMEOUT"
    assert began == phases[: len(began)]  # a machine that is very slow does not come to the last
    if began[-1] == "capture":
        assert len(recording.state("cubes", "position")) >= 1


def test_enough_time_changes_nothing(gsb_record: Command, tmp_path: Path) -> None:
    """Leave a run alone that ends in time."""
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 1, "--runs", 1, *_SMALL, "--timeout", 1e9, "--out", tmp_path, code=0,
    )  # fmt: skip
    assert read_end(Path(done.stdout.strip())).outcome.good


def test_an_engine_that_catches_every_exception(gsb_record: Command, endless: dict[str, str], tmp_path: Path) -> None:
    """End a run in time whose engine catches whatever is an Exception."""
    done = gsb_record(
        "--sim", "endless", "--runs", 1, *_SMALL, "--option", "mode=careless", "--timeout", 1, "--out", tmp_path,
        env=endless, code=1,
    )  # fmt: skip
    assert "timeout: more than 1 s, in phase" in done.stderr


_EXPIRES = '''
"""Let the time end inside a piece of shielded code; say what comes of it."""
import signal
from gpusimbench.recorder import interruption

interruption.install()
interruption.expire_after(1000)
said = []
try:
    with interruption.shielded():
        signal.raise_signal(signal.SIGALRM)
        signal.raise_signal(signal.SIGINT)
        said.append("whole")
    said.append("not here")
except KeyboardInterrupt:
    said += ["raised", interruption.struck()]
signal.raise_signal(signal.SIGTERM)  # only the first one is raised
print(*said)
'''

_INTERRUPTED = '''
"""Be interrupted by the user before the time ends; say which of the two it was."""
import signal
from gpusimbench.recorder import interruption

interruption.install()
interruption.expire_after(1000)
try:
    signal.raise_signal(signal.SIGINT)
except KeyboardInterrupt:
    signal.raise_signal(signal.SIGALRM)
    print(interruption.struck())
interruption.install()
interruption.expire_after(1000)
interruption.ignore()
signal.raise_signal(signal.SIGALRM)
print([interruption.struck()], signal.getitimer(signal.ITIMER_REAL))
'''


@pytest.mark.parametrize(
    ("code", "said"), [(_EXPIRES, "whole raised TIMEOUT\n"), (_INTERRUPTED, "INTERRUPTED\n[''] (0.0, 0.0)\n")]
)
def test_an_end_of_time_is_one_interruption(code: str, said: str) -> None:
    """Hold the end of time back while shielded, raise one interruption in all, and know which it was."""
    done = run_python(code, code=None)
    assert (done.stdout, done.stderr) == (said, "")


_EXPIRES_IN_A_WRITE = '''
"""Let the time of a capture end between the digest of a state and its writing; print how it ended."""
import sys, time
from pathlib import Path
from gpusimbench.recorder.run.run import Run
from gpusimbench.schemas import digest
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import Provenance

original, calls = digest.ContentDigest.state, []

def slow(self, *arguments):
    original(self, *arguments)
    calls.append(1)
    if len(calls) == 4:
        time.sleep(4)

digest.ContentDigest.state = slow
configuration = RunConfiguration("mujoco", "free-fall", 70, 0.01, 200, phases=("capture",), timeout=3)
provenance = Provenance("r", "2026-01-01T00:00:00Z", (), configuration)
outcome = Run(provenance, Path(sys.argv[1]), progress=lambda *_: None, log=lambda: b"").record()
print(outcome.status, outcome.cause, outcome.reason)
'''


def test_the_time_ends_within_a_write(tmp_path: Path) -> None:
    """Write the piece whole that was being written when the time ended."""
    path = tmp_path / "x.mcap"
    done = run_python(_EXPIRES_IN_A_WRITE, path, code=None)
    assert done.stdout.startswith("FAILED TIMEOUT timeout: more than 3 s, in phase "), done.stderr
    verify(open_recording(path))


def test_an_engine_that_never_returns(endless: dict[str, str], tmp_path: Path) -> None:
    """Kill a run, and what it started, whose engine sits in native code; keep what it wrote, and end with 3."""
    done = _impatient(endless, "--n-env", 1, "--runs", 1, "--timeout", _TIMEOUT_S, "--out", tmp_path, code=3)
    (file,) = tmp_path.iterdir()
    assert file.suffix == ".partial"
    assert done.stdout.strip() == str(file)
    assert open_recording(file).status == "incomplete"
    assert f"did not end 1 s after its timeout of {_TIMEOUT_S} s and was killed in phase init" in done.stderr


def test_an_engine_that_never_lets_its_process_end(endless: dict[str, str], tmp_path: Path) -> None:
    """Keep the whole recording of a run whose engine hangs when the process ends."""
    once = ("--n-env", 1, "--runs", 1, "--timeout", 60, "--out", tmp_path)
    done = _impatient(endless, *once, "--option", "mode=exit", code=0)
    assert read_end(Path(done.stdout.strip())).outcome.good


@pytest.mark.slow
def test_a_sweep_ends_at_a_run_that_never_returns(endless: dict[str, str], tmp_path: Path) -> None:
    """Record in its place that a run was killed, try it once, and again only when it gets more time."""
    sweep = ("--sweep", "1..8", "--runs", 2, "--option", "from_n_env=2", "--out", tmp_path)
    done = _impatient(endless, *sweep, "--timeout", _TIMEOUT_S, code=0)
    assert "2 envs: 1 of 2 runs are not made: they would fail as the first did" in done.stderr
    assert re.search(r"^N_env\^max 1: failed at 2: .*was killed in phase init", done.stderr, re.MULTILINE)
    (partial,) = tmp_path.glob("*.partial")
    (file,) = tmp_path.glob("*-n2-*.mcap")
    assert str(file) in done.stdout.split()
    recording = verified(file)
    assert recording.status == "failed"
    assert partial.name in recording.reason
    assert recording.provenance == open_recording(partial).provenance
    assert recording.provenance.host
    assert read_end(file).outcome.cause == "TIMEOUT"

    before = set(tmp_path.iterdir())
    again = _impatient(endless, *sweep, "--timeout", _TIMEOUT_S, code=0)
    assert set(tmp_path.iterdir()) == before
    assert "3 of 8 runs are in" in again.stderr
    assert again.stdout == ""

    longer = _impatient(endless, *sweep, "--timeout", _TIMEOUT_S + 1, code=0)
    assert "2 of 8 runs are in" in longer.stderr
    assert f"its timeout of {_TIMEOUT_S + 1} s" in longer.stderr
