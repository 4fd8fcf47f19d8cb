"""What every simulator must do, held against formulas; parametrised over the registry."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from recorder.options import parse_options
from recorder.scenes.base import IDENTITY, Body, Box, Scene, Sphere
from recorder.scenes.cube_stack import SMOOTH_WOOD
from recorder.scenes.inclined_collision import SLOPE_ANGLE
from recorder.scenes.registry import make_scene
from recorder.simulators.base import Description, Simulator
from recorder.simulators.registry import BUILT_IN
from schemas.errors import UsageError
from schemas.fields import BODY_FIELDS, FIELD_KINDS

G = 9.81
simulators = pytest.mark.parametrize("name", [e.name for e in BUILT_IN if not e.missing()])

FLYING = replace(
    make_scene("free-fall"),
    bodies=(
        Body(
            "stone",
            Box((0.02, 0.04, 0.06)),
            SMOOTH_WOOD,
            position=(0.0, 0.0, 5.0),
            mass=0.1,
            group="cubes",
            orientation=(math.cos(0.6), math.sin(0.6), 0.0, 0.0),
            linear_velocity=(1.0, -2.0, 3.0),
            angular_velocity=(0.0, 0.0, 2.0),
        ),
        Body("marble", Sphere(0.02), SMOOTH_WOOD, position=(1.0, 0.0, 5.0), mass=0.1, group="ball",
             angular_velocity=(0.3, -0.2, 0.1)),
    ),
)  # fmt: skip
"""Two bodies in free flight; a ball's angular velocity in the world frame is constant."""


def build(
    name: str, scene: Scene, *, n_env: int = 2, dt: float = 0.01, **options: str
) -> tuple[Simulator, Description]:
    """A built simulator."""
    entry = next(e for e in BUILT_IN if e.name == name)
    adapter = entry.load()
    simulator = adapter(scene, n_env=n_env, dt=dt, seed=0, options=parse_options(name, adapter.Options, options))
    return simulator, simulator.build()


def field(description: Description, states: tuple[NDArray[Any], ...], name: str) -> NDArray[Any]:
    """One field of a state by "group/field"."""
    return states[[f.name for f in description.fields].index(name)]


@simulators
@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall"])
def test_layout_and_first_state(name: str, scene: str) -> None:
    """Describe the fields as the format asks, and start as the scene says."""
    described = make_scene(scene)
    simulator, description = build(name, described, n_env=3)
    state = simulator.state()
    assert [f.name for f in description.fields] == [f"{g}/{f}" for g in described.groups() for f in BODY_FIELDS]
    bodies = {b.name: b for b in described.moving()}
    for layout, array in zip(description.fields, state, strict=True):
        kind = FIELD_KINDS[layout.field]
        assert array.shape == (3, len(layout.items), layout.width)
        assert array.dtype == layout.dtype
        assert (layout.unit, layout.components) == (kind.unit, kind.components)
        expected = [getattr(bodies[item], layout.field) for item in layout.items]
        assert np.allclose(array, expected, atol=1e-6)
    assert description.version
    assert description.timing_covers
    simulator.close()


@simulators
def test_the_registry_tells_what_a_simulator_can(name: str) -> None:
    """Build every scene that the registry promises, on such a device, in such a precision."""
    entry = next(e for e in BUILT_IN if e.name == name)
    assert entry.scenes
    for scene in entry.scenes:
        simulator, description = build(name, make_scene(scene), n_env=1)
        assert ("cpu" if description.device == "cpu" else "cuda") in entry.devices
        assert {f.dtype for f in description.fields} <= set(entry.precision)
        simulator.close()


