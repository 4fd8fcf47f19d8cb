"""How a model comes to the ground on an engine: from its first state, without controls, past the first contact.

What engines tell of contacts differs, and some tell nothing. So contacts, the centre of mass and the momentum are
computed by MuJoCo C's model from the states that an engine gives: the force that carries the model is its weight and
what its momentum gains.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model.scene import ModelScene
from gpusimbench.recorder.simulators.base import Simulator, States
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options
from gpusimbench.schemas.imported import Drop

AFTER_S = 0.5
"""How long the drop goes on after the first contact of MuJoCo C [s]."""

_LONGEST_S = 2.0  # that the first contact is waited for
_MOST_STEPS = 4000
_BLOCK = 10  # steps that are asked for at once


def dropped(scene: ModelScene, make: Callable[[Scene, int], Simulator], *, dt: float) -> Drop | None:
    """What a simulator of its own, with one environment, does with the model; None for a model that has no free body,
    that no gravity pulls down, or that on MuJoCo C touches nothing within 2 s.

    make  a simulator that was not built yet, of a scene and a number of environments
    """
    still = replace(scene, actions=None, controls="none")
    compiled = compile_scene(still, dt=dt, options=own_options(still))
    n_step = _steps(compiled, dt)
    if not n_step:
        return None
    simulator = make(still, 1)
    try:
        description = simulator.build()
        simulator.compile("capture")
        simulator.reserve(_BLOCK)
        simulator.prepare(None)
        rows = [tuple(np.array(array) for array in simulator.state())]
        for first in range(0, n_step, _BLOCK):
            block = simulator.states(min(_BLOCK, n_step - first))
            rows += [tuple(np.array(array[step]) for array in block) for step in range(len(block[0]))]
    finally:
        simulator.close()
    origin = np.array(description.env_origins[0]) if description.env_origins else np.zeros(3)
    world = [field.field == "position" and field.frame == "world" for field in description.fields]
    found = [tuple(a - origin if w else a for a, w in zip(row, world, strict=True)) for row in rows]
    return measured(compiled, found, dt)


def measured(compiled: MjcfModel, rows: list[States], dt: float) -> Drop:
    """Contacts, height and momentum of states [1, item, width] of the model's fields, `dt` apart [s]."""
    model = compiled.model
    moves = model.body_weldid != 0
    mass = model.body_mass * moves
    data = mujoco.MjData(model)
    contact, height, momentum = [], [], []
    for row in rows:
        qpos, qvel = compiled.joined(row)
        if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
            contact.append(False)
            height.append(np.nan)
            momentum.append(np.nan)
            continue
        data.qpos[:], data.qvel[:] = qpos[0], qvel[0]
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_collision, mujoco.mj_comVel):
            compute(model, data)
        mujoco.mj_subtreeVel(model, data)
        contact.append(_touches(model, data))
        height.append(float(mass @ data.xipos[:, 2] / mass.sum()))
        momentum.append(float(model.body_subtreemass[0] * data.subtree_linvel[0, 2]))
    weight = float(-mass @ np.full(model.nbody, model.opt.gravity[2]))
    return Drop(np.arange(len(rows)) * dt, np.array(contact), np.array(height), np.array(momentum), weight)


def _steps(compiled: MjcfModel, dt: float) -> int:
    free = (compiled.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    if not free or compiled.model.opt.gravity[2] >= 0:
        return 0  # a base carries it, or nothing falls
    after = round(AFTER_S / dt)
    longest = min(round(_LONGEST_S / dt), _MOST_STEPS - after)
    for step, data in enumerate(compiled.rollout(n_step=max(longest, 0))):
        if _touches(compiled.model, data):
            return step + after
    return 0


def _touches(model: Any, data: Any) -> bool:
    # whether a shape that moves reaches into one that does not
    fixed = model.body_weldid[model.geom_bodyid[data.contact.geom]] == 0  # [contact, 2]
    return bool((fixed.any(axis=1) & (data.contact.dist < 0)).any()) if data.ncon else False
