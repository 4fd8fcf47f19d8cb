"""Model files, and scenes with robots, on Newton: layout, states, controls and energy against MuJoCo's, and what
Newton has otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Body, Material, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mujoco.drives import Places, drives
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options
from gpusimbench.recorder.simulators.newton.mujoco_terms import as_mujoco_has_it
from gpusimbench.recorder.simulators.newton.options import FOR_MODELS, NewtonOptions
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.imported import PARAMETERS
from gpusimbench.schemas.model_files import pack
from tests.conftest import call
from tests.recorder import engines

engines.needed("newton")

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"


def _gymnasium(name: str) -> Path:
    found = find_spec("gymnasium")
    if found is None:
        pytest.skip("gymnasium is not installed")
    return Path(str(found.origin)).parent / "envs" / "mujoco" / "assets" / f"{name}.xml"


def _scene(path: Path, **more: str) -> ModelScene:
    return model_scene(path.stem, pack(path), **more)


def _written(folder: Path, body: str, rest: str = "") -> Path:
    path = folder / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{body}</worldbody>{rest}</mujoco>")
    return path


def _imported(scene: Scene, solver: str = "mujoco", **more: Any) -> tuple[Any, MjcfModel]:
    from gpusimbench.recorder.simulators.newton.model import one_world
    from gpusimbench.recorder.simulators.newton.solvers import register
    from gpusimbench.recorder.simulators.warp import runtime

    runtime.start("cpu")
    compiled = compile_scene(scene, dt=scene.dt, options=own_options(scene))
    options = NewtonOptions(solver=solver, **more)
    return one_world(scene, compiled, options, register(options)), compiled


def _places(world: Any) -> Places:
    return Places(world.imported.at_q, world.imported.at_qd, world.builder.joint_dof_count)


def _random_state(compiled: MjcfModel, seed: int) -> tuple[Any, tuple[Any, ...]]:
    """A mujoco.MjData with a random state of everything that moves, and that state as a recording has it."""
    rng = np.random.default_rng(seed)
    model, data = compiled.model, mujoco.MjData(compiled.model)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data, compiled.split(data.qpos[None], data.qvel[None])


MODELS = [WALKER, *(name for name in ("ant", "humanoid", "half_cheetah", "reacher", "swimmer", "inverted_pendulum"))]


@pytest.mark.parametrize("which", MODELS, ids=lambda which: which if isinstance(which, str) else which.stem)
def test_kinematics(which: Path | str) -> None:
    """Put the bodies of random states where MuJoCo puts them, as fast and turning as fast, and read the states back:
    quaternions, frames of velocities, centres of mass and reference angles are all taken as Newton means them."""
    import newton
    import warp as wp

    scene = _scene(which if isinstance(which, Path) else _gymnasium(which))
    world, compiled = _imported(scene)
    model = world.builder.finalize(device="cpu")
    state = model.state()
    for seed in range(5):
        data, given = _random_state(compiled, seed)
        joint_q, joint_qd = world.layout.joined(given)
        q, qd = (wp.array(a[0].astype(np.float32), device="cpu") for a in (joint_q, joint_qd))
        newton.eval_fk(model, q, qd, state)
        bodies = world.imported.bodies[1:]
        poses, velocities = state.body_q.numpy()[bodies], state.body_qd.numpy()[bodies]
        np.testing.assert_allclose(poses[:, :3], data.xpos[1:], atol=2e-5)
        turned = np.abs(np.sum(poses[:, [6, 3, 4, 5]] * data.xquat[1:], axis=1))
        np.testing.assert_allclose(turned, 1, atol=1e-5)
        for body, velocity in enumerate(velocities, start=1):
            found = np.zeros(6)  # angular, then linear of the centre of mass
            mujoco.mj_objectVelocity(compiled.model, data, mujoco.mjtObj.mjOBJ_BODY, body, found, 0)
            np.testing.assert_allclose(velocity[3:], found[:3], atol=5e-5)
            np.testing.assert_allclose(velocity[:3], found[3:], atol=2e-4)
        back = world.layout.split(q.numpy()[None, None], qd.numpy()[None, None])
        for field, a, b in zip(world.layout.fields(), back, given, strict=True):
            np.testing.assert_allclose(a[0], b, atol=2e-5, err_msg=field.name)


@pytest.fixture(scope="module")
def walker() -> Iterator[tuple[Any, Any, Any, Any]]:
    """The walker on Newton's solver mujoco: simulator, description, states of 40 steps, and those of MuJoCo C."""
    scene = _scene(WALKER)
    newton, description = engines.build("newton", scene, n_env=3)
    other, _ = engines.build("mujoco", scene, n_env=3)
    other.prepare(scene.actions.draw(0, n_env=3, first_step=0, n_step=40))
    newton.compile("capture")
    yield newton, description, newton.states(40), other.states(40)
    newton.close()


