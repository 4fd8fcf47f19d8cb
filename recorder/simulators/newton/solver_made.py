"""What SolverMuJoCo steps of a model file that Newton was given as USD, in MuJoCo's terms."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.newton.imported import Imported
from gpusimbench.recorder.simulators.newton.made import (
    Quantities,
    as_mujoco_has_it,
    bodies_of_solver,
    body_names,
    different,
    different_contacts,
    different_options,
    joint_name,
    single_joints,
)
from gpusimbench.schemas.provenance import Deviation

_LAST = {int(mujoco.mjtJoint.mjJNT_FREE): 5, int(mujoco.mjtJoint.mjJNT_BALL): 2}
"""Of degrees of freedom of a joint, the last; 0 of others."""

_LIMITS = {"solref": "joints.limit_solref", "solimp": "joints.limit_solimp", "margin": "joints.margin"}


def quantities_of_solver(solver: Any, imported: Imported, model: Any) -> Quantities:
    """As made.as_mujoco_has_it, of what SolverMuJoCo steps, the first of its worlds. Bodies that are not in it never
    move: their rows are those of `model`, the mujoco.MjModel that MuJoCo itself makes of the file."""
    at, own = bodies_of_solver(solver, imported), as_mujoco_has_it(solver.mj_model)
    found = as_mujoco_has_it(model)
    there = [body for body in range(1, model.nbody) if (at == body).any()]
    of_bodies = [int(np.flatnonzero(at == body)[0]) - 1 for body in there]
    singles, rows = list(single_joints(solver.mj_model)), _numbers_of_joints(solver, imported, model)
    of_joints = [singles.index(rows[joint]) for joint in single_joints(model)]
    reference = model.qpos0[model.jnt_qposadr[single_joints(model)]][:, None]  # positions are zero there
    sprung = model.jnt_stiffness[single_joints(model)][:, None] != 0
    for quantity, rows_of in found.items():
        if quantity.startswith("bodies."):
            rows_of[[body - 1 for body in there]] = own[quantity][of_bodies]
            continue
        found[quantity] = own[quantity][of_joints]
        if quantity == "joints.range":
            found[quantity] = found[quantity] + reference
        if quantity == "joints.spring_reference":
            found[quantity] = found[quantity] + np.where(sprung, reference, 0.0)
    for word, parameter in _LIMITS.items():
        found[parameter] = _columns(getattr(solver.mj_model, f"jnt_{word}"))[[rows[j] for j in single_joints(model)]]
    return found


def deviations_of_solver(solver: Any, imported: Imported, model: Any, reason: str) -> list[Deviation]:
    """Where what SolverMuJoCo steps is not as MuJoCo compiles a file, but for actuators, tendons and equalities, which
    it is not given.

    imported  where bodies and joints are in Newton's model; bodies that are in none, and more bodies, may be
    """
    made = solver.mj_model
    items = {"bodies": body_names(model), "joints": [joint_name(model, j) for j in single_joints(model)]}
    used = quantities_of_solver(solver, imported, model)
    said: list[Deviation] = []
    for quantity, wanted in as_mujoco_has_it(model).items():
        said += different(quantity, items[quantity.partition(".")[0]], (wanted, used[quantity]), reason)
    singles = single_joints(model)
    limited = np.flatnonzero(model.jnt_limited[singles])
    names = [joint_name(model, singles[row]) for row in limited]
    for word, parameter in _LIMITS.items():
        wanted = _columns(getattr(model, f"jnt_{word}"))[singles[limited]]
        said += different(parameter, names, (wanted, used[parameter][limited]), reason)
    rows = _numbers_of_joints(solver, imported, model)
    free = [int(joint) for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)]
    for word in ("armature", "damping", "frictionloss"):
        wanted, have = (
            np.array([getattr(m, f"dof_{word}")[m.jnt_dofadr[j] : m.jnt_dofadr[j] + 6] for j in joints]).reshape(-1, 6)
            for m, joints in ((model, free), (made, [rows[joint] for joint in free]))
        )
        said += different(f"joints.{word}", [joint_name(model, joint) for joint in free], (wanted, have), reason)
    springs = [m.jnt_stiffness[joints][:, None] for m, joints in ((model, free), (made, [rows[j] for j in free]))]
    said += different("joints.stiffness", [joint_name(model, joint) for joint in free], springs, reason)
    said += different_options(model, made, reason)
    return [*said, *different_contacts(model, made, bodies_of_solver(solver, imported), reason, unordered=True)]


def _columns(array: NDArray[np.float64]) -> NDArray[np.float64]:
    return array[:, None] if array.ndim == 1 else array


def _numbers_of_joints(solver: Any, imported: Imported, model: Any) -> list[int]:
    """By number of the model's joints, SolverMuJoCo's, which it knows by the last of their degrees of freedom."""
    dofs = solver.mjc_jnt_to_newton_dof.numpy()[0][: solver.mj_model.njnt]
    last = [_LAST.get(int(kind), 0) for kind in model.jnt_type]
    return [int(np.flatnonzero(dofs == start + more)[0]) for start, more in zip(imported.at_qd, last, strict=True)]
