"""PhysX in particular: its numbers held against formulas, its log, its clones. All of it on the CPU."""

from __future__ import annotations

import ctypes
import logging
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.emit.usd import emit_usd
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.physx import bodies, libraries, session
from gpusimbench.recorder.simulators.physx.deviations import deviations
from gpusimbench.recorder.simulators.physx.options import PhysxOptions, apis
from gpusimbench.recorder.simulators.physx.simulator import Physx
from gpusimbench.schemas.errors import GsbError, UsageError

G = 9.81
DT = 0.01

OVERFLOWS = (
    "Reached limit set by PxSceneDesc::maxNbContactDataBlocks - ran out of buffer space for narrow phase. Either "
    "accept dropped contacts or increase the limit",
    "Not enough GPU memory available to create a PhysicsScene, falling back to CPU simulation.",
    "PhysX error: Contact buffer overflow detected, please increase its size to at least 9000 in the scene desc!, FILE",
    "Patch buffer overflow detected, please increase its size to at least 300 in the scene desc!",
    "Friction patch buffer overflow detected, please increase its size in the scene desc!",
    "PxGpuDynamicsMemoryConfig::collisionStackSize buffer overflow detected, please increase its size to at least 70000"
    " in the scene desc! Contacts have been dropped.",
    "The application needs to increase PxGpuDynamicsMemoryConfig::foundLostPairsCapacity to 5000, otherwise, the "
    "simulation will miss interactions",
    "The application needs to increase PxGpuDynamicsMemoryConfig::totalAggregatePairsCapacity to 5 , otherwise, the "
    "simulation will miss interactions",
    "Replicator: automatic environment id 16777216 exceeds the PhysX limit (1<<24) on this attach; the clone will "
    "collide with all environments (env-id space exhausted).",
)


@pytest.fixture
def engine() -> None:
    """Skips where PhysX is not installed."""
    for name in ("ovphysx", "ovstage", "warp"):
        pytest.importorskip(name)


def build(scene: Scene, *, n_env: int = 2, determinism: str = "default", **options: str) -> tuple[Physx, Description]:
    """A built simulator on the CPU."""
    parsed = parse_options("physx", PhysxOptions, {"device": "cpu", "threads": "1", **options})
    simulator = Physx(scene, n_env=n_env, dt=DT, seed=0, options=parsed, determinism=determinism)
    try:
        return simulator, simulator.build()
    except BaseException:
        simulator.close()
        raise


def captured(scene: Scene, steps: int, *, n_env: int = 1, **options: str) -> dict[str, np.ndarray]:
    """Fields by name over some steps, [step, env, item, component], positions relative to the env's origin."""
    simulator, description = build(scene, n_env=n_env, **options)
    states = simulator.states(steps)
    gates = simulator.gates()
    simulator.close()
    assert not gates
    found = {layout.name: array for layout, array in zip(description.fields, states, strict=True)}
    for name in found:
        if name.endswith("/position"):
            found[name] = found[name] - np.array(description.env_origins)[:, None]
    return found


def scene_of(*bodies: Body) -> Scene:
    """A scene with these bodies."""
    return Scene(name="made up", summary="of a test", bodies=bodies)


# --- without the engine


@pytest.mark.parametrize("line", OVERFLOWS)
def test_signs_of_dropped_contacts(line: str) -> None:
    """Every line that PhysX has for dropped contacts is fatal, whatever its level; other warnings are not."""
    assert session.is_fatal(logging.WARNING, line)


def test_other_lines() -> None:
    """An error is fatal, and a warning that drops nothing is not."""
    assert session.is_fatal(logging.ERROR, "PhysX error: PxScene::simulate(): anything, FILE x, LINE 1")
    assert not session.is_fatal(logging.WARNING, "EnvIds requested but gpu dynamic is disabled.")
    assert not session.is_fatal(
        logging.WARNING, "PxgPinnedHostLinearMemoryAllocator: overflowing initial allocation size"
    )


