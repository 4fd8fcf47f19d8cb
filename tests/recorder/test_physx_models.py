"""Model files on PhysX: kinematics, accelerations, energy and contacts against MuJoCo's, and what PhysX has otherwise.

All of it on the CPU. PhysX's solver PGS moves positions once a step, as MuJoCo's integrator Euler does, so that the two
can be compared closely; TGS, the default, moves them in as many parts as it has iterations.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("ovphysx")

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.schemas.model_files import pack
from tests.recorder import engines
from tests.recorder.mixed_model import (
    MIXED,
    TOUCHING,
    answer_trials,
    hold_parameters,
    hold_places,
    move_by_actuator,
    reset_alone,
    scene_of,
    step_alike,
    stepped,
    wedge,
    world,
)

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"


_open: list[Simulator] = []


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    """Ends what a test leaves open, so that the next one is its own."""
    yield
    while _open:
        _open.pop().close()


def _physx(scene: ModelScene, **options: Any) -> tuple[Any, Description]:
    simulator = engines.make("physx", scene, threads=1, **options)
    _open.append(simulator)
    return simulator, simulator.build()


def _states(simulator: Simulator, description: Description, steps: int) -> dict[str, np.ndarray[Any, Any]]:
    """Fields by name over some steps, with positions relative to the environment's origin; and no gate fires."""
    found = stepped(simulator, description, steps)
    if "bodies/position" in found and description.env_origins:
        found["bodies/position"] = found["bodies/position"] - np.array(description.env_origins)[:, None]
    simulator.close()
    _open[:] = [other for other in _open if other is not simulator]
    return found


def _both(scene: ModelScene, steps: int, **options: Any) -> tuple[Any, Any]:
    """States of PhysX and of MuJoCo C under the same controls."""
    return _states(*_physx(scene, **options), steps), _states(*engines.build("mujoco", scene), steps)


def test_kinematics(tmp_path: Path) -> None:
    """Put the bodies of random states where MuJoCo puts them, and read the states back: quaternions, centres of mass,
    reference angles, chains of joints and welds are all taken as PhysX means them, in every environment."""
    simulator, description = _physx(scene_of(MIXED, tmp_path), n_env=5)
    model = simulator._model.compiled.model
    assert simulator.imported().names["bodies"][: model.nbody] == tuple(model.body(b).name for b in range(model.nbody))
    for seed in range(3):
        hold_places(simulator, description, seed)


def test_accelerations(tmp_path: Path) -> None:
    """Make the step of MuJoCo from random states: masses, inertias, gravity, armature, damping, motors of joints and of
    a tendon, clamped controls and forces, and servos, in floating and fixed trees."""
    simulator, description = _physx(scene_of(MIXED, tmp_path), n_env=4, solver="PGS", contact_offset=1e-4)
    for seed in range(3):
        step_alike(simulator, description, seed, 2e-3)


CART = world(
    '<body name="cart" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/><geom type="box" size=".2 .1 .1" mass="2"'
    '/><body name="pole"><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .1 0 .6" size=".04" mass="1"'
    ' contype="0"/><body name="tip" pos=".1 0 .6"><joint name="b" axis="0 1 0"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 .4" size=".03" mass=".5" contype="0"/></body></body></body>',
    '<actuator><motor joint="x" gear="5"/></actuator>',
    'timestep="0.002" integrator="Euler"',
)


def test_the_same_motion(tmp_path: Path) -> None:
    """Follow MuJoCo C over 100 steps of a double pendulum on a cart that environments drive differently."""
    physx, wanted = _both(scene_of(CART, tmp_path), 100, solver="PGS")
    for name, array in wanted.items():
        np.testing.assert_allclose(physx[name], array, atol=2e-5 if name.endswith("qpos") else 2e-4, err_msg=name)
    assert (physx["joints/qpos"][-1, 0] != physx["joints/qpos"][-1, 1]).any()


def test_energy(tmp_path: Path) -> None:
    """Keep the energy of a double pendulum that nothing drives or brakes, with the default solver."""
    text = CART.replace('<actuator><motor joint="x" gear="5"/></actuator>', "")
    scene = scene_of(text, tmp_path, actions="none")
    simulator, description = _physx(scene, n_env=2)
    compiled = simulator._model.compiled
    compiled.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    start = np.zeros((2, 3, 1))
    start[:, 1:, 0] = [[0.5, -1.0], [2.0, 0.3]]
    simulator.set_state((start, np.zeros_like(start)))
    energies = []
    for states in ((start, np.zeros_like(start)), simulator.states(500)):
        last = [np.array(array[-1] if array.ndim == 4 else array) for array in states]
        qpos, qvel = compiled.joined(tuple(last))
        rows = []
        for env in range(2):
            data = mujoco.MjData(compiled.model)
            data.qpos[:], data.qvel[:] = qpos[env], qvel[env]
            mujoco.mj_forward(compiled.model, data)
            rows.append([data.energy.sum(), data.energy[1]])
        energies.append(np.array(rows))
    assert (energies[1][:, 1] > 0.5).all()  # it swings
    np.testing.assert_allclose(energies[1][:, 0], energies[0][:, 0], rtol=0.01)


