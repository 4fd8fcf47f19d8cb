"""Steps that become slower, and processes that become larger, the more steps they make."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.results.growth import growth, notes, steady_growth
from gpusimbench.evaluator.runs.growth import Course
from gpusimbench.evaluator.runs.run import Run
from tests.conftest import call, distribution
from tests.synthetic import write_recording

ROOT = Path(__file__).resolve().parents[2]
H200 = ROOT / "recordings" / "h200"
H100 = ROOT / "recordings" / "h100"
PROTOCOL = ROOT / "recordings" / "protocol-h200"


def read(path: Path) -> Run:
    """A recording, read and closed."""
    run = Reader(5.0, verify=False)(path)
    assert isinstance(run, Run)
    return run


def test_a_line_is_its_own_growth() -> None:
    """Give the growth of a straight line exactly, of several runs the median; p as Mann and Kendall have it."""
    found = growth([np.array([10.0, 11.0, 12.0, 13.0, 14.0]), np.array([1.0, 1.1, 1.2, 1.3, 1.4])])
    assert found.share == pytest.approx(4 / 12)
    assert found.p_value == pytest.approx(0.0005, rel=0.01)  # S = 20, Var S = 2 x 50/3: z = 19 / 5.77


@pytest.mark.parametrize(
    "runs",
    [
        [],
        [[1.0, 2.0, 3.0]],  # too few
        [[1.0, 1.01, 1.02, 1.03, 1.04, 1.045]],  # below 5 %
        [[4.0, 3.0, 2.0, 1.0, 0.5]],
        [[1.0, 1.3, 0.9, 1.2, 1.1, 1.25]],
        [[1.0, 1.0, 1.0, 1.0, 2.0]],  # a pause at the end
        [[0.0, 0.0, 0.0, 0.0, 1.0]],
    ],
)
def test_what_is_no_growth(runs: Sequence[Sequence[float]]) -> None:
    """Say nothing where there are too few values, or what they show is noise, small, or of the other direction."""
    assert growth([np.array(run) for run in runs]) is None


def test_false_alarms_of_noise() -> None:
    """Tell a growth of noise without one in at most 1 % of the groups."""
    random = np.random.default_rng(5)
    found = [growth(list(np.exp(random.normal(scale=0.3, size=(3, 6))))) for _ in range(2000)]
    assert sum(one is not None for one in found) <= 0.015 * len(found)


@given(st.lists(st.integers(0, 1 << 40), max_size=8), st.floats(0, 1e6))
@settings(max_examples=50)
def test_memory_that_grows_has_grown(used: list[int], seconds: float) -> None:
    """Tell no more than the difference, and only where no part gave memory back."""
    found = steady_growth(used, seconds)
    assert found in (0, used[-1] - used[0] if used else 0)
    assert not found or sorted(used) == used


def test_memory_that_grows_once() -> None:
    """Tell growth in every part from an allocator that grows once, and from the recorder's own readings."""
    mega = 10**6
    assert steady_growth([0, mega, 2 * mega, 3 * mega], 1.0) == 3 * mega
    assert steady_growth([0, 0, 3 * mega, 3 * mega], 1.0) == 0
    assert steady_growth([0, mega // 10, mega // 5, 3 * mega // 10], 0.1) == 0
    assert steady_growth([0, mega, 2 * mega, 3 * mega], 30.0) == 0


def test_growth_within_a_window(tmp_path: Path) -> None:
    """Tell a growth within the timed steps only where nothing else may explain it."""
    run = read(write_recording(tmp_path, None))
    parts = tuple(np.linspace(1.0, 1.2, 10) * 1e-3)
    course = Course(seconds=2.0, windows=(2.0,), parts=parts, work={"contacts": (27.0, 26.0)})
    (said,) = notes([replace(run, course=course)])
    assert "a step grew by 18 %" in said
    assert "27 at the first and 26 at the last" in said
    for otherwise in (
        replace(course, work={}),
        replace(course, work={"contacts": (27.0, 40.0)}),
        replace(course, work={"contacts": (27.0, 26.0), "solver_iterations": (1.0, 2.0)}),
        replace(course, seconds=0.5),
        replace(course, windows=(0.5,) * 4),
        replace(course, parts=parts[::-1]),
        replace(course, parts=()),
    ):
        assert not list(notes([replace(run, course=otherwise)])), otherwise
    assert not list(notes([]))


def test_shipped_recordings() -> None:
    """Find the leak of the calibration simulator, whose Taichi keeps something of every step, and none elsewhere.

    MJX with impl=warp takes memory after each reset, however many steps follow.
    """
    said = {
        name: "; ".join(notes([read(path) for path in sorted(folder.glob(f"{name}-inclined-collision-n16-r?.mcap"))]))
        for folder, name in (
            (H200, "calibration-atomics"), (H200, "calibration-identical"), (H200, "genesis"), (H100, "warp"),
            (H100, "physx"), (H100, "newton-mujoco"), (PROTOCOL, "mjx-warp"), (PROTOCOL, "playground"),
        )
    }  # fmt: skip
    assert "the time of a step grew by 9 %" in said["calibration-atomics"]
    assert "host memory of the process grew all the time while steps were timed, by 52.1 to 65 kB a step" in said.pop(
        "calibration-atomics"
    )
    assert not any(said.values()), said


_LEAKS = """
import time
from gpusimbench.recorder.run import timed_phase
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC

timed_phase.ENOUGH_S = 5.0  # windows so long that memory is read often in each, also where the machine is busy

class Leaks(MujocoC):  # MuJoCo C, which keeps 40 kB of every step and looks through all that it has kept
    kept = []
    def step(self, n_step):
        super().step(n_step)
        for _ in range(n_step):
            self.kept.append(bytes([1]) * 40_000)
            time.sleep(2e-3 + 1e-5 * len(self.kept))
"""


def test_a_planted_leak_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Notice an engine that keeps something of every step, by its time and by its memory."""
    distribution(tmp_path, "leaking-simulator", "[gsb.simulators]\nleaks = leaking_simulator:Leaks\n", _LEAKS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (tmp_path, ROOT, ROOT / "src"))))
    done = call(
        "gsb-record", "--sim", "leaks", "--n-env", 1, "--runs", 1, "--phases", "timed", "--warmup", 20,
        "--timed-steps", 100, "--out", tmp_path, code=0,
    )  # fmt: skip
    said = " ".join(call("gsb-eval", *done.stdout.split(), "--all", "--no-cache").stdout.split())
    assert "longer in the last of" in said
    assert "host memory of the process grew all the time" in said