@pytest.mark.slow
def test_the_same_motion(walker: tuple[Any, Any, Any, Any]) -> None:
    """Move as on MuJoCo C under the same controls, in the same layout: position, velocity and torque actuators, one of
    them on a tendon, a floating base, a ball joint, a free body and a mesh."""
    simulator, description, states, others = walker
    other, _ = engines.build("mujoco", simulator.scene, n_env=3)
    names = [(f.name, f.items, f.units, f.frame, f.components) for f in description.fields]
    assert names == [(f.name, f.items, f.units, f.frame, f.components) for f in other._compiled.fields("float32")]
    for field, a, b in zip(description.fields, states, others, strict=True):
        assert a.dtype == np.float32
        atol = 1e-3 if "vel" in field.name else 2e-5
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=atol, err_msg=field.name)
    assert (states[0][-1, 0] != states[0][-1, 1]).any()  # environments have controls of their own
    evidence = simulator.evidence()
    assert not evidence.overflow.any()
    assert evidence.counts["contacts"].max() > 0


@pytest.mark.slow
def test_a_robot_of_a_scene() -> None:
    """Move the franka as on MuJoCo C, with the same targets and force limits, in the same layout."""
    scene = make_scene("franka")
    simulator, description = engines.build("newton", scene, n_env=2)
    other, _ = engines.build("mujoco", scene, n_env=2)
    other.prepare(scene.actions.draw(0, n_env=2, first_step=0, n_step=50))
    simulator.compile("capture")
    states, others = simulator.states(50), other.states(50)
    simulator.close()
    assert description.fields == other._compiled.fields("float32")
    for field, a, b, atol in zip(description.fields, states, others, (2e-5, 2e-3), strict=True):
        np.testing.assert_allclose(a, b, atol=atol, err_msg=field.name)
    assert (states[0][-1, 0] != states[0][-1, 1]).any()  # environments have targets of their own
    assert {d.parameter for d in description.deviations if "Newton" in d.reason} == {"contact.pairs"}
    assert not any("autoreset" in remark for remark in description.remarks)


@pytest.mark.slow
def test_its_own_contacts() -> None:
    """Count the option 'gap' of Newton's own collision detection among the options, and not among the deviations."""
    simulator, description = engines.build("newton", make_scene("franka"), n_env=1, use_mujoco_contacts=False)
    simulator.close()
    assert description.options["gap"] == 0.01
    assert not [d.parameter for d in description.deviations if "gap" in d.parameter]