@given(st.integers(1, 400), st.floats(0.1, 100))
def test_grid(n_env: int, spacing: float) -> None:
    """Origins are apart, fill a square, and those of the first environments are the same for any number."""
    places = session.grid_origins(n_env, spacing)
    assert len(set(places)) == len(places) == n_env
    assert places == session.grid_origins(n_env + 17, spacing)[:n_env]
    side = math.isqrt(n_env - 1)
    assert max(max(x, y) for x, y, _ in places) == spacing * side
    assert session.grid_origins(n_env, 0.0) == ()


def test_bodies_that_environments_share() -> None:
    """Planes serve all environments of a grid, all fixed bodies those of one place."""
    assert session.shared_bodies(make_scene("free-fall"), 4.0) == ("ground",)
    assert session.shared_bodies(make_scene("inclined-collision"), 4.0) == ()
    assert session.shared_bodies(make_scene("inclined-collision"), 0.0) == ("board", "slope")
    steep = Body(
        "steep", Plane(), Material("wood", 1, 1, 0), (0, 0, 0), orientation=(math.cos(0.1), 0, math.sin(0.1), 0)
    )
    assert session.shared_bodies(scene_of(steep), 0.0) == ("steep",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "XPBD"}, "solver is one of TGS, PGS"),
        ({"friction_combine": "sum"}, "friction_combine is one of average"),
        ({"bounce_threshold": "0"}, "bounce_threshold is at least 1e-06 m/s"),
        ({"spacing": "-1"}, "spacing is a number from 0 on"),
        ({"spacing": "nan"}, "spacing is a finite number"),
        ({"position_iterations": "0"}, "position_iterations is from 1 to 255"),
        ({"rest_offset": "0.01"}, "rest_offset is less than contact_offset"),
        ({"collision_stack": str(2**32)}, "collision_stack is at most 4294967295 bytes"),
    ],
)
def test_options(options: dict[str, str], message: str) -> None:
    """Values that PhysX would not take, or would replace, are refused in one sentence."""
    with pytest.raises(UsageError, match=re.escape(message)):
        parse_options("physx", PhysxOptions, options)


def test_what_a_gpu_is_given() -> None:
    """On a GPU its own dynamics, broad phase and buffers are asked for; on the CPU none of them."""
    scene = make_scene("free-fall")
    sizes = {"gpuMaxRigidContactCount": 5, "gpuTempBufferCapacity": 7}
    text = emit_usd(scene, apis=apis(PhysxOptions(), gpu=True, enhanced=True, capacities=sizes))
    for line in (
        "bool physxScene:enableGPUDynamics = true",
        'uniform token physxScene:broadphaseType = "GPU"',
        "bool physxScene:enableEnhancedDeterminism = true",
        "uint physxScene:gpuMaxRigidContactCount = 5",
        "uint64 physxScene:gpuTempBufferCapacity = 7",
    ):
        assert line in text
    text = emit_usd(scene, apis=apis(PhysxOptions(), gpu=False, enhanced=False, capacities={}))
    assert "bool physxScene:enableGPUDynamics = false" in text
    assert "physxScene:gpu" not in text


def test_sizes_of_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Buffers grow with the environments, on MuJoCo's count or by shapes; what cannot be given is refused."""
    from gpusimbench.recorder.simulators.physx import sizes

    pytest.importorskip("mujoco")
    scene = replace(make_scene("inclined-collision"), sample_time=0.1)
    few, many = (sizes.choose_buffers(scene, n_env=n_env, dt=DT, seed=0, options=PhysxOptions()) for n_env in (64, 128))
    by_name = {buffer.name: buffer for buffer in few}
    assert "needed by 1 envs of MuJoCo C" in by_name["gpuMaxRigidContactCount"].sized_by
    # 28 bodies, of which 9 cubes stand on the board and the others on cubes, four points each
    assert by_name["gpuMaxRigidContactCount"].asked >= 2 * 64 * 4 * 27
    assert all(a.asked <= b.asked and a.per == "all" and a.sized_by for a, b in zip(few, many, strict=True))
    asked = sizes.choose_buffers(scene, n_env=3, dt=DT, seed=0, options=PhysxOptions(max_contacts=5, collision_stack=9))
    assert (asked[0].asked, asked[-1].asked) == (15, 9)
    assert sizes.choose_buffers(scene, n_env=1 << 17, dt=DT, seed=0, options=PhysxOptions())[-1].asked == sizes.LARGEST
    with pytest.raises(Refused, match="is at most 4294967295"):
        sizes.choose_buffers(scene, n_env=10**8, dt=DT, seed=0, options=PhysxOptions())
    monkeypatch.setattr(sizes, "find_spec", lambda name: None)
    need = sizes.measure(scene, dt=DT, seed=0, options=PhysxOptions())
    assert need.pairs == 28 * 14
    assert "MuJoCo C not being installed" in need.found_by