def test_turns(tmp_path: Path) -> None:
    """Count the turns of a hinge without limits, which PhysX would wrap."""
    text = world(
        '<body name="r" pos="0 0 1"><joint name="spin" axis="0 0 1"/><geom type="capsule" size=".05 .2" mass="1"/>'
        '</body>', '<keyframe><key qvel="30"/></keyframe>', 'gravity="0 0 0" timestep="0.01"',
    )  # fmt: skip
    physx, wanted = _both(scene_of(text, tmp_path), 80)
    np.testing.assert_allclose(physx["joints/qpos"], wanted["joints/qpos"], rtol=1e-4)
    assert physx["joints/qpos"].max() > 23


def test_what_may_touch(tmp_path: Path) -> None:
    """Keep apart what MuJoCo keeps apart, geom by geom, in every environment: masks, and geoms of one body of which
    one falls through a table that holds the other."""
    physx, wanted = _both(scene_of(world(TOUCHING), tmp_path), 300, n_env=3)
    heights = physx["bodies/position"][-1, :, :, 2]
    np.testing.assert_allclose(heights, [[0.1, 0.7, 0.45]] * 3, atol=2e-3)
    np.testing.assert_allclose(heights[:2], wanted["bodies/position"][-1, :, :, 2], atol=2e-3)


@pytest.mark.parametrize(("condim", "friction"), [(3, 0.5), (1, 0.0)])
def test_friction(condim: int, friction: float, tmp_path: Path) -> None:
    """Brake a box by the larger of two coefficients, and not at all where no contact of it has friction."""
    text = world(
        f'<geom type="plane" size="9 9 .1" friction=".1" condim="{condim}"/><body name="box" pos="0 0 .1"><freejoint/>'
        f'<geom type="box" size=".2 .2 .1" friction=".5" condim="{condim}"/></body>',
        '<keyframe><key qpos="0 0 .1 1 0 0 0" qvel="2 0 0 0 0 0"/></keyframe>',
    )
    simulator, description = _physx(scene_of(text, tmp_path))
    assert not [d for d in description.deviations if d.parameter == "contact.pair_friction"]
    speed = _states(simulator, description, 40)["bodies/linear_velocity"][:, 0, 0, 0]
    np.testing.assert_allclose(speed[-1] - speed[9], -friction * 9.81 * 30 * 0.005, atol=0.02)


def test_a_pair_of_another_friction(tmp_path: Path) -> None:
    """Name the pair whose friction PhysX's rule does not give."""
    text = world(
        '<geom name="floor" type="plane" size="9 9 .1" condim="3"/><body pos="0 0 1"><freejoint/>'
        '<geom name="a" size=".1" condim="1" friction=".7"/></body>'
        '<body pos="1 0 1"><freejoint/><geom name="b" size=".1" condim="1"/></body>'
    )
    simulator, description = _physx(scene_of(text, tmp_path))
    (found,) = [d for d in description.deviations if d.parameter == "contact.pair_friction"]
    assert (found.wanted, found.used) == ("a and b 0", "a and b 1")


HINGE = '<body name="r"><joint name="j" axis="0 0 1" {0}/><geom type="capsule" size=".1 .2" mass="1"/></body>'


def _held(joint: str, actuator: str, control: float, folder: Path) -> ModelScene:
    """A hinge whose actuator, if there is one, is given this control."""
    key = f'<keyframe><key ctrl="{control}"/></keyframe>' if actuator else ""
    text = world(
        HINGE.format(joint),
        f"<actuator>{actuator}</actuator>{key}",
        'gravity="0 0 0" timestep="0.01" integrator="implicitfast"',
    )
    return scene_of(text, folder, actions="keyframe" if actuator else "none")


