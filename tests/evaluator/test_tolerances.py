"""Tolerances of laws and checks of mechanics, by the formulas of docs/physics/laws.md and docs/physics.md."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.facts import Check, LawValues, Measured
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.recorder.scenes.registry import make_scene
from tests.conftest import call
from tests.evaluator.trajectories import at_rest, falling, rolling, write_motion

_G, _DT = 9.81, 0.01


def _recorded(folder: Path, scene: str, steps: int, spread: float) -> tuple[Path, dict[str, LawValues]]:
    # environments that begin otherwise, so that a largest value is no mean
    done = call(
        "gsb-record", "--sim", "mujoco", "--scene", scene, "--n-env", 4, "--runs", 1, "--phases", "capture",
        "--seed", 3, "--steps", steps, "--initial", f"random:{spread}", "--dt", _DT, "--no-view",
        "--out", folder, code=0,
    )  # fmt: skip
    path = Path(done.stdout.split()[0])
    found = laws_of(Recording(path))
    assert not isinstance(found, Missing)
    return path, {law.key: law for law in found if isinstance(law, LawValues)}


def _start(path: Path, group: str, field: str) -> np.ndarray:
    return open_recording(path).state(group, field).read(slice(0, 1), slice(None))[0]


def _asserted_periods(laws: Iterable[LawValues], steps: int, more: float = 0.0) -> None:
    """Hold dt over the number of whole periods, and `more` periods."""
    for law in laws:
        slowest = max(law.measured)
        periods = _DT / (law.tolerance - more * max(law.predicted))
        assert periods == pytest.approx(round(periods), rel=1e-5)
        # in a time of n + x periods, 0 <= x < 1, there are n or n + 1 passages, and n - 1 or n periods between them
        assert 1 <= int(steps * _DT / slowest) - 1 <= round(periods) <= int(steps * _DT / slowest)


@pytest.mark.parametrize("steps", [700, 820])
def test_a_pendulum(tmp_path: Path, steps: int) -> None:
    """Allow dt over the number of periods of the slowest pendulum, and (omega dt)^2, of a rod."""
    path, laws = _recorded(tmp_path, "pendulum", steps, 0.5)
    omega = math.sqrt(_G * 0.5 / (0.76**2 / 12.0 + 0.5**2))
    assert laws["energy_change"].tolerance == pytest.approx((omega * _DT) ** 2, rel=0.02)
    angle = open_recording(path).state("robot", "qpos").read(slice(None), slice(None))[..., 0, 0]
    upward = ((angle[:-1] < 0.0) & (angle[1:] >= 0.0)).sum(axis=0)
    assert laws["period"].tolerance == pytest.approx(_DT / (upward.min() - 1))


def test_sliding_blocks(tmp_path: Path) -> None:
    """Allow an acceleration of dt over the shortest fit, and ways of one step."""
    path, laws = _recorded(tmp_path, "sliding-block", 200, 0.5)
    velocities = open_recording(path).state("cubes", "linear_velocity").read(slice(None), slice(None))
    for index, (name, degrees) in enumerate((("level", 0.0), ("downhill", 8.0), ("uphill", -8.0))):
        slope = math.radians(degrees)
        predicted = _G * (math.sin(slope) - 0.3 * math.cos(slope))
        speed = velocities[:, :, index] @ [math.cos(slope), 0.0, -math.sin(slope)]
        fitted = (speed[10:] < 0.1 * speed[0]).argmax(axis=0).min()  # from 0.1 s until a tenth of the speed is left
        assert laws[f"{name}_acceleration"].tolerance == pytest.approx(-predicted / (fitted - 1))
        assert laws[f"{name}_distance"].tolerance == pytest.approx(speed[10].max() * _DT)
    assert laws["stick_creep"].tolerance == pytest.approx(_G * _DT**2)


def test_free_bodies(tmp_path: Path) -> None:
    """Allow the angle of a step at the start, of the fastest body, and dt over the number of periods."""
    path, laws = _recorded(tmp_path, "free-body", 2500, 0.8)
    spin = np.linalg.norm(_start(path, "boxes", "angular_velocity"), axis=-1)
    for index, name in enumerate(("middle", "long", "short")):
        for what in ("momentum", "energy"):
            assert laws[f"{name}_{what}"].tolerance == pytest.approx(spin[:, index].max() * _DT, rel=1e-6)
    _asserted_periods((laws[f"{name}_period"] for name in ("long", "short")), 2500)


def test_balls(tmp_path: Path) -> None:
    """Allow a step, and the speed that gravity gives in a step, over that of the slowest impact; twice for energy."""
    path, laws = _recorded(tmp_path, "ball-drop", 150, 0.5)
    height = _start(path, "balls", "position")[..., 2] - 0.05
    speed = _start(path, "balls", "linear_velocity")[..., 2]
    names = [key.removesuffix("_contact") for key in laws if key.endswith("_contact")]
    assert len(names) == 3
    for index, name in enumerate(names):
        impact = np.sqrt(speed[:, index] ** 2 + 2.0 * _G * height[:, index]).min()
        assert laws[f"{name}_contact"].tolerance == _DT
        assert laws[f"{name}_restitution"].tolerance == pytest.approx(_G * _DT / impact, rel=1e-6)
        assert laws[f"{name}_gain"].tolerance == pytest.approx(2.0 * _G * _DT / impact, rel=1e-6)


def test_double_pendulums(tmp_path: Path) -> None:
    """Allow a step of the window, the square of the fast mode's angle in a step, and what amplitudes do to periods."""
    path, laws = _recorded(tmp_path, "double-pendulum", 800, 0.8)
    slow, fast = (laws[f"{name}_period"].predicted[0] for name in ("slow", "fast"))
    for name in ("large", "small"):
        expected = _DT / slow + (2.0 * math.pi / fast * _DT) ** 2
        assert laws[f"{name}_energy"].tolerance == pytest.approx(expected, rel=1e-6)
    joints = open_recording(path).state("robot", "qpos").read(slice(None), slice(None))[..., 2:, 0]
    largest = np.abs(np.cumsum(joints, axis=-1)).max()
    _asserted_periods((laws["slow_period"], laws["fast_period"]), 800, more=largest**2)