def test_deviations_say_how_materials_meet() -> None:
    """Only rules that a scene does not give deviate; a threshold of rebounds does where there is one."""
    scene = make_scene("inclined-collision")
    usual = {d.parameter for d in deviations(scene, PhysxOptions())}
    assert usual == {"contact.friction_combination", "contact.restitution_combination", "contact.friction"}
    assert "contact.restitution" in {d.parameter for d in deviations(scene, PhysxOptions(bounce_threshold=0.2))}


@given(arrays(np.float32, (16, 4), elements=st.floats(-1, 1, width=32)))
def test_orientations_are_what_they_become(given: np.ndarray) -> None:
    """What is written for a normalised quaternion becomes the same bits, or, where nothing does, is as it was."""
    wanted = bodies.normalised(given[(np.abs(given) > 0.01).any(axis=1)])
    written = bodies.to_write(wanted)
    same = (bodies.normalised(written) == wanted).all(axis=1)
    assert np.array_equal(written[~same], wanted[~same])
    assert np.abs(np.linalg.norm(written, axis=1) - 1).max(initial=0) < 0.008


def test_orientations_are_nearly_always_found() -> None:
    """Of ten thousand orientations nearly three in ten do not survive being written; all but a few then do."""
    drawn = np.random.default_rng(0).normal(size=(10000, 4)).astype(np.float32)
    wanted = bodies.normalised(drawn)
    assert (bodies.normalised(wanted) != wanted).any(axis=1).sum() > 2000
    assert (bodies.normalised(bodies.to_write(wanted)) != wanted).any(axis=1).sum() < 5
    nothing = np.full((2, 4), np.nan, dtype=np.float32)
    assert np.isnan(bodies.to_write(nothing)).all()


# --- with the engine


@pytest.mark.usefixtures("engine")
def test_first_state_is_exact() -> None:
    """Clones begin at the sum of origin and position, rounded once; what turns or leans within two roundings."""
    from gpusimbench.recorder.simulators.physx.bodies import described

    leaning = Body(
        "stone", Box((0.02, 0.04, 0.06)), Material("stone", 0.5, 0.4, 0.3), (0.1, 0.2, 5.0), 0.1, "stones",
        orientation=(0.5, 0.1, 0.7, 0.5), linear_velocity=(0.1, -0.7, 3.3), angular_velocity=(1.3, -0.1, 0.7),
    )  # fmt: skip
    for scene, exact in ((make_scene("inclined-collision"), True), (scene_of(leaning), False)):
        simulator, description = build(scene, n_env=7, spacing="3.3")
        given = simulator._source.split(described(scene, description.env_origins, 7)[None])
        for layout, found, wanted in zip(description.fields, simulator.state(), given, strict=True):
            if exact or layout.field in ("position", "linear_velocity"):
                assert found.tobytes() == wanted[0].tobytes(), layout.name
            assert np.allclose(found, wanted[0], rtol=2.5e-7, atol=0), layout.name
        simulator.close()


