"""The canonical scene of two double pendulums: energy and normal modes, held by an integrator that errs little."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.law_changes import Change
from benchmarks.law_power import Setting, measured
from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.physics.closed_form import DoublePendulum
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.canonical import Law, Unmeasured, laws
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.runs.physics.measure import physics_of
from tests.conftest import call

_POINTS = DoublePendulum((2.0, 2.0), (2.0 * 0.3**2, 2.0 * 0.3**2), (0.3, 0.3), 0.3, 9.81)
"""Two equal point masses on equal lines."""


def _laws(folder: Path, *asked: str) -> tuple[Path, dict[str, Law | Unmeasured]]:
    common = ("--sim", "mujoco", "--n-env", "6", "--runs", "1", "--phases", "capture", "--seed", "3", "--no-view")
    done = call("gsb-record", *common, "--scene", "double-pendulum", "--initial", "random:0.8", *asked, "--out", folder)
    assert done.returncode == 0, done.stderr
    path = Path(done.stdout.split()[0])
    return path, {law.key: law for law in laws("a", [physics_of(Recording(path))])}


def test_modes_of_two_equal_points_are_those_of_the_book() -> None:
    """Find w^2 = (2 - sqrt 2) g / l and (2 + sqrt 2) g / l, and coordinates that do not mix the shapes of both."""
    frequencies, to_modes = _POINTS.modes()
    assert np.allclose(frequencies**2, (2.0 + np.array([-1.0, 1.0]) * math.sqrt(2.0)) * 9.81 / 0.3)
    slow, fast = np.array([1.0, math.sqrt(2.0)]), np.array([1.0, -math.sqrt(2.0)])
    assert abs(to_modes[0] @ fast) < 1e-12 < abs(to_modes[0] @ slow)
    assert abs(to_modes[1] @ slow) < 1e-12 < abs(to_modes[1] @ fast)


def test_the_energy_is_that_of_two_points() -> None:
    """Agree with m v^2 / 2 and m g h of both points, from their places at two times."""

    def places(angle: np.ndarray) -> np.ndarray:
        upper = 0.3 * np.array([math.sin(angle[0]), -math.cos(angle[0])])
        return np.stack([upper, upper + 0.3 * np.array([math.sin(angle[1]), -math.cos(angle[1])])])

    angle, speed, h = np.array([0.7, -1.9]), np.array([2.0, -3.0]), 1e-6
    velocity = (places(angle + h * speed) - places(angle - h * speed)) / (2 * h)
    height = places(angle)[:, 1] - places(np.zeros(2))[:, 1]
    expected = float((velocity**2).sum()) + 2.0 * 9.81 * float(height.sum())
    assert float(_POINTS.energy(angle, speed)) == pytest.approx(expected, rel=1e-8)


def test_runge_kutta_keeps_the_laws_of_double_pendulums(tmp_path: Path) -> None:
    """Hold energies and both periods; begin large swings and small ones within their shares of the spread."""
    path, found = _laws(tmp_path, "--option", "integrator=RK4", "--steps", "500")
    assert set(found) == {"large_energy", "small_energy", "slow_period", "fast_period"}
    for law in found.values():
        assert isinstance(law, Law) and law.held and law.count == 6
        assert abs(law.difference or 0.0) < 1e-4
        least = {one.parameter: one.least for one in law.sensitivities}
        assert least.pop("mass") is None and 0 < (least.popitem()[1] or 0.0) < 1e-2
    start = open_recording(path).state("robot", "qpos").read(slice(0, 1), slice(None))[0, :, :, 0]
    share = 0.8 * np.array([0.15, 0.15, 0.002, 0.002])
    added = start - np.array([0.8, 0.0, 0.005, -0.0075])
    assert (np.abs(added) <= share + 1e-12).all() and (np.ptp(added, axis=0) > share / 2).all()


@pytest.mark.parametrize("name", ["large", "small"])
def test_damping_takes_the_energy_that_is_claimed(name: str, tmp_path: Path) -> None:
    """Damp the joints of a pendulum on MuJoCo C, and see its energy change by what the law says of a small damping."""
    setting = Setting("mujoco", "double-pendulum", 0.01, tmp_path, {"integrator": "RK4"}, n_env=4)
    before, after = (
        next(law for law in measured(setting, changes, 1) if law.key == f"{name}_energy")
        for changes in ((), [Change("damping", name, 1e-5)])
    )
    moved = np.subtract(after.measured, before.measured).mean() / 1e-5
    assert moved == pytest.approx(dict(before.slopes)["damping"], rel=0.05)


def test_the_default_integrator_gives_a_large_swing_energy(tmp_path: Path) -> None:
    """See first-order terms of a moving mass matrix at a step of 10 ms, and none of them in a small swing."""
    path, found = _laws(tmp_path, "--steps", "500")
    large, small = found["large_energy"], found["small_energy"]
    assert isinstance(large, Law) and not large.held and large.measured > 0.05
    assert isinstance(small, Law) and small.held
    # not equal to False alone: what follows from a broken law asks for it by "is"
    assert all(type(law.held) is bool for law in found.values() if isinstance(law, Law))
    (group,) = evaluate_files([path]).results
    assert faults(group).laws.startswith("laws in closed form broken: energy of the large swing")


@pytest.mark.slow
def test_a_short_recording_says_what_it_lacks(tmp_path: Path) -> None:
    """Name the time that is too short for energies and periods."""
    path, found = _laws(tmp_path, "--steps", "50")
    assert {law.reason.partition(" s")[0] for law in found.values() if isinstance(law, Unmeasured)} == {
        "less than 3.28",
        "no whole period was recorded",
    }
    assert not isinstance(physics_of(Recording(path)).laws, Missing)
