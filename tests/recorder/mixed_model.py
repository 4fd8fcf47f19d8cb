"""What tests of engines that are given model files share: a model, scenes of texts, drawn states and steps.

The model has a floating and a fixed tree, several joints on a body, references, offsets, motors and servos.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gpusimbench.evaluator.imports.parameters import ParameterDifference, compare
from gpusimbench.recorder.run.import_phase import tried
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel
from gpusimbench.schemas.imported import Imported, Trials
from gpusimbench.schemas.model_files import pack
from tests.recorder.engines import make

LEG = """
  <body name="{side}thigh" pos="{y} 0 -.1" quat=".9 .1 .3 0">
    <joint name="{side}hip" axis="0 1 .2" pos="0 0 .02" range="-80 60" ref="10" damping=".4" armature=".02"/>
    <geom type="capsule" fromto="0 0 0 .1 0 -.3" size=".04" mass="1.2"/>
    <body name="{side}foot" pos=".1 0 -.3"><geom type="box" size=".08 .04 .02" pos=".05 0 0" mass=".3"/></body>
    <body name="{side}shin" pos=".1 0 -.3" euler="0 20 5">
      <joint name="{side}knee" axis="1 0 0" range="-1 90" damping=".1"/>
      <joint name="{side}roll" axis="0 0 1" pos=".01 .02 0" range="-90 90" armature=".01"/>
      <joint name="{side}reach" type="slide" axis="0 .3 -1" range="-.5 .5" damping="2"/>
      <geom type="cylinder" size=".03 .15" pos="0 .03 -.15" mass=".7"/>
    </body>
  </body>"""

MIXED = f"""<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
  <geom type="plane" size="5 5 .1"/>
  <body name="trunk" pos="0 0 5" quat=".9 .2 -.1 .3"><freejoint/>
    <geom type="box" size=".2 .1 .1" pos=".05 -.02 .03" mass="4" euler="10 20 30"/>{LEG.format(side="left", y=".25")}
  </body>
  <body name="stand" pos="2 0 5" euler="0 0 40"><geom type="sphere" size=".1"/>
    <body name="arm" pos="0 .2 .3"><joint name="turn" axis="0 0 1"/><joint name="lift" type="slide" axis="0 0 1"/>
      <geom type="capsule" size=".05 .2" mass="2" pos=".2 0 0" euler="0 90 0"/>{LEG.format(side="right", y=".4")}
    </body>
  </body></worldbody>
  <contact><exclude body1="left_thigh" body2="left_shin"/></contact>
  <tendon><fixed name="both"><joint joint="righthip" coef=".5"/><joint joint="rightknee" coef="-2"/></fixed></tendon>
  <actuator><motor name="m" joint="lefthip" gear="30" ctrlrange="-1 1" ctrllimited="true"/>
    <motor name="t" tendon="both" gear="3"/><motor name="s" joint="lift" gear="9" forcerange="-4 4"/>
    <position name="p" joint="turn" kp="20" kv="1"/><velocity name="v" joint="rightroll" kv=".3"/></actuator>