@simulators
def test_flight_follows_newton(name: str) -> None:
    """Fly a parabola: v exact, p within the error of a first-order integrator."""
    simulator, description = build(name, FLYING)
    states = simulator.states(50)
    time = 0.01 * np.arange(1, 51)
    velocity = field(description, states, "cubes/linear_velocity")[:, 0, 0]
    assert np.allclose(velocity[:, 2], 3.0 - G * time, atol=1e-4)
    assert np.allclose(velocity[:, :2], (1.0, -2.0), atol=1e-6)
    height = field(description, states, "cubes/position")[:, 0, 0, 2]
    assert np.allclose(height, 5.0 + 3.0 * time - G * time**2 / 2, atol=G * 0.01 * 0.5)
    simulator.close()


@simulators
def test_angular_velocity_is_in_the_world_frame(name: str) -> None:
    """Report a spin about the world's axes, and turn by it counter-clockwise, quaternions wxyz."""
    simulator, description = build(name, FLYING)
    spin = field(description, simulator.state(), "cubes/angular_velocity")[0, 0]
    assert np.allclose(spin, (0.0, 0.0, 2.0), atol=1e-6)
    before = field(description, simulator.state(), "cubes/orientation")[0, 0].copy()
    simulator.step(1)
    after = field(description, simulator.state(), "cubes/orientation")[0, 0]
    delta = _multiply(after, before * (1, -1, -1, -1))
    assert np.allclose(2 * delta[1:] / 0.01 * np.sign(delta[0]), (0.0, 0.0, 2.0), atol=0.05)
    states = simulator.states(50)
    ball = field(description, states, "ball/angular_velocity")[:, 0, 0]
    assert np.allclose(ball, (0.3, -0.2, 0.1), atol=1e-5)
    orientations = field(description, states, "cubes/orientation")
    assert np.allclose(np.linalg.norm(orientations, axis=-1), 1.0, atol=1e-5)
    simulator.close()


@simulators
def test_the_ball_rolls_down_the_slope(name: str) -> None:
    """Accelerate at 5/7 g sin(20 deg), as a solid sphere does that rolls without slipping, within 3 %."""
    simulator, description = build(name, make_scene("inclined-collision"), n_env=1)
    velocity = field(description, simulator.states(40), "ball/linear_velocity")[:, 0, 0]
    speed = np.linalg.norm(velocity, axis=-1)
    acceleration = (speed[35] - speed[10]) / 0.25
    assert acceleration == pytest.approx(5 / 7 * G * math.sin(SLOPE_ANGLE), rel=0.03)
    simulator.close()


@simulators
def test_a_stack_at_rest_stays(name: str) -> None:
    """Keep a stack that nothing hits within 1 mm for half a second."""
    scene = make_scene("inclined-collision")
    resting = replace(scene, bodies=tuple(b for b in scene.bodies if b.name not in ("ball", "slope")))
    simulator, description = build(name, resting, n_env=1)
    before = field(description, simulator.state(), "cubes/position").copy()
    simulator.step(50)
    after = field(description, simulator.state(), "cubes/position")
    assert np.abs(after - before).max() < 1e-3
    simulator.close()


@simulators
def test_stepping_and_capturing_agree(name: str) -> None:
    """Reach the same bits by step, by states, and in blocks of any size."""
    scene = make_scene("inclined-collision")
    stepped, description = build(name, scene)
    stepped.step(60)
    captured, _ = build(name, scene)
    captured.states(47)
    last = captured.states(13)
    for a, b in zip(stepped.state(), last, strict=True):
        assert a.tobytes() == b[-1].tobytes()
    stepped.close()
    captured.close()


@simulators
def test_gates_stay_silent_in_a_good_run(name: str) -> None:
    """Fire no gate where nothing is wrong."""
    simulator, _ = build(name, make_scene("inclined-collision"))
    simulator.step(60)
    assert simulator.gates() == []
    simulator.close()