@pytest.mark.parametrize(
    ("joint", "actuator", "wanted"),
    [
        ('stiffness="5" damping="1" springref="40"', "", np.radians(40)),
        ('damping="1"', '<position joint="j" kp="9"/>', 0.8),
        ('damping="1" stiffness="3" springref="30" ref="10"', '<position joint="j" kp="6"/>', None),
        ('stiffness="4"', '<position joint="j" kp="8" kv="2"/>', 1.6 / 3),
        ('damping="1"', '<position joint="j" kp="8" kv="2" ctrlrange="-.3 .3"/>', 0.3),
        ('damping="1" stiffness="4"', '<motor joint="j" gear="3" forcerange="-.5 .5"/>', 1.5 / 4),
        ('damping="1" stiffness="4" actuatorfrcrange="-1 1"', '<motor joint="j" gear="3"/>', 0.25),
    ],
)  # fmt: skip
def test_where_drives_come_to_rest(joint: str, actuator: str, wanted: float | None, tmp_path: Path) -> None:
    """Rest where springs, servos and clamped motors balance, as in MuJoCo."""
    physx, other = _both(_held(joint, actuator, 0.8, tmp_path), 400)
    np.testing.assert_allclose(physx["joints/qpos"][-1], other["joints/qpos"][-1], atol=2e-3)
    if wanted is not None:
        np.testing.assert_allclose(physx["joints/qpos"][-1], wanted, atol=2e-3)


def test_a_velocity_servo(tmp_path: Path) -> None:
    """Turn as fast as a velocity servo and damping let it."""
    physx, _ = _both(_held('damping="1"', '<velocity joint="j" kv="3"/>', 2, tmp_path), 200)
    np.testing.assert_allclose(physx["joints/qvel"][-1], 1.5, rtol=1e-3)


def test_friction_of_a_joint(tmp_path: Path) -> None:
    """Hold against less than a joint's frictionloss, and lose that much above it."""
    motor = '<motor joint="j"/>'
    still, _ = _both(_held('frictionloss="1"', motor, 0.9, tmp_path), 50)
    assert np.abs(still["joints/qpos"]).max() < 1e-3
    moved, wanted = _both(_held('frictionloss="1"', motor, 1.5, tmp_path), 50)
    np.testing.assert_allclose(moved["joints/qvel"][-1], wanted["joints/qvel"][-1], rtol=0.02)


def test_controls_that_end(tmp_path: Path) -> None:
    """Give zeros after forces, and keep no force of an earlier step."""
    simulator, _ = _physx(scene_of(CART.replace("0 0 -9.81", "0 0 0"), tmp_path), n_env=2)
    simulator.prepare(np.ones((5, 2, 1), dtype=np.float32))
    simulator.step(5)
    simulator.prepare(np.zeros((3, 2, 1), dtype=np.float32))
    simulator.step(3)
    bindings = simulator._arms._targets[0][0]
    held = np.empty(bindings["ACTUATION_FORCE"].shape, dtype=np.float32)
    bindings["ACTUATION_FORCE"].read(held)
    assert not held.any()


def test_its_states(tmp_path: Path) -> None:
    """Save, restore, reset and set states of some environments; the others keep their bits, and steps go on the same
    way."""
    simulator, description = _physx(scene_of(MIXED, tmp_path, actions="none"), n_env=3)
    first = simulator.state()
    simulator.step(3)
    saved = simulator.snapshot()
    after = simulator.states(3)
    simulator.restore(saved)
    again = simulator.states(3)
    for a, b in zip(after, again, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    reset_alone(simulator, description, first)


def test_what_it_holds(tmp_path: Path) -> None:
    """Hold MuJoCo's masses, inertias, limits, springs and friction of joints, as read from the engine; and a model with
    another mass and another limit differs in these two."""
    simulator, _ = _physx(scene_of(MIXED, tmp_path))
    found = hold_parameters(simulator.imported())
    assert sum(f.kind == "bodies" for f in found) == 5


def test_trials(tmp_path: Path) -> None:
    """Answer the trials of gsb-import: poses relative to each environment's origin, and actuators each in one of its
    own."""
    move_by_actuator(answer_trials(scene_of(MIXED, tmp_path), "physx", threads=1))


def test_a_spring_of_a_free_joint(tmp_path: Path) -> None:
    """Name it among the deviations: PhysX's free bodies have no springs."""
    free = '<body pos="0 0 1"><joint type="free" stiffness="50"/><geom size=".1"/></body>'
    simulator, description = engines.build("physx", scene_of(world(free), tmp_path))
    simulator.close()
    found = {deviation.parameter: deviation for deviation in description.deviations}
    assert found["bodies.stiffness"].used == "0"


REFUSED = {
    "ball joint 'shoulder'": world('<body><joint name="shoulder" type="ball"/><geom size=".1"/></body>'),
    "ellipsoid 'egg', which collides": world(
        '<body><joint/><geom name="egg" type="ellipsoid" size=".1 .1 .2"/></body>'
    ),
    "constraint of equality 'loop'": world(
        '<body name="r"><joint/><geom size=".1"/></body>',
        '<equality><connect name="loop" body1="r" anchor="0 0 0"/></equality>',
    ),
    "tendon 'rope', which has stiffness": world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<tendon><fixed name="rope" stiffness="3"><joint joint="j" coef="1"/></fixed></tendon>',
    ),
    "actuator 'muscle'": world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<actuator><muscle name="muscle" joint="j" lengthrange="0 1"/></actuator>',
    ),
    "contact pair 0": world(
        '<geom name="f" type="plane" size="1 1 1"/><body><joint/><geom name="g" size=".1"/></body>',
        '<contact><pair geom1="f" geom2="g"/></contact>',
    ),
    "plane 'slope', which is not level": world(
        '<geom name="slope" type="plane" size="1 1 1" euler="0 10 0"/><body><joint/><geom size=".1"/></body>'
    ),
    "servo of joint 'j'": world(
        '<body><joint name="j" damping="1"/><geom size=".1"/></body>',
        '<actuator><position joint="j" kp="1" forcerange="-1 1"/></actuator>',
    ),
}