def test_a_four_bar_linkage(tmp_path: Path) -> None:
    """Allow a step of a turn and the square of its angle, and dt over the number of turns."""
    _, laws = _recorded(tmp_path, "four-bar", 800, 0.8)
    _asserted_periods([laws["period"]], 800)
    turn = np.mean(laws["period"].predicted)
    expected = _DT / turn + (2.0 * math.pi * _DT / turn) ** 2
    assert laws["energy_change"].tolerance == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("stride", [1, 3])
def test_checks_of_a_fall(tmp_path: Path, stride: int) -> None:
    """Allow the impact a step and a row, the speed what gravity adds in them, and the rebound that over the speed."""
    motion = falling(make_scene("free-fall"), dt=0.01, rows=90)
    rows = {name: array[::stride] for name, array in motion.items()}
    facts = _facts(write_motion(tmp_path, "free-fall", rows, stride=stride))
    slack, speed = 0.01 + 0.01 * stride, math.sqrt(2.0 * _G * 0.5)
    assert facts[Check.IMPACT_TIME].tolerance == pytest.approx(slack)
    assert facts[Check.IMPACT_SPEED].tolerance == pytest.approx(_G * slack)
    assert facts[Check.REBOUND].tolerance == pytest.approx(_G * slack / speed)
    assert facts[Check.FALL_SHAPE].tolerance == pytest.approx(_G * 1e-4, rel=1e-3)


def test_checks_of_a_roll(tmp_path: Path) -> None:
    """Allow acceleration and speed the share of a step in the way of 0.25 m, and the slip what a step adds."""
    facts = _facts(
        write_motion(tmp_path, "inclined-collision", rolling(make_scene("inclined-collision"), dt=_DT, rows=46))
    )
    down = _G * math.sin(math.radians(20.0))
    acceleration = 5.0 / 7.0 * down
    time = math.sqrt(2.0 * 0.25 / acceleration)
    assert facts[Check.ROLLING].tolerance == pytest.approx(acceleration * _DT / time, rel=1e-3)
    assert facts[Check.FOOT_SPEED].tolerance == pytest.approx(acceleration * time * _DT / time, rel=1e-3)
    assert facts[Check.SLIP].tolerance == pytest.approx(down * _DT)


def test_checks_of_bodies_on_the_ground(tmp_path: Path) -> None:
    """Allow the ground the impulse of friction of the whole weight in a step, and ways and energies a step's fall."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["position"][:, :, 0] = (0.3, 0.1, 0.0375)
    facts = _facts(write_motion(tmp_path, "inclined-collision", motion))
    mass = 0.17782 + 27 * 0.005
    for check in (Check.CONE, Check.PULL):
        assert facts[check].tolerance == pytest.approx(0.65 * mass * _G * _DT)
    assert facts[Check.DISPLACEMENT].tolerance == pytest.approx(_G * _DT**2, rel=1e-6)
    for check in (Check.ENERGY_START, Check.ENERGY_ROW):
        assert facts[check].tolerance == pytest.approx(mass * _G**2 * _DT**2, rel=1e-6)


def _facts(path: Path) -> dict[Check, Measured]:
    facts = physics_of(Recording(path)).facts
    return {check: fact for check, fact in facts.items() if isinstance(fact, Measured)}