</mujoco>""".replace("left_thigh", "leftthigh").replace("left_shin", "leftshin")

_BALL = '<body name="{0}" pos="{1} 1"><freejoint/><geom size=".1" contype="{2}" conaffinity="{2}"/>{3}</body>'

TOUCHING = (
    '<geom type="plane" size="5 5 .1" contype="3" conaffinity="3"/>'
    '<geom type="box" size=".5 .5 .1" pos="0 0 .5"/>'
    + _BALL.format("through", "0 0", 2, "")
    + _BALL.format("stays", ".3 .3", 1, "")
    + _BALL.format("held", "-.3 .3", 2, '<geom size=".1" pos="0 0 .25"/>')
)
"""Balls over a table and a plane: one falls through the table by its masks, one stays on it, and one of two geoms is
held by one of them."""


def world(body: str, rest: str = "", option: str = 'timestep="0.005"') -> str:
    """A model file with these bodies."""
    return f"<mujoco><option {option}/><worldbody>{body}</worldbody>{rest}</mujoco>"


def scene_of(text: str, folder: Path, **more: str) -> ModelScene:
    """The scene of a model file with this text."""
    path = folder / "robot.xml"
    path.write_text(text)
    return model_scene("robot", pack(path), **more)


def drawn(compiled: MjcfModel, n_env: int, seed: int) -> tuple[States, tuple[Any, Any]]:
    """Random states of environments, within limits; and MuJoCo's own qpos and qvel of them."""
    model, rng = compiled.model, np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (n_env, 1))
    for row in qpos:
        mujoco.mj_integratePos(model, row, rng.normal(size=model.nv) * 0.5, 1.0)
        for joint in np.flatnonzero(model.jnt_limited):
            low, high = model.jnt_range[joint]
            row[model.jnt_qposadr[joint]] = low + (high - low) * rng.uniform(0.2, 0.8)
    qvel = rng.normal(size=(n_env, model.nv))
    return tuple(np.array(array) for array in compiled.split(qpos, qvel)), (qpos, qvel)


def stepped(simulator: Simulator, description: Description, steps: int) -> dict[str, np.ndarray[Any, Any]]:
    """Fields by name over some steps; and no gate fires."""
    scene = simulator.scene
    if scene.actions is not None and not simulator.draws_actions:
        simulator.prepare(scene.actions.draw(0, n_env=simulator.n_env, first_step=0, n_step=steps))
    found = dict(zip((f.name for f in description.fields), simulator.states(steps), strict=True))
    assert not simulator.gates()
    return found


def put(simulator: Any, description: Description, seed: int) -> tuple[States, tuple[Any, Any]]:
    """Set states that are drawn, each in its environment's place; returns them, and MuJoCo's own qpos and qvel."""
    states, own = drawn(simulator._model.compiled, simulator.n_env, seed)
    origins = _origins(simulator, description)[:, None]
    given = tuple(a + origins if f.field == "position" else a for f, a in zip(description.fields, states, strict=True))
    simulator.set_state(given)
    return given, own


def _origins(simulator: Any, description: Description) -> np.ndarray[Any, Any]:
    return np.array(description.env_origins or np.zeros((simulator.n_env, 3)))


def read_back(simulator: Any, description: Description, seed: int) -> Any:
    """Read back the states that were put; returns MuJoCo's qpos of them."""
    given, (qpos, _) = put(simulator, description, seed)
    for field, a, b in zip(description.fields, simulator.state(), given, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6, err_msg=field.name)
    return qpos


def hold_places(simulator: Any, description: Description, seed: int) -> None:
    """Read back the states that were put, with the bodies where MuJoCo puts them, in every environment; links that the
    engine adds come behind them."""
    model = simulator._model.compiled.model
    qpos = read_back(simulator, description, seed)
    positions, orientations = (array[:, : model.nbody] for array in simulator.link_poses())
    for row, origin, position, orientation in zip(
        qpos, _origins(simulator, description), positions, orientations, strict=True
    ):
        data = mujoco.MjData(model)
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(position - origin, data.xpos, atol=5e-6)
        np.testing.assert_allclose(np.abs(np.sum(orientation * data.xquat, axis=1)), 1, atol=1e-6)


