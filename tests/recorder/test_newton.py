"""Newton in particular: its solvers, held against formulas, and what it drops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Scene, Sphere, solid_inertia
from gpusimbench.recorder.scenes.cube_stack import ROUGH_WOOD, SMOOTH_WOOD
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.newton.deviations import deviations
from gpusimbench.recorder.simulators.newton.options import SOLVERS, NewtonOptions
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import BODY_FIELDS
from tests.recorder import engines
from tests.recorder.engines import field

engines.needed("newton")

G = 9.81

# every solver has kernels of its own, which take a minute to build
FAST = ("mujoco",)


def marked(names: tuple[str, ...]) -> Any:
    """Parametrise over solvers, those that are not tried in the fast tests marked."""
    return pytest.mark.parametrize(
        "solver", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in names]
    )


solvers = marked(("mujoco", "xpbd", "steel"))
all_solvers = marked(SOLVERS)

FLYING = replace(
    make_scene("free-fall"),
    bodies=(
        Body(
            "marble", Sphere(0.02), SMOOTH_WOOD, position=(1.0, 0.0, 5.0), mass=0.1, group="ball",
            angular_velocity=(0.3, -0.2, 0.1),
        ),
        Body(
            "stone", Box((0.02, 0.04, 0.06)), SMOOTH_WOOD, position=(0.0, 0.0, 5.0), mass=0.1, group="cubes",
            orientation=(0.8, 0.6, 0.0, 0.0), linear_velocity=(1.0, -2.0, 3.0), angular_velocity=(0.0, 0.0, 2.0),
        ),
    ),
)  # fmt: skip
"""Two bodies in free flight; the ball's angular velocity in the world frame is constant."""

LANDING = replace(
    make_scene("free-fall"),
    bodies=(
        Body("ground", Plane(), ROUGH_WOOD, position=(0.0, 0.0, 0.0)),
        Body("cube", Box((0.1, 0.1, 0.1)), SMOOTH_WOOD, position=(0.0, 0.0, 0.075), mass=1.0, group="cubes"),
    ),
)
"""A box that falls 25 mm onto the ground, from further than any gap, and rests on its four corners."""


def build(scene: Scene, solver: str, **options: Any) -> tuple[Any, Description]:
    """A built simulator."""
    return engines.build("newton", scene, solver=solver, **options)


@pytest.mark.slow
@all_solvers
def test_flight(solver: str) -> None:
    """Start as the scene says, compiled or not, and fly as Newton's laws say, quaternions wxyz."""
    simulator, description = build(FLYING, solver)
    first = simulator.state()
    for layout, array in zip(description.fields, first, strict=True):
        body = FLYING.bodies[layout.group == "cubes"]
        assert array.shape == (2, 1, layout.width)
        assert array.dtype == np.float32
        assert np.allclose(array, getattr(body, layout.field), atol=1e-6)
    simulator.compile("capture")
    assert all(a.tobytes() == b.tobytes() for a, b in zip(simulator.state(), first, strict=True))

    states = simulator.states(50)
    time = 0.01 * np.arange(1, 51)
    velocity = field(description, states, "cubes/linear_velocity")[:, 1, 0]
    assert np.allclose(velocity, np.stack([1.0 + 0 * time, -2.0 + 0 * time, 3.0 - G * time], axis=1), atol=1e-3)
    position = field(description, states, "cubes/position")[:, 0, 0]
    assert np.allclose(position[:, 2], 5.0 + 3.0 * time - G * time**2 / 2, atol=G * 0.01 * 0.5)
    assert np.allclose(field(description, states, "ball/angular_velocity"), (0.3, -0.2, 0.1), atol=1e-3)
    turned = field(description, states, "ball/orientation")[-1, 0, 0]
    axis = 0.5 * np.array((0.3, -0.2, 0.1)) * time[-1]  # half the angle that it turned by
    assert np.allclose(turned, (np.cos(np.linalg.norm(axis)), *axis), atol=2e-3)
    assert np.all(simulator.evidence().counts["contacts"] == 0)
    simulator.close()


