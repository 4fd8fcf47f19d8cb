"""The level planes of a compiled model that hold its free bodies up, so that a recording can tell what fell through."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtDisableBit, mjtGeom, mjtJoint

from gpusimbench.recorder.scenes.model.contents import moving

_LEVEL = 1 - 1e-12  # of the normal's component along z


def floors_of(model: Any) -> list[dict[str, float]]:
    """Planes of a mujoco.MjModel that are level, never move, and collide with every free body or what hangs on it.

    height  of the plane [m]
    reach   no point of a free body, or of what hangs on it, is ever further from the body's origin [m]
    """
    if model.opt.disableflags & int(mjtDisableBit.mjDSBL_CONTACT | mjtDisableBit.mjDSBL_CONSTRAINT):
        return []
    roots = [int(model.jnt_bodyid[joint]) for joint in moving(model, mjtJoint.mjJNT_FREE).joints]
    solids = [[g for g in range(model.ngeom) if root in _line(model, int(model.geom_bodyid[g]))] for root in roots]
    reach = max((_reach(model, root, g) for root, some in zip(roots, solids, strict=True) for g in some), default=0.0)
    if not all(solids) or not 0 < reach < math.inf:
        return []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    planes = [
        geom
        for geom in np.flatnonzero(model.geom_type == mjtGeom.mjGEOM_PLANE).tolist()
        if not model.body_weldid[model.geom_bodyid[geom]] and data.geom_xmat[geom][8] >= _LEVEL
    ]
    return [
        {"height": float(data.geom_xpos[plane][2]), "reach": reach}
        for plane in planes
        if all(any(_collide(model, plane, geom) for geom in some) for some in solids)
    ]


def _line(model: Any, body: int) -> Iterator[int]:
    # a body and what it hangs on, up to the world
    while body:
        yield body
        body = int(model.body_parentid[body])


def _reach(model: Any, root: int, geom: int) -> float:
    # bound of the distance from the root's origin: every link stretched out, every slide moved out
    far = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    if model.geom_rbound[geom] == 0:
        return math.inf  # a plane
    for body in _line(model, int(model.geom_bodyid[geom])):
        if body == root:
            break
        far += float(np.linalg.norm(model.body_pos[body]))
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if model.jnt_type[joint] == mjtJoint.mjJNT_SLIDE:
                reference = model.qpos0[model.jnt_qposadr[joint]]
                far += float(np.abs(model.jnt_range[joint] - reference).max()) if model.jnt_limited[joint] else math.inf
            else:  # turns the body about a point that need not be its origin
                far += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
    return far


def _collide(model: Any, plane: int, geom: int) -> bool:
    one, other = sorted((int(model.geom_bodyid[plane]), int(model.geom_bodyid[geom])))
    if (one << 16) + other in model.exclude_signature:
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[plane] & affinities[geom] or types[geom] & affinities[plane])