def _multiply(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    w, v = p[0] * q[0] - p[1:] @ q[1:], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.array([w, *v])


class TestMujoco:
    """MuJoCo C in particular."""

    def test_equals_a_plain_loop(self) -> None:
        """Give the bits of mj_step called by hand."""
        import mujoco

        simulator, description = build("mujoco", make_scene("inclined-collision"))
        model = mujoco.MjModel.from_xml_string(description.attachments["scene.xml"][1].decode())
        data = mujoco.MjData(model)
        for _ in range(80):
            mujoco.mj_step(model, data)
        simulator.step(80)
        cubes = field(description, simulator.state(), "cubes/position")
        expected = data.qpos.reshape(-1, 7)[1:, :3]  # the ball comes first
        assert all(cubes[env].tobytes() == np.ascontiguousarray(expected).tobytes() for env in range(2))

    @pytest.mark.parametrize("threads", ["1", "3"])
    def test_threads_change_nothing(self, threads: str) -> None:
        """Give the same bits on any number of threads."""
        states = []
        for count in ("2", threads):
            simulator, _ = build("mujoco", make_scene("inclined-collision"), n_env=5, threads=count)
            states.append(simulator.states(60))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(*states, strict=True))

    def test_a_warning_is_a_gate(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Report MuJoCo's own warnings, once."""
        monkeypatch.chdir(tmp_path)  # MuJoCo writes its log to the working folder
        scene = make_scene("free-fall")
        fast = replace(scene.bodies[1], linear_velocity=(1e12, 0.0, 0.0), orientation=IDENTITY)
        simulator, _ = build("mujoco", replace(scene, bodies=(scene.bodies[0], fast)))
        simulator.step(2)
        (fired,) = simulator.gates()
        assert "mjWARN_BADQ" in fired
        assert simulator.gates() == []

    def test_options_are_those_in_force(self) -> None:
        """Record what the compiled model has, in the words of MJCF."""
        import mujoco

        asked = {"integrator": "RK4", "solver": "CG", "iterations": "7", "tolerance": "1e-5", "impratio": "2.5",
                 "solref": "-1e3 -2", "solimp": ".8 .9 1e-3 0.5 2", "condim": "4", "threads": "1"}  # fmt: skip
        _, description = build("mujoco", make_scene("inclined-collision"), **asked)
        options = description.options
        assert options == {
            "integrator": "RK4", "cone": "elliptic", "solver": "CG", "iterations": 7, "ls_iterations": 50,
            "tolerance": 1e-5, "impratio": 2.5, "solref": "-1000 -2", "solimp": "0.8 0.9 0.001 0.5 2", "condim": 4,
            "threads": 1,
        }  # fmt: skip
        model = mujoco.MjModel.from_xml_string(description.attachments["scene.xml"][1].decode())
        assert (model.geom_solref == [-1000, -2]).all()
        assert (model.geom_condim == 4).all()
        _, description = build("mujoco", make_scene("franka"))
        assert (description.options["solref"], description.options["solimp"]) == ("0.02 1", "0.9 0.95 0.001 0.5 2")

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            *((name, value) for name in ("tolerance", "impratio") for value in ("nan", "inf", "-1")),
            *((name, value) for name in ("iterations", "ls_iterations") for value in ("0", "-5")),
            *(("solref", v) for v in ("", "1", "nan 1", "inf 1", "0.02 -1", "0 1", "0.02 1 2", "-5 3")),
            *(("solimp", v) for v in ("", "0.9 0.95", "0 0.9 0.001 0.5 2", "0.9 1 0.001 0.5 2", "0.9 0.95 -1 0.5 2",
                                      "0.9 0.95 0.001 nan 2", "0.9 0.95 0.001 0.5 0.5")),
            ("impratio", "0"), ("condim", "2"), ("threads", "-1"),
        ],
    )  # fmt: skip
    def test_values_that_mujoco_would_replace(self, name: str, value: str) -> None:
        """Refuse values for which MuJoCo has others, instead of recording what was not in force."""
        with pytest.raises(UsageError, match=name):
            build("mujoco", make_scene("inclined-collision"), **{name: value})