@pytest.mark.slow
@marked(FAST)
def test_a_capsule(solver: str) -> None:
    """Give a capsule the inertia of a solid one, and let it come to rest on its side."""
    lying = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    pill = Body("pill", Capsule(0.05, 0.2), SMOOTH_WOOD, (0.0, 0.0, 0.06), 1.0, group="pills", orientation=lying)
    simulator, description = build(replace(LANDING, bodies=(LANDING.bodies[0], pill)), solver, n_env=1)
    inertia = simulator._worlds.model.body_inertia.numpy()[0]
    assert np.allclose(inertia, np.diag(solid_inertia(pill.shape, 1.0)), rtol=1e-6)
    states = simulator.states(100)
    assert np.allclose(field(description, states, "pills/position")[-1, 0, 0], (0.0, 0.0, 0.05), atol=3e-3)
    assert np.allclose(field(description, states, "pills/orientation")[-1, 0, 0], lying, atol=1e-2)
    simulator.close()


@solvers
def test_a_box_rests(solver: str) -> None:
    """Land on four corners, stay there, and count them; no buffer of measured size overflows."""
    simulator, description = build(LANDING, solver)
    height = field(description, simulator.states(80), "cubes/position")[-20:, :, 0, 2]
    assert np.abs(height - 0.05).max() < 2e-3
    evidence = simulator.evidence()
    assert np.all(evidence.counts["contacts"][-20:] == 4)
    assert not evidence.overflow.any()
    assert {counter.name for counter in description.counters} == set(evidence.counts)
    assert all(buffer.asked > 0 and "MuJoCo C" in buffer.sized_by for buffer in description.buffers)


@pytest.mark.parametrize(
    ("solver", "too_small", "expected"),
    [
        ("mujoco", {"max_rows": "3"}, "NEFC"),
        pytest.param("mujoco", {"max_contacts": "1"}, "NARROWPHASE", marks=pytest.mark.slow),
        ("xpbd", {"max_contacts": "1"}, "CONTACT_BUFFER"),
        pytest.param("steel", {"max_rows": "3"}, "constraint_overflow", marks=pytest.mark.slow),
        pytest.param("vbd", {"max_rows": "3"}, "BODY_CONTACTS", marks=pytest.mark.slow),
        pytest.param("kamino", {"max_contacts": "1"}, "CONTACT_BUFFER", marks=pytest.mark.slow),
    ],
)
def test_what_is_dropped_shows(solver: str, too_small: dict[str, str], expected: str) -> None:
    """Set the bit of a buffer that was too small, in the captured steps and over many steps of which none is read."""
    for capture in (True, False):
        simulator, description = build(LANDING, solver, **too_small)
        (bit,) = [found for found in description.overflow_bits if found.name == expected]
        assert bit.fatal
        if capture:
            simulator.states(12)
        else:
            simulator.step(12)
        overflow = simulator.evidence().overflow
        assert overflow.shape == (12 if capture else 1, 2)
        assert not capture or not overflow[0].any()  # nothing touches yet
        assert (overflow[-1] & (1 << bit.bit)).all()
        if not capture:
            assert "asked for" in {buffer.sized_by.split("env ")[-1] for buffer in description.buffers}


@pytest.mark.slow
def test_newtons_contacts_in_mujocos_solver() -> None:
    """Rest on contacts of Newton's own collision detection, and show what does not fit into either buffer."""
    simulator, description = build(LANDING, "mujoco", use_mujoco_contacts="off")
    height = field(description, simulator.states(60), "cubes/position")[-1, :, 0, 2]
    assert np.abs(height - 0.05).max() < 2e-3
    assert description.switches["contacts"] == "CollisionPipeline, explicit"
    assert {b.name for b in description.overflow_bits if b.bit >= 16} == {"CONTACT_PIPELINE", "SOLVER_NCONMAX"}
    small, _ = build(LANDING, "mujoco", use_mujoco_contacts="off", max_contacts="1")
    small.step(12)
    overflow = small.evidence().overflow
    assert (overflow & (1 << 16)).all()