@pytest.mark.usefixtures("engine")
def test_restitution_of_a_pair() -> None:
    """A ball rebounds with the mean of the two coefficients, or as another rule says, at any speed or above one."""

    def rebound(**options: str) -> float:
        ground = Body("ground", Plane(), Material("wood", 0.5, 0.4, 0.4), (0.0, 0.0, 0.0))
        ball = Body("ball", Sphere(0.02), Material("304 steel", 0.5, 0.4, 0.55), (0.0, 0.0, 0.07), 0.1, "ball")
        speed = captured(scene_of(ground, ball), 20, **options)["ball/linear_velocity"][:, 0, 0, 2]
        after = int(np.argmax(speed > 0)) or int(np.argmax(speed > -0.01))
        return float(-speed[after] / speed[after - 1])

    assert math.isclose(rebound(), 0.475, rel_tol=1e-4)
    assert math.isclose(rebound(restitution_combine="max"), 0.55, rel_tol=1e-4)
    assert math.isclose(rebound(restitution_combine="multiply"), 0.22, rel_tol=1e-4)
    assert rebound(bounce_threshold="2.0") < 0.01


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize(("once", "grows"), [("true", True), ("false", False)])
def test_how_gravity_is_applied(once: str, grows: bool) -> None:
    """A pendulum without friction gains energy where TGS applies gravity in every iteration, and keeps it elsewhere."""
    states = captured(make_scene("pendulum"), 500, external_forces_every_iteration=once)
    angle = np.abs(states["robot/qpos"].ravel())
    swings = float(angle[-200:].max() / angle[:200].max())  # 200 steps are more than a period
    assert (swings > 1.05) is grows
    assert grows or abs(swings - 1) < 1e-3


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("solver", ["TGS", "PGS"])
def test_kinetic_friction(solver: str) -> None:
    """A cube that slides is slowed by the mean kinetic coefficient, whatever the static ones."""
    ground = Body("ground", Plane(), Material("wood", 0.9, 0.2, 0.0), (0.0, 0.0, 0.0))
    wax = Material("wax", 0.8, 0.3, 0.0)
    cube = Body("cube", Box((0.1, 0.1, 0.1)), wax, (0.0, 0.0, 0.05), 1.0, "cubes", linear_velocity=(2.0, 0.0, 0.0))
    speed = captured(scene_of(ground, cube), 20, n_env=2, solver=solver)["cubes/linear_velocity"][:, :, 0, 0]
    assert np.allclose((speed[4] - speed[14]) / (10 * DT * G), 0.25, rtol=1e-3)


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize(("slope", "slides"), [(0.30, False), (0.45, True)])
def test_static_friction(slope: float, slides: bool) -> None:
    """A cube stays on a slope that kinetic friction alone would not hold it on, and slides down a steeper one."""
    half = math.atan(slope) / 2
    lean = (math.cos(half), 0.0, math.sin(half), 0.0)
    wood = Material("wood", 0.4, 0.2, 0.0)
    normal = (math.sin(2 * half), 0.0, math.cos(2 * half))
    ramp = Body("ramp", Box((2.0, 2.0, 0.02)), wood, (0.0, 0.0, 0.0), orientation=lean)
    place = (0.02 * normal[0], 0.0, 0.02 * normal[2])
    cube = Body("cube", Box((0.02, 0.02, 0.02)), wood, place, 0.005, "cubes", orientation=lean)
    speed = np.linalg.norm(captured(scene_of(ramp, cube), 40)["cubes/linear_velocity"][-1, 0, 0])
    expected = G * (math.sin(2 * half) - 0.2 * math.cos(2 * half)) * 40 * DT
    assert math.isclose(speed, expected, rel_tol=0.01) if slides else speed < 0.005


@pytest.mark.usefixtures("engine")
def test_enhanced_determinism_does_not_see_other_environments() -> None:
    """With it, environment 0 does the same bits alone as among three."""
    scene = make_scene("inclined-collision")
    alone, among = (captured(scene, 60, n_env=n_env, determinism="enhanced") for n_env in (1, 3))
    for name, array in alone.items():
        assert array[:, 0].tobytes() == among[name][:, 0].tobytes(), name