@pytest.mark.parametrize("said", REFUSED)
def test_refusals(said: str, tmp_path: Path) -> None:
    """Refuse by its name what PhysX is not given, before it starts."""
    simulator = engines.make("physx", scene_of(REFUSED[said], tmp_path))
    with pytest.raises(Refused) as raised:
        simulator.build()
    assert said in str(raised.value)


def test_the_walker() -> None:
    """Refuse the example for its ball joint."""
    with pytest.raises(Refused, match="ball joint 'shoulder'|ball joint"):
        engines.make("physx", model_scene("walker", pack(WALKER))).build()


NAMED = {
    "model.density": world('<body><joint/><geom size=".1"/></body>', option='density="3"'),
    "joints.limit_solref": world('<body><joint range="-9 9"/><geom size=".1"/></body>'),
    "joints.solreffriction": world('<body><joint frictionloss="1"/><geom size=".1"/></body>'),
    "bodies.added": world('<body><joint/><joint axis="0 1 0"/><geom size=".1"/></body>'),
    "bodies.damping": world('<body><joint type="free" damping="1"/><geom size=".1"/></body>'),
    "bodies.gravity_compensation": world('<body gravcomp=".5"><joint/><geom size=".1"/></body>'),
    "contact.condim": world('<geom type="plane" size="1 1 1"/><body><freejoint/><geom size=".1" condim="6"/></body>'),
    "geoms.margin": world('<geom type="plane" size="1 1 1"/><body><freejoint/><geom size=".1" margin=".1"/></body>'),
    "bodies.massless": world('<body><joint/><geom size=".1"/><body><geom size=".1" mass="0"/></body></body>'),
    "contact.pairs": world(
        '<body><joint/><geom size=".1"/><body><joint/><geom size=".1"/></body></body>',
        option='timestep="0.01"><flag filterparent="disable"/></option><option',
    ),
    "option.disableflags": world(
        '<body><joint/><geom size=".1"/></body>', option='timestep="0.01"><flag spring="disable"/></option><option'
    ),
}  # fmt: skip


@pytest.mark.parametrize("parameter", NAMED)
def test_what_it_has_otherwise(parameter: str, tmp_path: Path) -> None:
    """Name what PhysX has otherwise, and nothing of it where the model does not have it."""
    simulator, description = _physx(scene_of(NAMED[parameter], tmp_path))
    found = {d.parameter for d in description.deviations}
    assert found & set(NAMED) == {parameter}
    assert "option" in found


def test_gravity_that_is_compensated(tmp_path: Path) -> None:
    """Leave a body alone whose gravity the model compensates, and let the other fall."""
    body = '<body name="{0}" pos="{1} 0 1" gravcomp="{2}"><freejoint/><geom size=".1"/></body>'
    text = world(body.format("floats", 0, 1) + body.format("falls", 1, 0))
    physx, wanted = _both(scene_of(text, tmp_path), 50)
    np.testing.assert_allclose(physx["bodies/position"], wanted["bodies/position"], atol=2e-2)
    assert physx["bodies/position"][-1, 0, 0, 2] == pytest.approx(1, abs=1e-4)


def test_a_mesh(tmp_path: Path) -> None:
    """Rest a mesh on its face, as high as MuJoCo does."""
    simulator, description = _physx(wedge(tmp_path))
    assert "contact.meshes" in {d.parameter for d in description.deviations}
    height = _states(simulator, description, 150)["bodies/position"][-1, :, 0, 2]
    np.testing.assert_allclose(height, 0.05, atol=2e-3)
