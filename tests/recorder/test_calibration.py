"""The calibration simulator: what it draws, shares out and steps. What comes of it is in tests/test_control.py."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("taichi")

from gpusimbench.recorder.conformance import Subject
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.run.start import drawn_states, images
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.calibration.model import model_of
from gpusimbench.recorder.simulators.calibration.options import REGIMES, CalibrationOptions, places, shares
from gpusimbench.recorder.simulators.calibration.simulator import Calibration
from gpusimbench.recorder.simulators.flight import NEVER, FailureKind, Watch, step_and_kind
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.symmetry import symmetry_of

Json = dict[str, Any]


def build(n_env: int = 2, scene: str = "inclined-collision", **options: object) -> tuple[Calibration, Description]:
    """A simulator on the CPU, built in this process."""
    text = {name: str(value) for name, value in {"device": "cpu", **options}.items()}
    parsed = parse_options("calibration", CalibrationOptions, text)
    simulator = Calibration(make_scene(scene), n_env=n_env, dt=0.01, seed=0, options=parsed)
    return simulator, simulator.build()


def test_racing_atomics() -> None:
    """Step with racing additions; whether anything differs is the hardware's affair, and not said here."""
    simulator, description = build(regime="atomics")
    assert description.switches["sums"] == "racing atomic additions"
    simulator.compile("capture")
    assert all(np.isfinite(array).all() for array in simulator.states(20))
    counts = simulator.evidence()
    assert counts.counts["contacts"].min() > 0
    simulator.close()


def test_a_planted_failure() -> None:
    """Tell the environment and the step of a state that is made not finite, and hold the steps before it."""
    simulator, description = build(n_env=5)
    flight = simulator.flight(Watch(description.fields))
    assert (flight.failures() == NEVER).all()
    for _ in range(2):
        flight.begin(20)
        assert (flight.failures() == NEVER).all()
    broken = tuple(np.array(array)[3:4] for array in simulator.state())
    for field, array in zip(description.fields, broken, strict=True):
        array[:] = np.nan if field.field == "linear_velocity" else array
    simulator.set_state(broken, np.array([3]))
    flight.begin(20)
    failures = flight.failures()
    assert step_and_kind(int(failures[3])) == (41, FailureKind.NOT_FINITE)
    assert (np.delete(failures, 3) == NEVER).all()
    for array in flight.window(3, 0, 60):
        assert np.isfinite(array[:41]).all()
    assert not all(np.isfinite(array[41]).all() for array in flight.window(3, 0, 60))
    simulator.close()


@pytest.mark.parametrize("regime", REGIMES)
def test_stepping_and_capturing_agree(regime: str) -> None:
    """Reach the same bits by step, by states, and in blocks longer than the ring; atomics on one environment."""
    options: Json = {"n_env": 1 if regime == "atomics" else 3, "regime": regime, "entropy": "5a"}
    stepped, _ = build(**options)
    stepped.compile("timed")
    stepped.step(3)
    stepped.step(58)
    state = stepped.state()
    stepped.close()
    captured, _ = build(**options)
    captured.states(1)
    states = captured.states(60)
    if regime != "atomics":
        assert all(a.tobytes() == b[-1].tobytes() for a, b in zip(state, states, strict=True))
    captured.close()


def test_a_stack_stays() -> None:
    """Hold the resting stack of the conformance scene within a millimetre, without orientations to look at."""
    trajectory = Subject(Calibration, options={"device": "cpu"}).trajectory
    for name in ("lower_cube", "upper_cube"):
        settled = trajectory.of(name, "position")[25:]
        assert np.abs(settled - np.array(trajectory.body(name).position)).max() < 1e-3


def test_places_are_powers_of_two() -> None:
    """Give each environment a combination of its own, as near as that allows, and none where bodies are moved."""
    found: NDArray[Any] = places(CalibrationOptions(regime="offset"), 4096)
    assert len(np.unique(found, axis=0)) == 4096
    assert found.max() == 2**15
    assert not places(CalibrationOptions(regime="offset", shift=0.1), 8).any()