@pytest.mark.usefixtures("engine")
def test_stack_stands_until_the_ball_comes() -> None:
    """Cubes that exactly touch stay within 0.1 mm for 40 steps: no step was made in building."""
    position = captured(make_scene("inclined-collision"), 40, n_env=2)["cubes/position"]
    assert np.abs(position - position[:1]).max() < 1e-4


@pytest.mark.usefixtures("engine")
def test_one_place_needs_a_gpu() -> None:
    """On the CPU environments at the same place would collide, and are refused; one alone is not."""
    with pytest.raises(UsageError, match="'spacing' is above 0 where PhysX runs on the CPU"):
        build(make_scene("free-fall"), spacing="0")
    simulator, description = build(make_scene("free-fall"), n_env=1, spacing="0")
    assert description.env_origins == ()
    simulator.close()


@pytest.mark.usefixtures("engine")
def test_lines_of_the_engine_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that the engine itself prints fires a gate, once."""
    monkeypatch.setattr(session, "_DROPPED", re.compile("EnvIds requested"))  # what it says of clones on a CPU
    simulator, _ = build(make_scene("free-fall"))
    assert simulator.gates() == [
        "PhysX says, 1 times: EnvIds requested but gpu dynamic is disabled.",
        "PhysX says, 1 times: EnvIds requested but gpu broadphase is not set.",
    ]
    assert simulator.gates() == []
    simulator.close()


@pytest.mark.usefixtures("engine")
def test_a_process_stays_on_the_cpu() -> None:
    """Once kept from the GPU, the engine is for good, and says so."""
    build(make_scene("free-fall"), n_env=1)[0].close()
    with pytest.raises(GsbError, match="use a fresh process"):
        libraries.choose_processor(gpu=True)


@pytest.mark.usefixtures("engine")
def test_missing_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a shared library does not load, its name and what to install are said."""

    def fail(*arguments: Any, **named: Any) -> None:
        raise OSError("libGL.so.1: cannot open shared object file: No such file or directory")

    libraries.load.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(ctypes, "CDLL", fail)
        with pytest.raises(UsageError, match=r"libGL\.so\.1: cannot open"):
            libraries.load()


@pytest.mark.usefixtures("engine")
def test_arm_holds_as_in_mujoco() -> None:
    """With the first angles as targets, the arm sags under gravity as far as MuJoCo's, to 0.05 mrad.

    TGS gets there as its iterations grow: 1.4 mrad lower with 16 of them.
    """
    mujoco = pytest.importorskip("mujoco")
    from gpusimbench.recorder.simulators.mujoco.model import compile_scene
    from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

    scene = make_scene("franka")
    steps = 200
    simulator, _ = build(scene, n_env=3, solver="PGS")
    targets = np.tile(np.array(scene.robot.start, dtype=np.float32), (steps, 3, 1))
    simulator.prepare(targets)
    simulator.step(steps)
    applied = simulator.applied()
    angles, speeds = simulator.state()
    simulator.close()
    assert applied is not None
    assert np.array_equal(applied, targets[-1])
    assert np.abs(speeds).max() < 1e-4
    compiled = compile_scene(scene, dt=DT, options=MjcfOptions())
    data = compiled.data()
    data.ctrl[:] = scene.robot.start
    for _ in range(steps):
        mujoco.mj_step(compiled.model, data)
    assert np.abs(angles[:, :, 0] - data.qpos).max() < 5e-5


