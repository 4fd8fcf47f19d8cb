"""Model files on Isaac Lab: kinematics, accelerations, drives and contacts against MuJoCo's, on PhysX and on the CPU.

What of a model PhysX is given, and what it refuses, tests/recorder/test_physx_models.py has.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("isaaclab")
pytest.importorskip("ovphysx")

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.isaaclab.physx import measured
from gpusimbench.schemas.errors import UsageError
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
    world,
)

# the engine's own, of its next release; mujoco's of numpy
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")

slow = pytest.mark.slow


@contextmanager
def _built(scene: ModelScene, **options: Any) -> Iterator[tuple[Any, Description]]:
    simulator = engines.make("isaaclab", scene, **options)
    try:
        yield simulator, simulator.build()
    finally:
        simulator.close()


def _both(scene: ModelScene, steps: int, **options: Any) -> tuple[Any, Any]:
    """Fields by name over some steps, of Isaac Lab and of MuJoCo C, under the same controls; positions are relative to
    the environment's origin."""
    with _built(scene, **options) as (simulator, description):
        found = stepped(simulator, description, steps)
        if "bodies/position" in found and description.env_origins:
            found["bodies/position"] = found["bodies/position"] - np.array(description.env_origins)[:, None]
    other, description = engines.build("mujoco", scene)
    wanted = stepped(other, description, steps)
    other.close()
    return found, wanted


def test_kinematics_and_states(tmp_path: Path) -> None:
    """Put the bodies of random states where MuJoCo puts them, in every environment, also those of a tree that is fixed
    to the world; read the states back; reset one environment and leave the others as they are; go on from a
    snapshot."""
    with _built(scene_of(MIXED, tmp_path, actions="none"), n_env=3) as (simulator, description):
        first = simulator.state()
        for seed in range(2):
            hold_places(simulator, description, seed)
        simulator.reset()
        simulator.step(3)
        saved = simulator.snapshot()
        after = simulator.states(3)
        simulator.restore(saved)
        for a, b in zip(after, simulator.states(3), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)
        reset_alone(simulator, description, first)


def test_accelerations(tmp_path: Path) -> None:
    """Make the step of MuJoCo from random states: masses, inertias, gravity, armature, damping, motors of joints and of
    a tendon, clamped controls and forces, and servos, in floating and fixed trees."""
    scene = scene_of(MIXED, tmp_path)
    with _built(scene, n_env=4, contact_offset=1e-4, position_iterations=1) as (simulator, description):
        for seed in range(2):
            step_alike(simulator, description, seed, 2e-3, positions=False)


HINGE = '<body name="r"><joint name="j" axis="0 0 1" {0}/><geom type="capsule" size=".1 .2" mass="1"/></body>'


@pytest.mark.parametrize(
    ("joint", "actuator", "wanted"),
    [
        pytest.param('stiffness="5" damping="1" springref="40"', "", np.radians(40), marks=slow),
        ('damping="1" stiffness="3" springref="30" ref="10"', '<position joint="j" kp="6"/>', None),
        pytest.param(
            'damping="1" stiffness="4"', '<motor joint="j" gear="3" forcerange="-.5 .5"/>', 1.5 / 4, marks=slow
        ),
    ],
)
def test_where_drives_come_to_rest(joint: str, actuator: str, wanted: float | None, tmp_path: Path) -> None:
    """Rest where springs, servos and clamped motors balance, as in MuJoCo: Isaac Lab's commands leave no spring out."""
    key = '<keyframe><key ctrl="0.8"/></keyframe>' if actuator else ""
    text = world(
        HINGE.format(joint),
        f"<actuator>{actuator}</actuator>{key}",
        'gravity="0 0 0" timestep="0.01" integrator="implicitfast"',
    )
    found, other = _both(scene_of(text, tmp_path, actions="keyframe" if actuator else "none"), 400)
    np.testing.assert_allclose(found["joints/qpos"][-1], other["joints/qpos"][-1], atol=2e-3)
    if wanted is not None:
        np.testing.assert_allclose(found["joints/qpos"][-1], wanted, atol=2e-3)


