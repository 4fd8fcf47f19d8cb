"""Model files on Isaac Lab's backend newton: what MuJoCo Warp, its solver, is given of them, and its steps, against
MuJoCo C, on the CPU."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("isaaclab")
pytest.importorskip("mujoco_warp")

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description
from tests.recorder import engines
from tests.recorder.mixed_model import (
    MIXED,
    TOUCHING,
    answer_trials,
    hold_parameters,
    read_back,
    reset_alone,
    scene_of,
    stepped,
)

# the engine's own, of its next release; mujoco's of numpy
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")

slow = pytest.mark.slow


@contextmanager
def _built(scene: ModelScene, **options: Any) -> Iterator[tuple[Any, Description]]:
    simulator = engines.make("isaaclab", scene, backend="newton", **options)
    try:
        yield simulator, simulator.build()
    finally:
        simulator.close()


def _compared(scene: ModelScene, steps: int, n_env: int = 2) -> tuple[dict[str, Any], dict[str, Any], set[str]]:
    """Fields by name over some steps, of Isaac Lab and of MuJoCo C, under the same controls, positions relative to the
    environment's origin; and the parameters that deviate."""
    with _built(scene, n_env=n_env) as (simulator, description):
        found = stepped(simulator, description, steps)
        if "bodies/position" in found:
            found["bodies/position"] = found["bodies/position"] - np.array(description.env_origins)[:, None]
    other, reference = engines.build("mujoco", scene, n_env=n_env)
    wanted = stepped(other, reference, steps)
    other.close()
    return found, wanted, {deviation.parameter for deviation in description.deviations}


def test_steps_and_what_it_holds(tmp_path: Path) -> None:
    """Make MuJoCo's steps under motors of joints and of a tendon, and servos, in floating and fixed trees, from the
    first step on; say of all parameters that they are the file's."""
    scene = scene_of(MIXED, tmp_path)
    found, wanted, deviations = _compared(scene, 20)
    for name, array in wanted.items():
        change = np.abs(array - array[0]).max()
        assert change > 1e-3
        np.testing.assert_allclose(found[name], array, atol=2e-4 * change + 1e-6, err_msg=name)
    assert deviations == {"option.tolerance", "bodies.added", "actuators"}


@slow
def test_parameters(tmp_path: Path) -> None:
    """Hold MuJoCo's masses, inertias, limits, springs and friction of joints; a model with another mass and another
    limit differs in these two."""
    with _built(scene_of(MIXED, tmp_path)) as (simulator, _):
        hold_parameters(simulator.imported())


JOINT = """<mujoco><option gravity="0 0 0" timestep="0.01" integrator="{integrator}"{medium}/>
  <default><geom contype="0" friction="0.7 0.02 0.003" solref="0.03 0.9" margin="0.002"/></default>
  <worldbody><geom type="plane" size="5 5 .1" pos="0 0 -2"/>
  <body name="r"><joint name="j" axis="0 0 1" stiffness="5" damping="1" springref="40" ref="10" frictionloss=".1"
    armature=".2" range="-90 20" solreflimit="0.04 0.8"/>
  <geom type="capsule" size=".1 .2" mass="1" pos=".3 0 0"/></body></worldbody>
  <actuator><motor joint="j" gear="3" forcerange="-1.5 2.5"/></actuator></mujoco>"""


@slow
@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicitfast"])
def test_springs_and_limits(integrator: str, tmp_path: Path) -> None:
    """Keep springs, damping, dry friction, the softness of limits, and the integrator: they are MuJoCo's own, and no
    part of a drive."""
    scene = scene_of(JOINT.format(integrator=integrator, medium=""), tmp_path)
    found, wanted, deviations = _compared(scene, 100)
    assert np.ptp(wanted["joints/qpos"]) > 0.1
    np.testing.assert_allclose(found["joints/qpos"], wanted["joints/qpos"], atol=1e-4)
    assert deviations == {"option.tolerance", "actuators"}


@slow
def test_a_medium(tmp_path: Path) -> None:
    """Say that there is no medium: Isaac Lab has no setting for it."""
    scene = scene_of(JOINT.format(integrator="Euler", medium=' viscosity="0.1" density="3"'), tmp_path)
    with _built(scene) as (_, description):
        found = {deviation.parameter: deviation.used for deviation in description.deviations}
    assert (found["model.density"], found["model.viscosity"]) == ("0", "0")


@slow
def test_what_the_solver_does_not_have(tmp_path: Path) -> None:
    """Name a spring of a free joint and iterations without slip: neither is in what MuJoCo Warp steps."""
    body = '<body pos="0 0 1"><joint name="f" type="free" stiffness="50"/><geom size=".1"/></body>'
    text = f'<mujoco><option noslip_iterations="5"/><worldbody>{body}</worldbody></mujoco>'
    with _built(scene_of(text, tmp_path)) as (_, description):
        found = {deviation.parameter: deviation.used for deviation in description.deviations}
    assert (found["joints.stiffness"], found["option.noslip_iterations"]) == ("f 0", "0")


@slow
def test_what_may_touch(tmp_path: Path) -> None:
    """Rest on a plane and on a table of each environment, and keep apart what MuJoCo keeps apart, geom by geom."""
    text = f"<mujoco><option timestep='0.005'/><worldbody>{TOUCHING}</worldbody></mujoco>"
    found, wanted, deviations = _compared(scene_of(text, tmp_path), 300, n_env=3)
    np.testing.assert_allclose(found["bodies/position"][-1], wanted["bodies/position"][-1], atol=2e-3)
    assert "contact.pairs" not in deviations


@slow
def test_states_and_trials(tmp_path: Path) -> None:
    """Read random states back, put their bodies where MuJoCo puts them, reset one environment and leave the others;
    answer the trials of gsb-import."""
    scene = scene_of(MIXED, tmp_path)
    with _built(scene, n_env=3) as (simulator, description):
        model, origins = simulator._model.compiled.model, np.array(description.env_origins)[:, None]
        first = simulator.state()
        qpos = read_back(simulator, description, 0)
        positions, _ = simulator.link_poses()
        for env, row in enumerate(qpos):
            data = mujoco.MjData(model)
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            np.testing.assert_allclose(positions[env, : model.nbody] - origins[env], data.xpos, atol=5e-6)
        simulator.reset()
        simulator.step(3)
        saved = simulator.snapshot()
        after = simulator.states(3)
        simulator.restore(saved)
        assert [a.tobytes() for a in after] == [a.tobytes() for a in simulator.states(3)]
        reset_alone(simulator, description, first)

    answer_trials(scene, "isaaclab", backend="newton")


def test_refusals(tmp_path: Path) -> None:
    """Refuse an integrator that MuJoCo Warp does not have, and joints that the stage of PhysX does not have."""
    ball = '<mujoco><worldbody><body><joint name="b" type="ball"/><geom size=".1"/></body></worldbody></mujoco>'
    with pytest.raises(Refused, match="that PhysX is given: .*ball joint 'b'"):
        engines.make("isaaclab", scene_of(ball, tmp_path), backend="newton").build()
    held = ball.replace("<body>", '<body name="h" mocap="true"><geom size=".1"/></body><body>').replace("ball", "hinge")
    with pytest.raises(Refused, match="no articulation without joints, such as that of body 'h'"):
        engines.make("isaaclab", scene_of(held, tmp_path), backend="newton").build()
    scene = scene_of(JOINT.format(integrator="implicit", medium=""), tmp_path)
    with pytest.raises(Refused, match="no integrator 'implicit'"):
        engines.make("isaaclab", scene, backend="newton").build()