@pytest.mark.usefixtures("engine")
def test_drives_are_as_described() -> None:
    """The engine holds the description's stiffness, damping, torque, speed limits, armature and friction."""
    scene = make_scene("franka")
    simulator, _ = build(scene)
    from ovphysx.types import TensorType

    def held(name: str) -> np.ndarray:
        with libraries.quiet():
            binding = simulator._session.physx.create_tensor_binding(
                pattern="/World/envs/env*/panda", tensor_type=TensorType[f"ARTICULATION_DOF_{name}"]
            )
        values = np.empty(binding.shape, dtype=np.float32)
        binding.read(values)
        binding.destroy()
        return values

    joints = scene.robot.joints()
    assert np.allclose(held("STIFFNESS"), [j.stiffness for j in joints])
    assert np.allclose(held("DAMPING"), [j.damping for j in joints])
    assert np.allclose(held("MAX_FORCE"), [j.max_torque for j in joints])
    assert (held("MAX_VELOCITY") > 1000).all()  # as in all other engines
    assert np.allclose(held("ARMATURE"), [j.armature for j in joints])
    assert np.allclose(held("LIMIT"), [(j.lower, j.upper) for j in joints])
    assert np.allclose(held("FRICTION_PROPERTIES"), [(0.0, 0.0, j.friction) for j in joints])
    simulator.close()


@pytest.mark.usefixtures("engine")
def test_poses_come_back_bit_for_bit() -> None:
    """After the ball has struck, all that is shown is restored, orientations too, which PhysX normalises."""
    simulator, description = build(make_scene("inclined-collision"), n_env=4)
    simulator.step(120)
    before, snapshot = simulator.state(), simulator.snapshot()
    simulator.step(10)
    simulator.restore(snapshot)
    after = simulator.state()
    simulator.close()
    for layout, one, other in zip(description.fields, before, after, strict=True):
        assert one.tobytes() == other.tobytes(), layout.name


@pytest.mark.usefixtures("engine")
def test_reset_forgets_contacts() -> None:
    """With enhanced determinism, reset after the ball has struck is a fresh start, bit for bit, of some envs too."""
    simulator, _ = build(make_scene("inclined-collision"), n_env=3, determinism="enhanced")
    first = simulator.states(100)
    simulator.reset(np.array([0, 2]))
    again = simulator.states(60)
    simulator.close()
    for one, other in zip(first, again, strict=True):
        assert one[:60, [0, 2]].tobytes() == other[:, [0, 2]].tobytes()
        assert one[40:, 1].tobytes() != other[:, 1].tobytes()


@pytest.mark.usefixtures("engine")
def test_states_that_are_not_finite_are_refused() -> None:
    """On a CPU PhysX takes no velocity that is not a number: that ends the run, in the engine's words."""
    simulator, description = build(make_scene("free-fall"))
    simulator.step(1)
    given = simulator.state()
    velocities = [layout.field for layout in description.fields].index("linear_velocity")
    given[velocities][:] = np.nan
    with pytest.raises(Refused, match="PhysX does not take this state: .*velocity is not valid"):
        simulator.set_state(given)
    simulator.close()


@pytest.mark.usefixtures("engine")
def test_arms_are_reset_and_set() -> None:
    """Reset arms move as in the beginning, bit for bit; others, and what was not set, stay as they are."""
    scene = make_scene("franka")
    simulator, _ = build(scene, n_env=3)
    first = simulator.state()
    drawn = np.random.default_rng(0).normal(size=(30, 3, len(scene.robot.start))) * 0.3
    targets = (np.array(scene.robot.start) + drawn).astype(np.float32)
    simulator.prepare(targets)
    moved = simulator.states(30)
    before, snapshot = simulator.state(), simulator.snapshot()
    assert snapshot.step == 30
    some = np.array([0, 2])
    simulator.reset(some)
    for start, earlier, now in zip(first, before, simulator.state(), strict=True):
        assert now[some].tobytes() == start[some].tobytes()
        assert now[1].tobytes() == earlier[1].tobytes()
    simulator.prepare(targets)
    for one, other in zip(moved, simulator.states(30), strict=True):
        assert one[:, some].tobytes() == other[:, some].tobytes()
    simulator.restore(snapshot)
    given = tuple(array[[1]] + np.float32(0.125) for array in first)
    simulator.set_state(given, np.array([1]))
    found = simulator.state()
    simulator.close()
    for wanted, earlier, now in zip(given, before, found, strict=True):
        assert now[[1]].tobytes() == wanted.tobytes()
        assert now[some].tobytes() == earlier[some].tobytes()