@pytest.mark.slow
@pytest.mark.parametrize("solver", [name for name in FOR_MODELS if name != "mujoco"])
def test_a_pendulum_on_other_solvers(solver: str) -> None:
    """Swing the pendulum, which has no servo, as on MuJoCo C; xpbd errs more at this step, so it is given less time."""
    scene = make_scene("pendulum")
    simulator, _ = engines.build("newton", scene, n_env=1, solver=solver)
    other, _ = engines.build("mujoco", scene, n_env=1)
    simulator.compile("capture")
    steps = 20 if solver == "xpbd" else 100
    states, others = simulator.states(steps), other.states(steps)
    simulator.close()
    swung = np.abs(others[0][-1] - others[0][0]).max()
    assert swung > 0.01
    np.testing.assert_allclose(states[0], others[0], atol=0.2 * swung if solver == "xpbd" else 1e-5)


def _among_bodies() -> Scene:
    """The pendulum, and a ball that rebounds from a floor beside it."""
    rubber, wood = Material("rubber", 0.9, 0.8, 0.5), Material("wood", 0.5, 0.4, 0.0)
    bodies = (
        Body("floor", Plane(), wood, (0.0, 0.0, 0.0)),
        Body("ball-1", Sphere(0.05), rubber, (0.6, -0.4, 0.3), mass=0.3, group="balls"),
    )
    return replace(make_scene("pendulum"), name="mixed/1", bodies=bodies, actions=None)


def test_materials_among_bodies() -> None:
    """Give every shape of a scene with a robot the scene's restitution, no friction against spinning or rolling, and
    the stiffness that the options ask for, where solvers other than MuJoCo's read these of shapes."""
    from gpusimbench.recorder.simulators.newton.deviations import deviations

    scene = _among_bodies()
    world, _ = _imported(scene, "steel", ke=5000.0, kd=7.0)
    builder = world.builder
    shapes = {label.rpartition("/")[2]: shape for shape, label in enumerate(builder.shape_label)}
    assert {name: builder.shape_material_restitution[shape] for name, shape in shapes.items()} == {
        "ball-1": 0.5, "floor": 0.0, "rod_0": 0.0, "stand_0": 0.0
    }  # fmt: skip
    assert builder.shape_material_mu[shapes["ball-1"]] == pytest.approx(0.8)
    for shape in shapes.values():
        assert builder.shape_material_mu_torsional[shape] == builder.shape_material_mu_rolling[shape] == 0
        assert (builder.shape_material_ke[shape], builder.shape_material_kd[shape]) == (5000, 7)
    said = {d.parameter: d.used for d in deviations(scene, NewtonOptions(solver="steel"))}
    assert said["joint.max_velocity"] == "not enforced"
    assert {"rubber.restitution", "wood.restitution", "steel.restitution"} <= set(said)
    assert "joint.max_torque" not in said  # the pendulum has no servo
    held = replace(make_scene("franka"), actions=None)
    assert "joint.max_torque" in {d.parameter for d in deviations(held, NewtonOptions(solver="steel"))}


@pytest.mark.slow
def test_a_robot_among_bodies() -> None:
    """Let a ball rebound beside a pendulum as in the same scene without the pendulum, and name no option or contact
    parameter of MuJoCo's as the scene's."""
    scene = _among_bodies()
    found = []
    for one in (scene, replace(scene, robot=None)):
        simulator, description = engines.build("newton", one, n_env=1, solver="steel")
        simulator.compile("capture")
        states = simulator.states(60)
        simulator.close()
        at = [f.name for f in description.fields].index("balls/position")
        found.append((states[at][:, 0, 0, 2], {d.parameter for d in description.deviations}))
    (beside, said), (alone, said_alone) = found
    np.testing.assert_allclose(beside, alone, atol=1e-4)
    assert beside[24:].max() > 0.06  # higher than it rests
    assert said - said_alone == {"steel.static_friction", "steel.restitution", "joint.max_velocity"}


@pytest.mark.parametrize(
    ("name", "solver", "said"),
    [
        ("franka", "steel", "with these options it has no actions: use solver=mujoco"),
        ("pendulum", "kamino", "no fixed-base robots or hinge joints: use solver=mujoco, xpbd, featherstone or steel"),
        ("four-bar", "mujoco", "it has no closed loops"),
    ],
)
def test_robots_that_a_solver_does_not_take(name: str, solver: str, said: str) -> None:
    """Refuse before a build what Newton's importer, or a solver, would make otherwise."""
    adapter = find_simulator("newton").adapter()
    assert said in adapter.refusal("newton", make_scene(name), adapter.Options(solver=solver))


