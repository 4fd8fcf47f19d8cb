"""What engines make of a signal or of the end of their time: an interruption all the same, which sweeps make again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.process.launch import _End, _result
from gpusimbench.recorder.sets.finished import read_end
from gpusimbench.schemas.configuration import RunConfiguration
from tests.conftest import command, finished, wait_for
from tests.synthetic import write_recording

pytestmark = pytest.mark.slow

_PLUGIN = '''
"""A third party's simulator whose engine takes a while to import, once, and turns what interrupts it into something."""
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from gpusimbench.recorder.simulators.base import Ability, Description, Simulator
from gpusimbench.schemas.fields import body_field

@dataclass(frozen=True)
class Options:
    mode: str = "import"

def broken(*_):
    raise ImportError("initialization failed")

class Delicate(Simulator):
    Options = Options
    abilities = frozenset(Ability)

    def build(self):
        importing = Path(os.environ["GSB_TEST_FOLDER"]) / "importing"
        if not importing.exists():
            if self.options.mode == "handler":  # as engines do that bring an application of their own
                for number in (signal.SIGINT, signal.SIGALRM):
                    signal.signal(number, broken)
            try:
                importing.touch()
                time.sleep(60)
            except KeyboardInterrupt:
                if self.options.mode == "import":
                    raise ImportError("initialization failed") from None
                if self.options.mode == "exit":
                    raise SystemExit(1) from None
                if self.options.mode == "abort":
                    os.abort()
                # else: the interruption is swallowed
        field = body_field("cubes", "position", "float32", ("a",))
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def step(self, n_step):
        pass

    def state(self):
        return (np.zeros((self.n_env, 1, 3), dtype=np.float32),)
'''

_SWEEP = (
    "--sim", "delicate", "--sweep", "1..1", "--runs", "1", "--steps", "5", "--warmup", "1", "--timed-steps", "2",
    "--phases", "timed", "--json",
)  # fmt: skip


@pytest.fixture
def delicate(tmp_path: Path) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "delicate"."""
    folder = tmp_path / "plugin"
    info = folder / "delicate_simulator-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "delicate_simulator.py").write_text(_PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: delicate-simulator\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[gsb.simulators]\ndelicate = delicate_simulator:Delicate\n")
    return {**os.environ, "PYTHONPATH": str(folder), "GSB_TEST_FOLDER": str(folder)}


@pytest.mark.parametrize("mode", ["import", "exit", "handler", "swallow", "abort"])
def test_a_signal_is_no_failure_of_the_engine(delicate: dict[str, str], tmp_path: Path, mode: str) -> None:
    """Call a run interrupted whatever its engine made of the signal, and make it again in a sweep that goes on."""
    sweep = [*command("gsb-record"), *_SWEEP, "--option", f"mode={mode}", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(sweep, env=delicate, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_for((Path(delicate["GSB_TEST_FOLDER"]) / "importing").exists)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode != 0
    assert "Traceback" not in err
    (run,) = json.loads(out)["runs"]
    assert run["cause"] == "INTERRUPTED", run
    for file in (tmp_path / "out").glob("*.mcap"):
        assert mode != "abort"
        assert read_end(file).outcome.cause == "INTERRUPTED"
        assert open_recording(file).reason.startswith("interrupted in phase ")

    again = finished(sweep, env=delicate)
    assert json.loads(again.stdout)["sweep"]["n_env_max"] == 1


@pytest.mark.parametrize("mode", ["import", "handler", "swallow", "abort"])
def test_the_end_of_time_is_no_failure_of_the_engine(delicate: dict[str, str], tmp_path: Path, mode: str) -> None:
    """Call a run timed out whatever its engine made of that; a sweep knows it then, and tries again with more time."""
    sweep = [*command("gsb-record"), *_SWEEP, "--option", f"mode={mode}", "--out", str(tmp_path / "out")]
    done = subprocess.run([*sweep, "--timeout", "3"], env=delicate, capture_output=True, text=True, timeout=300)
    (run,) = json.loads(done.stdout)["runs"]
    assert (run["status"], run["cause"]) == ("failed", "TIMEOUT"), done.stderr
    assert read_end(Path(run["file"])).outcome.cause == "TIMEOUT"
    longer = finished([*sweep, "--timeout", "1e6"], env=delicate)
    assert json.loads(longer.stdout)["sweep"]["n_env_max"] == 1


@pytest.mark.parametrize(
    ("reason", "cause", "read"),
    [
        ("ImportError in phase init: raised by KeyboardInterrupt", "ENGINE", "INTERRUPTED"),
        ("ImportError in phase init: no such file", "ENGINE", "ENGINE"),
        ("timeout: more than 3 s; KeyboardInterrupt", "TIMEOUT", "TIMEOUT"),
    ],
)
def test_older_recordings_that_show_a_signal(tmp_path: Path, reason: str, cause: str, read: str) -> None:
    """Take a run of an older recorder for interrupted where its engine's error names what a signal raises."""
    path = write_recording(tmp_path, None, status="FAILED", reason=reason, cause=cause)
    assert read_end(path).outcome.cause == read


@pytest.mark.parametrize(
    ("interrupted", "late", "cause"), [(True, True, "INTERRUPTED"), (False, True, "TIMEOUT"), (False, False, "")]
)
@pytest.mark.parametrize("last", [{}, {"error": "SystemExit: 1", "exit_code": 1}])
def test_how_a_process_ended_that_wrote_no_end(
    tmp_path: Path, last: dict[str, object], interrupted: bool, late: bool, cause: str
) -> None:
    """Tell an interruption and the end of the time from a process that died by itself."""
    run = RunConfiguration("mujoco", "free-fall", 1, 0.01, 5, timeout=3.0)
    left = tmp_path / "x.mcap.partial"
    end = _End(returncode=-6, last=dict(last), late=late)
    result = _result(run, tmp_path / "x.mcap", left, end, "", interrupted=interrupted)
    assert (result.status, result.cause) == ("incomplete", cause)