def test_shares() -> None:
    """Share the shift out by environment, by run, by both, or to one environment alone."""
    half = "8000"
    assert shares(CalibrationOptions(regime="offset", shift=1.0), 3, half).tolist() == [0.0, 0.5, 1.0]
    assert shares(CalibrationOptions(regime="offset", shift=1.0, env=1), 3, half).tolist() == [0.0, 1.0, 0.0]
    assert shares(CalibrationOptions(regime="order", shift=1.0), 2, half).tolist() == [0.5, 1.5]
    assert shares(CalibrationOptions(regime="run-order", shift=1.0), 2, half).tolist() == [0.5, 0.5]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"regime": "chaos"}, "regime is one of identical"),
        ({"device": "tpu"}, "device is one of auto"),
        ({"regime": "offset", "shift": "-1"}, "shift is a distance in metres"),
        ({"regime": "offset", "shift": "nan"}, "shift is a distance in metres"),
        ({"regime": "offset", "ulps": "-1"}, "ulps is from 0"),
        ({"regime": "offset", "shift": "1", "ulps": "1"}, "give one of them"),
        ({"at": "0"}, "at is at least 1"),
        ({"shift": "1"}, "move nothing in regime identical"),
        ({"regime": "order", "contacts": "off"}, "nothing would differ"),
        ({"regime": "offset", "env": "1"}, "env is -1, or"),
        ({"regime": "run-order", "ulps": "1", "env": "1"}, "env is -1, or"),
        ({"entropy": "0x1"}, "entropy is run, build or"),
    ],
)
def test_options_that_cannot_be(options: dict[str, str], says: str) -> None:
    """Refuse options that mean nothing, or contradict each other, with a sentence."""
    with pytest.raises(UsageError, match=says):
        parse_options("calibration", CalibrationOptions, options)


def test_what_cannot_be_built() -> None:
    """Refuse an environment that is not there, and a fixed sphere."""
    with pytest.raises(UsageError, match="there are 2 environments"):
        build(regime="offset", ulps=1, env=2)
    ball = make_scene("inclined-collision").moving()[0]
    with pytest.raises(UsageError, match="no fixed bodies but boxes and planes, and ball is none"):
        model_of(Scene("held", "", (replace(ball, mass=None),)))


@pytest.mark.parametrize(
    "options",
    [{"fault": "gremlins", "ulps": 1}, {"fault": "slot"}, {"fault": "slot", "ulps": 1, "regime": "offset"},
     {"ulps": 1}],
)  # fmt: skip
def test_no_such_fault(options: Json) -> None:
    """Refuse a fault that is none, that has no size, or that stands in another regime."""
    with pytest.raises(UsageError):
        parse_options("calibration", CalibrationOptions, {name: str(value) for name, value in options.items()})


@pytest.mark.parametrize(("fault", "moved"), [("bystanders", [0, 2]), ("fresh", [1]), ("none", [])])
def test_what_a_reset_moves(fault: str, moved: list[int]) -> None:
    """Move the last body alone, by units in the last place, of the environments that the fault is about."""
    simulator, description = build(n_env=3, fault=fault, ulps=0 if fault == "none" else 5)
    at = [field.name for field in description.fields].index("cubes/position")
    before = simulator.state()[at]
    simulator.reset(np.array([1]))
    after = simulator.state()[at]
    simulator.close()
    apart = after.view(np.int32) - before.view(np.int32)
    assert np.argwhere(apart).tolist() == [[env, 26, 0] for env in moved]
    assert set(apart[moved, 26, 0].tolist()) == ({5} if moved else set())


@pytest.mark.parametrize(
    ("scene", "symmetry", "differs"),
    [
        ("inclined-collision", "relabel:reverse", (True, False, True, True)),
        ("free-fall", "relabel:reverse", (True, False, True, True)),
        ("inclined-collision", "mirror:y", (False, False, False, False)),
        ("free-fall", "mirror:y", (False, False, False, False)),
        ("free-fall", "mirror:xy", (False, False, False, True)),
    ],
)
def test_symmetries(scene: str, symmetry: str, differs: tuple[bool, ...]) -> None:
    """Step exchanged states of identical bodies to the exchanged states, if sums of forces are exact, and to others if
    they are rounded in the order of the bodies' numbers, or if a fault tells bodies apart by number; mirror images are
    stepped to mirror images by all of these, and turned states to turned states, if no fault tells directions apart."""
    found = []
    faulty: list[Json] = [{"regime": "exact", "fault": name, "ulps": 1, "at": 3} for name in ("relabelled", "turned")]
    for options in ({"regime": "identical"}, {"regime": "exact"}, *faulty):
        simulator, description = build(scene=scene, **options)
        begun = drawn_states(Initial(0.3), simulator.scene, description.fields, simulator.state(), 0)
        changed = symmetry_of(Initial.parse(f"random:0.3,{symmetry}"), json.loads(simulator.scene.to_json()))
        assert changed is not None
        ended = []
        for states in (begun, images(begun, changed, description.fields, ())):
            simulator.reset()
            simulator.set_state(states)
            simulator.step(60)
            ended.append(simulator.state())
        simulator.close()
        pairs = zip(ended[0], images(ended[1], changed, description.fields, ()), strict=True)
        found.append(any(not np.array_equal(usual, image) for usual, image in pairs))
    assert tuple(found) == differs