def test_its_controls(walker: tuple[Any, Any, Any, Any]) -> None:
    """Hold the controls that are drawn for the last step, to the bit."""
    simulator = walker[0]
    drawn = simulator.scene.actions.draw(0, n_env=3, first_step=39, n_step=1)[0]
    np.testing.assert_array_equal(simulator.applied(), drawn)


def test_what_it_has_otherwise(walker: tuple[Any, Any, Any, Any]) -> None:
    """Say of the walker that nothing is lost, and that MuJoCo Warp takes no tolerance of 1e-8."""
    assert {d.parameter: (d.wanted, d.used) for d in walker[1].deviations} == _RAISED


_RAISED = {"option.tolerance": ("1e-08", "1e-06")}

_SOFT = """
<geom name="floor" type="plane" size="1 1 .1" conaffinity="2"/>
<body name="upper" pos="0 0 1">
  <joint name="soft" axis="0 1 0" limited="true" range="-30 30" solreflimit="0.05 1" solimplimit=".8 .9 .01 .5 2"/>
  <geom type="sphere" size=".1" contype="4" conaffinity="4"/>
  <body name="lower" pos="0 0 -.3">
    <joint name="free" axis="0 1 0"/>
    <geom name="tip" type="sphere" size=".1" contype="4" conaffinity="4"/>
  </body>
</body>
"""


@pytest.mark.parametrize("solver", FOR_MODELS)
def test_soft_limits_and_pairs(solver: str, tmp_path: Path) -> None:
    """Say which solvers have nothing for soft limits of joints and for pairs of geoms, whose masks say otherwise."""
    pair = '<contact><pair geom1="floor" geom2="tip" friction=".3 .3 .01 .01 .01"/></contact>'
    simulator, description = engines.build("newton", _scene(_written(tmp_path, _SOFT, pair)), n_env=2, solver=solver)
    said = {d.parameter: (d.wanted, d.used) for d in description.deviations}
    if solver == "mujoco":
        limits = simulator._worlds.solver.mj_model.jnt_solref[0]
        simulator.close()
        assert said == _RAISED
        np.testing.assert_allclose(limits, (0.05, 1))
        return
    simulator.close()
    assert said["contact.pairs"] == ("world and lower collide", "do not collide")
    assert said["pairs"] == ("parameters of 1 pair of geoms", "parameters of the shapes")
    used = "springs of ke 10000 and kd 10" if solver == "featherstone" else "hard"
    assert said["joints.limit_solref"] == ("of each limited joint", used)


def test_as_many_contacts_of_convex_shapes_as_mujoco(tmp_path: Path) -> None:
    """Make all contacts of a mesh that lies on a box as MuJoCo does, and one where the file says so."""
    corners = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))
    body = (
        '<geom type="box" size="1 1 .1" pos="0 0 -.1"/>'
        '<body pos="0 0 .0999"><freejoint/><geom type="mesh" mesh="cube" mass="1"/></body>'
    )
    found = []
    for flag in ("", '<option><flag multiccd="disable"/></option>'):
        rest = f'<asset><mesh name="cube" vertex="{corners}"/></asset>{flag}'
        simulator, description = engines.build("newton", _scene(_written(tmp_path, body, rest)), n_env=1)
        simulator.compile("capture")
        simulator.states(1)
        found.append(int(simulator.evidence().counts["contacts"][-1, 0]))
        simulator.close()
        assert {d.parameter for d in description.deviations} == _RAISED.keys()
    assert found == [4, 1]