def test_controls_that_end(tmp_path: Path) -> None:
    """Give zeros after forces, and keep no force of an earlier step: a cart goes on at the speed that it has."""
    text = world(
        '<body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body>',
        '<actuator><motor joint="x" gear="4"/></actuator>',
        'gravity="0 0 0"',
    )
    with _built(scene_of(text, tmp_path), n_env=2) as (simulator, _):
        speeds = []
        for controls in (np.array([1.0, 0.5]), np.zeros(2)):
            simulator.prepare(np.tile(controls[:, None], (5, 1, 1)).astype(np.float32))
            simulator.step(5)
            speeds.append(simulator.state()[1][:, 0, 0])
    np.testing.assert_allclose(speeds[0], [5 * 0.002 * 2, 5 * 0.002], rtol=1e-5)
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=1e-6)


def test_what_may_touch(tmp_path: Path) -> None:
    """Rest on the plane that all environments share and on a table of their own, and keep apart what MuJoCo keeps
    apart, geom by geom; bodies without joints are no articulations there."""
    found, wanted = _both(scene_of(world(TOUCHING), tmp_path), 300, n_env=3)
    heights = found["bodies/position"][-1, :, :, 2]
    np.testing.assert_allclose(heights, [[0.1, 0.7, 0.45]] * 3, atol=2e-3)
    np.testing.assert_allclose(heights[:2], wanted["bodies/position"][-1, :, :, 2], atol=2e-3)
    np.testing.assert_allclose(
        found["bodies/position"][-1, 1:, :, :2], found["bodies/position"][0, 1:, :, :2], atol=1e-3
    )


@slow
def test_environments_in_one_place(tmp_path: Path) -> None:
    """Leave environments in one place to themselves: each has its robot, and they share what is fixed."""
    text = world(
        '<geom type="plane" size="5 5 .1"/><body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    )
    found, wanted = _both(scene_of(text, tmp_path), 200, n_env=3, spacing=0)
    np.testing.assert_allclose(found["bodies/position"][-1, :, 0, 2], 0.1, atol=2e-3)
    np.testing.assert_allclose(found["bodies/position"][-1, 0], wanted["bodies/position"][-1, 0], atol=2e-3)


def test_what_it_holds(tmp_path: Path) -> None:
    """Hold MuJoCo's masses, inertias, limits, springs and friction of joints, as read from the engine; a model with
    another mass and another limit differs in these two. The recording has the stage, without clones."""
    with _built(scene_of(MIXED, tmp_path)) as (simulator, description):
        hold_parameters(simulator.imported())
    stage = description.attachments["scene.usda"][1].decode()
    assert stage.count("PhysicsArticulationRootAPI") == 2


def test_trials(tmp_path: Path) -> None:
    """Answer the trials of gsb-import: poses relative to each environment's origin, and actuators each in one of its
    own."""
    move_by_actuator(answer_trials(scene_of(MIXED, tmp_path), "isaaclab"))


def test_refusals(tmp_path: Path) -> None:
    """Refuse a ball joint by its name, and models on the backend that was not given any."""
    ball = world('<body><joint name="shoulder" type="ball"/><geom size=".1"/></body>')
    with pytest.raises(Refused, match="ball joint 'shoulder'"):
        engines.make("isaaclab", scene_of(ball, tmp_path)).build()
    parts = world('<body name="b"><freejoint/><geom size=".1"/><body><geom size=".1" pos="0 0 .2"/></body></body>')
    with pytest.raises(Refused, match="no articulation without joints, such as that of body 'b'"):
        engines.make("isaaclab", scene_of(parts, tmp_path)).build()
    with pytest.raises(UsageError, match="no model files: use backend=ovphysx"):
        engines.make("isaaclab", scene_of(MIXED, tmp_path), backend="physx")


def test_sizes_of_buffers(tmp_path: Path) -> None:
    """Count the contacts of a model file for PhysX's buffers on a GPU, under the options of the file."""
    text = world(
        '<geom type="plane" size="5 5 .1"/><body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    )
    scene = scene_of(text, tmp_path)
    options = engines.make("isaaclab", scene).options
    need = measured(scene, dt=scene.dt, seed=0, options=options)
    assert need.contacts == 4
    assert need.pairs >= 1