@pytest.mark.slow
def test_substeps() -> None:
    """Make several solver steps a step, with an odd and an even number, and the same time passes."""
    for substeps in ("2", "3"):
        simulator, description = build(FLYING, "xpbd", n_env=1, substeps=substeps)
        assert description.options["substeps"] == int(substeps)
        simulator.step(9)
        velocity = field(description, simulator.state(), "cubes/linear_velocity")[0, 0, 2]
        assert velocity == pytest.approx(3.0 - G * 0.09, abs=1e-4)


def test_options_in_force() -> None:
    """Record the options that the solver has, its own defaults included."""
    _, description = build(LANDING, "mujoco", iterations="7", cone="pyramidal")
    assert description.options["iterations"] == 7
    assert description.options["cone"] == "pyramidal"
    assert description.options["gap"] == 0.0
    assert description.options["restitution"] is None
    assert description.options["max_contacts"] is None
    _, description = build(LANDING, "xpbd", gap="0.02", restitution="on", max_contacts="900")
    assert description.options["max_contacts"] == 900
    assert (description.options["iterations"], description.options["restitution"]) == (2, True)
    assert description.options["gap"] == 0.02
    assert description.switches["precision"] == "float32"


@pytest.mark.parametrize(
    ("name", "value"),
    [("solver", "bullet"), ("cone", "round"), ("restitution", "maybe"), ("substeps", "0"), ("iterations", "-1"),
     ("gap", "-0.1"), ("ke", "nan"), ("max_rows", "-2")],
)  # fmt: skip
def test_values_that_no_solver_has(name: str, value: str) -> None:
    """Refuse them by name."""
    with pytest.raises(UsageError, match=name):
        parse_options("newton", NewtonOptions, {name: value})


@pytest.mark.slow
def test_run_to_run_makes_worlds_alike() -> None:
    """Give the same bits in every environment where contacts are sorted and sums are ordered."""
    scene = make_scene("inclined-collision")
    simulator, description = build(scene, "steel", n_env=3, determinism="run-to-run")
    assert description.switches["solver_deterministic"] == "RUN_TO_RUN"
    assert description.switches["contacts_sorted"]
    for array in simulator.states(5):
        assert (array == array[:, :1]).all()


@pytest.fixture(scope="module")
def put_back() -> Iterator[None]:
    """Set the options of MuJoCo Warp's modules back after this file.

    Newton sets them for the whole process when a solver steps; a test of MuJoCo Warp that comes next has them too.
    """
    yield
    build(LANDING, "mujoco", n_env=1)[0].compile("timed")


@pytest.mark.usefixtures("put_back")
@pytest.mark.parametrize(
    ("solver", "determinism", "reason"),
    [("mujoco", "run-to-run", "dof_damping"), ("steel", "gpu-to-gpu", "SolverSteel supports")],
)
def test_determinism_that_a_solver_does_not_have(solver: str, determinism: str, reason: str) -> None:
    """Refuse it with the engine's own reason."""
    with pytest.raises(Refused, match=reason):
        build(LANDING, solver, determinism=determinism)[0].compile("timed")


@pytest.mark.parametrize("solver", SOLVERS)
def test_deviations_name_every_material(solver: str) -> None:
    """Say of each material what becomes of its static friction and its restitution."""
    scene = make_scene("inclined-collision")
    names = [found.parameter for found in deviations(scene, NewtonOptions(solver=solver))]
    assert len(names) == len(set(names))
    for body in scene.bodies:
        assert {f"{body.material.name}.static_friction", f"{body.material.name}.restitution"} <= set(names)


def test_fields() -> None:
    """Name the four fields of each group, with a note where the recorder changed the order of the numbers."""
    _, description = build(FLYING, "xpbd")
    assert [f.name for f in description.fields] == [f"{g}/{f}" for g in ("ball", "cubes") for f in BODY_FIELDS]
    assert {f.field for f in description.fields if f.note} == {"orientation"}