def test_its_states(walker: tuple[Any, Any, Any, Any]) -> None:
    """Save, restore and set states of some worlds; the others keep their bits, and steps go on the same way."""
    simulator = walker[0]
    saved = simulator.snapshot()
    after = simulator.states(3)
    simulator.restore(saved)
    again = simulator.states(3)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(after, again, strict=True))
    simulator.restore(saved)
    before = simulator.state()
    _, given = _random_state(simulator._compiled, 3)
    simulator.set_state(given, np.array([1]))
    for field, was, now, wanted in zip(simulator._world.layout.fields(), before, simulator.state(), given, strict=True):
        np.testing.assert_allclose(now[1], wanted[0], atol=1e-5, err_msg=field.name)
        assert now[[0, 2]].tobytes() == was[[0, 2]].tobytes()


@pytest.mark.parametrize(("solver", "lost"), [("xpbd", True), ("featherstone", False)])
def test_what_recorded_states_do_not_have(tmp_path: Path, solver: str, lost: bool) -> None:
    """Say of a solver whose bodies can be off their joints that recorded joints do not have that; a snapshot has it."""
    link = '<joint axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>'
    chain = f'<body>{link}<body pos=".3 0 0">{link}</body></body>'
    scene = _scene(_written(tmp_path, chain))
    simulator, description = engines.build("newton", scene, n_env=1, solver=solver)
    assert any("which may be off their joints" in remark for remark in description.remarks) == lost
    simulator.compile("capture")
    simulator.states(30)
    saved = simulator.snapshot()
    after = simulator.states(1)
    simulator.restore(saved)
    assert [array.tobytes() for array in simulator.states(1)] == [array.tobytes() for array in after]
    simulator.restore(saved)
    simulator.set_state(simulator.state())
    again = simulator.states(1)
    simulator.close()
    apart = max(float(np.abs(a - b).max()) for a, b in zip(after, again, strict=True))
    assert apart > 1e-4 if lost else apart < 1e-5


def test_energy() -> None:
    """Begin with MuJoCo's mass and energy, in every Gymnasium model whose bodies are imported as MuJoCo has them."""
    for name in ("ant", "hopper", "inverted_double_pendulum", "reacher", "swimmer", "walker2d"):
        world, compiled = _imported(_scene(_gymnasium(name)))
        data, given = _random_state(compiled, 1)
        if name in ("hopper", "walker2d"):  # whose rooty turns about another point, see below
            data.qpos[:], data.qvel[:] = compiled.qpos0, 0
            mujoco.mj_forward(compiled.model, data)
            given = compiled.split(data.qpos[None], data.qvel[None])
        compiled.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        mujoco.mj_forward(compiled.model, data)
        assert not compiled.model.jnt_stiffness.any()
        potential, kinetic = _energy(world, given, compiled.scene.gravity)
        assert sum(world.builder.body_mass) == pytest.approx(compiled.model.body_mass.sum(), rel=1e-6)
        assert potential == pytest.approx(data.energy[0], rel=1e-4, abs=1e-4)
        assert kinetic == pytest.approx(data.energy[1], rel=1e-3, abs=1e-4)


def _energy(world: Any, given: tuple[Any, ...], gravity: tuple[float, ...]) -> tuple[float, float]:
    import newton
    import warp as wp

    model = world.builder.finalize(device="cpu")
    state = model.state()
    arrays = (wp.array(a[0].astype(np.float32), device="cpu") for a in world.layout.joined(given))
    newton.eval_fk(model, *arrays, state)
    poses, velocities = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
    mass, inertia, centres = (getattr(model, f"body_{name}").numpy() for name in ("mass", "inertia", "com"))
    potential = kinetic = 0.0
    for body, (pose, velocity) in enumerate(zip(poses, velocities, strict=True)):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, pose[[6, 3, 4, 5]])
        turn = turn.reshape(3, 3)
        centre = pose[:3] + turn @ centres[body]
        potential -= mass[body] * float(np.dot(gravity, centre))
        turning = turn.T @ velocity[3:]
        kinetic += mass[body] * float(velocity[:3] @ velocity[:3]) / 2 + float(turning @ inertia[body] @ turning) / 2
    armature = model.joint_armature.numpy()
    speeds = world.layout.joined(given)[1][0]
    return potential, kinetic + float(armature @ speeds**2) / 2