def step_alike(simulator: Any, description: Description, seed: int, share: float, *, positions: bool = True) -> None:
    """Make the step of MuJoCo from states that were put, under drawn controls.

    share      of the largest change of a velocity by which velocities may differ
    positions  whether joints have to be where MuJoCo has them
    """
    compiled, n_env = simulator._model.compiled, simulator.n_env
    _, (qpos, qvel) = put(simulator, description, seed)
    controls = simulator.scene.actions.draw(seed, n_env=n_env, first_step=0, n_step=1)
    simulator.prepare(controls)
    simulator.step(1)
    after = dict(zip((f.name for f in description.fields), simulator.state(), strict=True))
    for env in range(n_env):
        data = mujoco.MjData(compiled.model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[env], qvel[env], controls[0, env]
        mujoco.mj_step(compiled.model, data)
        assert not data.ncon
        wanted = dict(zip(after, compiled.split(data.qpos[None], data.qvel[None]), strict=True))
        change = np.abs(data.qvel - qvel[env]).max()
        assert change > 0.01
        for name in ("joints/qvel", "bodies/linear_velocity", "bodies/angular_velocity"):
            np.testing.assert_allclose(after[name][env], wanted[name][0], atol=share * change, err_msg=name)
        if positions:
            np.testing.assert_allclose(after["joints/qpos"][env], wanted["joints/qpos"][0], atol=3e-6 * (1 + change))


def wedge(folder: Path) -> ModelScene:
    """The scene of a mesh of half height 0.05 m above a plane."""
    (folder / "wedge.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (-0.05, 0.05))
        + "f 1 2 4\nf 1 4 3\nf 5 7 8\nf 5 8 6\nf 1 5 6\nf 1 6 2\nf 3 4 8\nf 3 8 7\nf 1 3 7\nf 1 7 5\nf 2 6 8\nf 2 8 4\n"
    )
    text = (
        '<mujoco><option timestep="0.005"/><asset><mesh name="w" file="wedge.obj"/></asset><worldbody>'
        '<geom type="plane" size="5 5 .1"/><body name="b" pos="0 0 .3" euler="0 0 30"><freejoint/>'
        '<geom type="mesh" mesh="w" mass="2"/></body></worldbody></mujoco>'
    )
    return scene_of(text, folder)


def hold_parameters(held: Imported) -> list[ParameterDifference]:
    """Differ from the mixed model in added links and missing tendons, and from a model with another mass and another
    limit in these two. Returns the first differences."""
    found = [f for kind in compare(of_c(mujoco.MjModel.from_xml_string(MIXED)), held) for f in kind.findings]
    assert {(f.kind, f.parameter) for f in found} == {("bodies", ""), ("tendons", "")}
    other = MIXED.replace('mass="2"', 'mass="2.1"').replace("-90 90", "-90 91", 1)
    changed = compare(of_c(mujoco.MjModel.from_xml_string(other)), held)
    items = {(f.item, f.parameter) for kind in changed for f in kind.findings if f.parameter}
    assert {("arm", "mass"), ("leftroll", "range")} <= items
    assert {item for item, _ in items} == {"arm", "leftroll"}
    return found


def answer_trials(scene: ModelScene, simulator: str, **options: Any) -> Trials:
    """Answer the trials of gsb-import with poses relative to each environment's origin."""
    found = tried(scene, lambda still, n_env: make(simulator, replace(still), n_env=n_env, **options), dt=0.001, seed=0)
    trunk = found.links.index("trunk")
    np.testing.assert_allclose(found.position[:, trunk], found.given["bodies/position"][:, 0], atol=1e-5)
    return found


def move_by_actuator(found: Trials) -> None:
    """Move by an actuator otherwise than without: it acts in an environment of its own."""
    moved = {
        kind + target: found.velocity["joints/qvel"][-1, i]
        for i, (kind, target) in enumerate(zip(found.kinds, found.targets, strict=True))
    }
    assert np.abs(moved["actuatorm"] - moved["rest"]).max() > 0.01


def reset_alone(simulator: Simulator, description: Description, first: States) -> None:
    """Reset the second of three environments to its first state, and leave the others as they are."""
    before = simulator.state()
    simulator.reset(np.array([1]))
    for field, was, now, begun in zip(description.fields, before, simulator.state(), first, strict=True):
        assert now[[0, 2]].tobytes() == was[[0, 2]].tobytes(), field.name
        np.testing.assert_allclose(now[1], begun[1], atol=1e-6, err_msg=field.name)
