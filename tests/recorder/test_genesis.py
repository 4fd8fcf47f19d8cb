"""Genesis in particular: one engine at a time in a process, what it drops, and its servos."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("genesis")

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.run import start
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.genesis.deviations import deviations
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.genesis.simulator import Genesis
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.initial import Initial

# Genesis leaves the picture on its ground planes open
pytestmark = [
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

Build = Callable[..., tuple[Genesis, Description]]

FALL = make_scene("free-fall")
COLLISION = make_scene("inclined-collision")
FRANKA = make_scene("franka")


@pytest.fixture
def build() -> Iterator[Build]:
    """Build simulators on the CPU one after the other; the one before is closed, and the last one at the end."""
    present: list[Genesis] = []

    def make(
        scene: Scene, *, n_env: int = 2, determinism: str = "default", **options: str
    ) -> tuple[Genesis, Description]:
        while present:
            present.pop().close()
        parsed = parse_options("genesis", GenesisOptions, {"device": "cpu", **options})
        simulator = Genesis(scene, n_env=n_env, dt=0.01, seed=0, options=parsed, determinism=determinism)
        present.append(simulator)
        return simulator, simulator.build()

    yield make
    while present:
        present.pop().close()


def same(one: States, other: States) -> bool:
    """Whether all arrays have the same bits."""
    return all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


def test_a_second_engine_repeats_the_first(build: Build) -> None:
    """Build, close and build again: the same bits, compiled or not, and env 0 does not depend on how many there are."""
    first, _ = build(COLLISION, n_env=3)
    states = first.states(60)
    assert all((array == array[:, :1]).all() for array in states)
    second, _ = build(COLLISION, n_env=3)
    second.compile("capture")
    assert same(second.states(60), states)
    single, _ = build(COLLISION, n_env=1)
    assert same(single.states(60), tuple(array[:, :1] for array in states))


@pytest.mark.parametrize(
    ("too_small", "bit", "words"),
    [
        ({"max_contacts": "40"}, "OVERFLOW_CONTACTS", "'max_contacts'"),
        ({"max_collision_pairs": "20"}, "OVERFLOW_COLLISION_PAIRS", "'max_collision_pairs'"),
        (
            {"max_collision_pairs": "20", "broad_phase_multiplier": "1"},
            "OVERFLOW_CANDIDATE_CONTACTS",
            "'multiplier_collision_broad_phase'",
        ),
    ],
)
def test_what_is_dropped_shows(build: Build, too_small: dict[str, str], bit: str, words: str) -> None:
    """Go on where Genesis would stop, with the bit of every environment and with the engine's words, once."""
    simulator, description = build(COLLISION, **too_small)
    (declared,) = [found for found in description.overflow_bits if found.name == bit]
    assert declared.fatal
    assert len(simulator.states(25)[0]) == 25  # past two of the engine's looks at its codes
    overflow = simulator.evidence().overflow
    assert not overflow[0].any()
    assert (overflow[-1] & (1 << declared.bit)).all()
    (sentence,) = simulator.gates()
    assert "of 2 of 2 envs" in sentence
    assert words in sentence
    simulator.step(12)
    simulator.state()  # which tells nothing of the steps
    overflow = simulator.evidence().overflow
    assert overflow.shape == (1, 2)
    assert (overflow & (1 << declared.bit)).all()


def test_an_overflow_makes_a_run_invalid(tmp_path: Path) -> None:
    """Record a run whose buffer is too small as INVALID, for the reason BUFFER."""
    from gpusimbench.recorder.run.run import Run
    from gpusimbench.schemas.configuration import RunConfiguration
    from gpusimbench.schemas.provenance import Provenance

    configuration = RunConfiguration(
        simulator="genesis", scene="inclined-collision", n_env=2, dt=0.01, steps=12, warmup=0, timed_steps=1, seed=0,
        options={"device": "cpu", "max_contacts": "40"}, determinism="default", phases=("capture",),
    )  # fmt: skip
    provenance = Provenance("1", "2026-01-01T00:00:00Z", (), configuration)
    outcome = Run(provenance, tmp_path / "run.mcap", progress=lambda phase, done, of: None, log=lambda: b"").record()
    assert (outcome.status, outcome.cause) == ("INVALID", "BUFFER")
    assert "max_contacts 40 per env" in outcome.reason
    assert "RigidSolver's option 'max_contacts'" in outcome.reason