def _made(scene: ModelScene, solver: str) -> dict[str, tuple[str, str, str]]:
    simulator, description = engines.build("newton", scene, n_env=1, solver=solver)
    simulator.close()
    return {d.parameter: (d.wanted, d.used, d.reason) for d in description.deviations}


def test_names_of_quantities() -> None:
    """Call what is compared as gsb-import calls it, so that deviations and its tables name a parameter alike."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    assert set(as_mujoco_has_it(model)) <= {f"{p.kind}.{p.name}" for p in PARAMETERS}


@pytest.mark.slow
def test_what_the_importer_loses() -> None:
    """Name what Newton's importer makes otherwise: masses that the compiler scales, a hinge's anchor, tiny inertias."""
    cheetah = _made(_scene(_gymnasium("half_cheetah")), "mujoco")
    assert cheetah["bodies.mass"][0].startswith("torso 6.25")
    assert cheetah["bodies.mass"][1].startswith("torso 9.45")
    hopper = _made(_scene(_gymnasium("hopper")), "mujoco")
    assert hopper["joints.anchor"][:2] == ("rooty 0 0 0", "rooty 0 0 -1.25")
    pusher = _made(_scene(_gymnasium("pusher")), "mujoco")
    assert "object" in pusher["bodies.inertia"][0]


FALLING = """
<body name="a" pos="0 0 2"><joint name="slide" type="slide" axis="1 0 0" damping="2" armature="0.1"/>
<geom size="0.1" mass="1"/><body name="b" pos="0 0 0.3"><joint name="hinge" axis="0 1 0" frictionloss="0.1"/>
<geom size="0.1" pos="0.2 0 0" mass="1"/></body></body>
"""


@pytest.mark.slow
@pytest.mark.parametrize("solver", [name for name in FOR_MODELS if name != "mujoco"])
def test_other_solvers(solver: str, tmp_path: Path) -> None:
    """Drive a slide by a motor and a hinge by a position servo with each solver that takes models: both go where MuJoCo
    takes them. The joints have no damping or armature, which not every solver reads."""
    path = _written(
        tmp_path, FALLING.replace('frictionloss="0.1"', "").replace('damping="2" armature="0.1"', ""),
        '<actuator><motor name="push" joint="slide" gear="2" ctrlrange="0.5 1"/>'
        '<position name="turn" joint="hinge" kp="20" kv="2" ctrlrange="0.2 0.3"/></actuator>',
    )  # fmt: skip
    scene = _scene(path)
    more = {"iterations": 50} if solver == "xpbd" else {}
    simulator, _ = engines.build("newton", scene, n_env=2, solver=solver, **more)
    other, _ = engines.build("mujoco", scene, n_env=2)
    other.prepare(scene.actions.draw(0, n_env=2, first_step=0, n_step=100))
    simulator.compile("capture")
    states, wanted = simulator.states(100)[0][-1, :, :, 0], other.states(100)[0][-1, :, :, 0]
    simulator.close()
    assert (wanted > 0.01).all()
    # how stiff a servo of xpbd is depends on its iterations
    np.testing.assert_allclose(states, wanted, rtol=0.4 if solver == "xpbd" else 0.1)


def test_what_a_solver_does_not_read(tmp_path: Path) -> None:
    """Name damping, armature and dry friction of joints, and equalities, where a solver has none of them."""
    from gpusimbench.recorder.simulators.newton.deviations import deviations_of_import

    held = '<equality><joint name="held" joint1="hinge"/><weld body1="a"/></equality>'
    scene = _scene(_written(tmp_path, FALLING, held))
    world, compiled = _imported(scene, "xpbd")
    model = world.builder.finalize(device="cpu")
    found = {d.parameter: d for d in deviations_of_import(model, None, world.imported, compiled.model, "xpbd")}
    assert (found["joints.damping"].wanted, found["joints.damping"].used) == ("slide 2", "slide 0")
    assert found["joints.armature"].reason == "solver xpbd has no armature"
    assert found["joints.frictionloss"].wanted == "hinge 0.1"
    assert (found["held"].wanted, found["equality1"].wanted) == (
        "constraint of equality, joint", "constraint of equality, weld"
    )  # fmt: skip
    assert "bodies.mass" not in found
    assert "integrator Euler" in found["option"].wanted


@pytest.mark.parametrize(
    ("actuator", "said"),
    [
        ('<general name="a" joint="hinge" gaintype="affine" gainprm="1 1"/>', "cannot be given actuator 'a'"),
        ('<position name="a" joint="hinge" gear="2"/>', "cannot be given actuator 'a'"),
        ('<muscle name="a" joint="hinge" lengthrange="0 1"/>', "cannot be given actuator 'a'"),
        ('<position joint="hinge"/><velocity name="v" joint="hinge"/>', "actuator 'v' is another on its joint"),
    ],
)
def test_actuators_that_a_solver_cannot_be_given(actuator: str, said: str, tmp_path: Path) -> None:
    """Refuse by name an actuator that is neither a motor nor a servo."""
    world, compiled = _imported(_scene(_written(tmp_path, FALLING, f"<actuator>{actuator}</actuator>")), "xpbd")
    with pytest.raises(Refused, match=said):
        drives(compiled.model, _places(world), "xpbd", remedy="")


def test_an_actuator_that_the_importer_loses(tmp_path: Path) -> None:
    """Refuse a model with a tendon over two bodies of two hinges each: Newton's importer leaves the tendon out."""
    body = """
      <body pos="0 0 1"><joint name="a" axis="1 0 0"/><joint name="b" axis="0 1 0"/><geom size=".1"/>
        <body pos="0 0 -0.4"><joint name="c" axis="1 0 0"/><joint name="d" axis="0 1 0"/><geom size=".1"/></body>
      </body>
    """
    more = """
      <tendon><fixed name="both"><joint joint="a" coef="1"/><joint joint="c" coef="1"/></fixed></tendon>
      <actuator><motor tendon="both" ctrlrange="-1 1"/><motor joint="d" ctrlrange="-1 1"/></actuator>
    """
    with pytest.raises(Refused, match="makes 1 of the model's 2 actuators, and lacks the tendons both"):
        engines.build("newton", _scene(_written(tmp_path, body, more)), n_env=1)


def test_a_motor_on_a_tendon() -> None:
    """Turn a tendon's force into forces of its joints, with their coefficients and the gear."""
    world, compiled = _imported(_scene(WALKER), "xpbd")
    made = drives(compiled.model, _places(world), "xpbd", remedy="")
    joints = [world.imported.at_qd[compiled.model.joint(name).id] for name in ("left_hip", "right_hip")]
    assert made.arms[:, 3].nonzero()[0].tolist() == sorted(joints)
    assert made.arms[joints, 3].tolist() == [1, -1]
    assert made.servo[joints[1]].tolist() == [1, -1]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (
            '<body><joint axis="0 1 0"/><joint type="slide"/><geom size=".1"/></body>',
            "puts the slides of body 'body1' before its hinges",
        ),
        (
            '<body><joint type="slide"/><joint type="ball"/><geom size=".1"/></body>',
            "importer does not read robot.xml: ValueError",
        ),
    ],
)
def test_models_that_it_would_move_otherwise(body: str, said: str, tmp_path: Path) -> None:
    """Refuse joints of which Newton would make others."""
    with pytest.raises(Refused, match=said):
        _imported(_scene(_written(tmp_path, body)))


def test_names(tmp_path: Path) -> None:
    """Find bodies and joints by name where the importer reads bodies in frames after their siblings, and those without
    names in their order."""
    path = _written(
        tmp_path,
        '<body name="base"><freejoint/><geom size=".1"/><frame pos="0 0 .2"><body name="x-1"><joint name="j1"/>'
        '<geom size=".1" mass="1"/></body></frame><body name="two"><joint name="j2"/><geom size=".1" mass="2"/></body>'
        '<body pos="0 .3 0"><joint type="slide"/><geom size=".1" mass="3"/></body></body>',
    )  # fmt: skip
    world, compiled = _imported(_scene(path))
    masses = [world.builder.body_mass[body] for body in world.imported.bodies[1:]]
    np.testing.assert_allclose(masses, compiled.model.body_mass[1:], rtol=1e-5)
    assert {f.name: f.items for f in world.layout.fields()}["joints/qpos"] == ("j1", "j2", "joint3")