def test_numbers_gone_bad_show(build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say so where Genesis freezes an environment whose numbers are no longer finite: its states look fine."""
    monkeypatch.chdir(tmp_path)  # MuJoCo, which counts contacts first, writes its warnings to a file there
    fast = replace(FALL.bodies[1], angular_velocity=(3e38, 0.0, 0.0))
    simulator, _ = build(replace(FALL, bodies=(FALL.bodies[0], fast)))
    assert all(np.isfinite(array).all() for array in simulator.states(3))
    (sentence,) = simulator.gates()
    assert "nan" in sentence


@pytest.mark.parametrize(("level", "on"), [("default", True), ("off", False), ("run-to-run", True)])
def test_levels(build: Build, level: str, on: bool) -> None:
    """Record what a level sets; without performance mode the engine's default is on."""
    _, description = build(FALL, determinism=level)
    assert description.switches["use_deterministic_algorithms"] is on
    assert description.switches["array_mode"] == "ndarray"
    assert description.switches["precision"] == "float32"


def test_options_in_force(build: Build) -> None:
    """Record what the solver has, its own defaults included, and how large each buffer is."""
    simulator, description = build(FALL, iterations="7", max_contacts="300")
    assert description.options["iterations"] == 7
    assert description.options["contact_resolution"] == "convex"
    assert description.options["impratio"] == 1.0
    sizes = {buffer.name: buffer for buffer in description.buffers}
    assert (sizes["max_contacts"].asked, sizes["max_contacts"].sized_by) == (300, "asked for")
    assert "MuJoCo C" in sizes["max_candidate_contacts"].sized_by
    held = simulator.states(60)
    assert all(np.isfinite(array).all() for array in held)
    assert simulator.evidence().counts["contacts"].max() <= 300


@pytest.mark.parametrize(
    ("name", "value"),
    [("device", "tpu"), ("precision", "16"), ("solver", "PGS"), ("cone", "round"), ("substeps", "0"),
     ("noslip_iterations", "-1"), ("max_contacts", "-2"), ("tolerance", "nan"), ("constraint_timeconst", "0")],
)  # fmt: skip
def test_values_that_there_are_not(name: str, value: str) -> None:
    """Refuse them by name."""
    with pytest.raises(UsageError, match=name):
        parse_options("genesis", GenesisOptions, {name: value})


def test_settings_that_genesis_refuses(build: Build) -> None:
    """Pass its own words on."""
    with pytest.raises(Refused, match="noslip"):
        build(FALL, cone="elliptic", noslip_iterations="5")


def test_precision_is_chosen_once(build: Build) -> None:
    """Ask for a fresh process where kernels are there already, for another precision or array mode."""
    build(FALL)
    for other in ({"precision": "64"}, {"performance_mode": "on"}):
        with pytest.raises(GsbError, match="fresh process"):
            build(FALL, **other)


def _moved(simulator: Any, actions: np.ndarray) -> np.ndarray:
    """Joint angles [step, env, joint]."""
    simulator.prepare(actions)
    qpos: np.ndarray = simulator.states(len(actions))[0]
    return qpos[..., 0]


def test_servos_follow_mujocos(build: Build) -> None:
    """Move as on MuJoCo C towards targets that need less than the largest torque, and hold what was applied."""
    start = np.array(FRANKA.robot.start if FRANKA.robot else ())
    near = np.tile(np.float32(start + 0.002), (20, 2, 1))
    reference = MujocoC(FRANKA, n_env=2, dt=0.01, seed=0, options=MujocoC.Options())
    reference.build()
    simulator, _ = build(FRANKA)
    expected, found = _moved(reference, near), _moved(simulator, near)
    assert np.abs(expected[-1] - start).max() > 5e-3  # it has moved
    assert np.abs(found - expected).max() < 2e-4
    applied = simulator.applied()
    assert applied is not None
    assert np.array_equal(applied, near[-1])


def test_saturated_servos_deviate(build: Build) -> None:
    """Say that servos at their limit lag behind under Genesis' implicit integrators, and only there."""
    far = FRANKA.actions.draw(0, n_env=2, first_step=0, n_step=10)
    reference = MujocoC(FRANKA, n_env=2, dt=0.01, seed=0, options=MujocoC.Options())
    reference.build()
    expected = _moved(reference, far)[:, 0]  # in env 0 every servo is at its limit, in env 1 one of them is not
    for integrator, as_mujoco in (("approximate_implicitfast", False), ("Euler", True)):
        simulator, description = build(FRANKA, integrator=integrator)
        assert bool(np.abs(_moved(simulator, far)[:, 0] - expected).max() < 1e-3) is as_mujoco
        assert ("joint.max_torque" not in {found.parameter for found in description.deviations}) is as_mujoco


def test_deviations_name_every_material() -> None:
    """Say of each material what becomes of its static friction and its restitution."""
    names = [found.parameter for found in deviations(COLLISION, GenesisOptions())]
    assert len(names) == len(set(names))
    for body in COLLISION.bodies:
        assert {f"{body.material.name}.static_friction", f"{body.material.name}.restitution"} <= set(names)


def test_a_restored_collision_goes_on(build: Build) -> None:
    """Save while cubes begin to touch and to part, go on, restore: the same bits to the end, of some envs as well.

    The engine's own checkpoint leaves out what its broad phase found in the last step.
    """
    simulator, description = build(COLLISION, n_env=8)
    first = tuple(np.array(array) for array in simulator.state())
    simulator.set_state(start.drawn_states(Initial.parse("random:0.1"), COLLISION, description.fields, first, 0))
    simulator.step(49)
    snapshot = simulator.snapshot()
    onward = simulator.states(60)
    simulator.restore(snapshot)
    assert same(simulator.states(30), tuple(array[:30] for array in onward))
    some, others = np.array([2, 5]), np.array([0, 1, 3, 4, 6, 7])
    simulator.restore(snapshot, some)
    after = simulator.states(30)
    assert same(tuple(array[:, some] for array in after), tuple(array[:30, some] for array in onward))
    assert same(tuple(array[:, others] for array in after), tuple(array[30:, others] for array in onward))


def test_a_reset_keeps_what_went_wrong(build: Build) -> None:
    """Tell an overflow after a reset too, which makes Genesis forget its error codes."""
    simulator, _ = build(COLLISION, max_contacts="40")
    simulator.step(5)
    simulator.reset()
    (sentence,) = simulator.gates()
    assert "max_contacts" in sentence


def test_arms_are_saved_reset_and_set(build: Build) -> None:
    """Restored and reset arms move as before, bit for bit, drives included; others stay as they are."""
    simulator, _ = build(FRANKA, n_env=3)
    first = simulator.state()
    drawn = np.random.default_rng(0).normal(size=(20, 3, len(FRANKA.robot.start))) * 0.3
    targets = (np.array(FRANKA.robot.start) + drawn).astype(np.float32)
    simulator.prepare(targets)
    moved, snapshot = simulator.states(20), simulator.snapshot()
    assert snapshot.step == 20
    simulator.prepare(targets)
    onward = simulator.states(20)
    simulator.restore(snapshot)
    simulator.prepare(targets)
    assert same(simulator.states(20), onward)
    before, some = simulator.state(), np.array([0, 2])
    simulator.reset(some)
    after = simulator.state()
    assert same(tuple(array[some] for array in after), tuple(array[some] for array in first))
    assert same(tuple(array[1] for array in after), tuple(array[1] for array in before))
    simulator.prepare(targets)
    assert same(tuple(array[:, some] for array in simulator.states(20)), tuple(array[:, some] for array in moved))
    given = tuple(array[[1]] + np.float32(0.125) for array in first)
    before = simulator.state()
    simulator.set_state(given, np.array([1]))
    after = simulator.state()
    assert same(tuple(array[[1]] for array in after), given)
    assert same(tuple(array[some] for array in after), tuple(array[some] for array in before))


def test_an_overflow_is_told_once() -> None:
    """Show an overflow at the step that had it, and neither at later steps nor in later calls."""
    options = parse_options("genesis", Genesis.Options, {"device": "cpu", "max_contacts": "330"})
    simulator = Genesis(make_scene("inclined-collision"), n_env=1, dt=0.01, seed=0, options=options)
    simulator.build()
    try:
        simulator.states(10)
        found = simulator.evidence()
        assert np.flatnonzero(found.overflow[:, 0]).tolist() == [int(found.counts["contacts"][:, 0].argmax())]
        assert len(simulator.gates()) == 1
        simulator.states(3)
        later = simulator.evidence()
        assert not later.overflow.any()
        assert simulator.gates() == []
    finally:
        simulator.close()