def test_urdf(tmp_path: Path) -> None:
    """Read a URDF file by way of MuJoCo's MJCF of it, its mesh in another folder, and get MuJoCo's robot."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "foot.obj").write_bytes((WALKER.parent / "meshes" / "foot.obj").read_bytes())
    (tmp_path / "urdf").mkdir()
    path = tmp_path / "urdf" / "robot.urdf"
    path.write_text(
        '<robot name="r"><mujoco><compiler meshdir="../meshes"/></mujoco><link name="a"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="b"><inertial><mass '
        'value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry><mesh '
        'filename="foot.obj"/></geometry></collision></link><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0 .3"/><axis xyz="0 0 1"/></joint></robot>'
    )
    world, compiled = _imported(_scene(path))
    masses = [world.builder.body_mass[body] for body in world.imported.bodies[1:]]
    np.testing.assert_allclose(masses, compiled.model.body_mass[1:], rtol=1e-6)
    assert masses == [2.0]
    assert compiled.model.nmesh == len(world.builder.shape_type) == 1
    assert {f.name: f.items for f in world.layout.fields()}["joints/qpos"] == ("j",)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--solver", "vbd"), "with these options it has no model files: use solver=mujoco, xpbd"),
        (("--option", "mujoco_solver=PGS"), "mujoco_solver is one of Newton, CG, not 'PGS'"),
    ],
)
def test_options_that_cannot_be(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    """Refuse solvers that take no models, and a constraint solver that Newton has not."""
    done = call("gsb-record", "--sim", "newton", "--model", WALKER, *arguments, "--out", tmp_path, code=ExitCode.USAGE)
    assert said in done.stderr


def test_pgs() -> None:
    """Take the file's own solver for an option, refuse PGS, and read the model where another is asked for."""
    from gpusimbench.recorder.simulators.newton.simulator import Newton

    scene = _scene(_gymnasium("humanoid"))
    with pytest.raises(UsageError, match="does not take humanoid: mjSOL_PGS; --option solver=Newton replaces"):
        Newton.parsed("newton", scene, {})
    options = Newton.parsed("newton", scene, {"mujoco_solver": "Newton"})
    assert (options.iterations, options.cone) == (50, "pyramidal")
    assert Newton.parsed("newton", scene, {"solver": "Newton"}) == options
    given = Newton.parsed("newton", scene, {"solver": "CG"})
    assert (given.solver, given.mujoco_solver, given.iterations) == ("mujoco", "CG", 50)
    with pytest.raises(UsageError, match="contradict"):
        Newton.parsed("newton", scene, {"solver": "Newton", "mujoco_solver": "CG"})
    assert Newton.parsed("newton", scene, {"solver": "xpbd"}).iterations == 0
    assert _imported(scene)[0].imported is not None
