"""What Genesis holds of a model file, read from its rigid solver under MuJoCo's names."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco import mjtEq, mjtGeom, mjtJoint, mjtObj
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.genesis.imported import EQUALITIES, GEOMS, ModelEnvironments
from gpusimbench.recorder.simulators.mujoco import imported as of_mujoco
from gpusimbench.schemas.imported import Imported, Values

_JOINTS = {  # by number of genesis.JOINT_TYPE
    1: mjtJoint.mjJNT_HINGE, 2: mjtJoint.mjJNT_SLIDE, 3: mjtJoint.mjJNT_BALL, 4: mjtJoint.mjJNT_FREE,
}  # fmt: skip
_HALVES = {  # sizes that Genesis has in whole, by kind of shape
    mjtGeom.mjGEOM_CAPSULE: (1.0, 0.5), mjtGeom.mjGEOM_CYLINDER: (1.0, 0.5), mjtGeom.mjGEOM_BOX: (0.5, 0.5, 0.5),
    mjtGeom.mjGEOM_SPHERE: (1.0,), mjtGeom.mjGEOM_ELLIPSOID: (1.0, 1.0, 1.0),
}  # fmt: skip
UNREAD = {
    "joints/force_range": "not read; the recorder clamps the forces of actuators",
    "geoms/condim": "Genesis has torsional and rolling friction of all contacts, or of none",
    "actuators": "not read; the recorder makes forces and targets of controls",
}


def held_parameters(environments: ModelEnvironments, *, dt: float) -> Imported:
    """The parameters that Genesis holds, by MuJoCo's names.

    What has no effect in the model, as friction against turning of a geom whose condim has none, is MuJoCo's.
    """
    model, match = environments.compiled.model, environments.match
    arrays = _arrays(environments, dt)

    def read(name: str) -> NDArray[Any]:
        if name not in arrays:
            raise AttributeError(name=name.rpartition(".")[2])
        return arrays[name]

    every = of_mujoco.of_c(model).names
    names = {"geoms": [every["geoms"][g] for g in match.geoms]}
    found = of_mujoco.imported(model, read, "Genesis", names)
    unread = {**found.unread, **UNREAD}
    kept: dict[str, Values] = {key: value for key, value in found.values.items() if key not in unread}
    if model.nexclude:  # the importer makes masks of them
        unread |= dict.fromkeys(("geoms/contype", "geoms/conaffinity"), "excludes and pairs of bodies are compared")
        kept = {key: value for key, value in kept.items() if key not in unread}
    things = {kind: labels for kind, labels in found.names.items() if kind != "actuators"}
    if not len(match.geoms):
        things["geoms"] = ()
    return Imported({**things, "tendons": ()}, kept, unread)


def _arrays(environments: ModelEnvironments, dt: float) -> dict[str, NDArray[Any]]:
    """Genesis' arrays, in MuJoCo's terms and order, by MuJoCo's names."""
    solver, model, match = environments.solver, environments.compiled.model, environments.match
    gravity = np.asarray(solver.get_gravity().cpu().numpy(), dtype=np.float64).reshape(-1, 3)[0]
    found = {
        "opt.gravity": gravity,
        "opt.timestep": np.array([dt]),
        "pair_geom1": np.empty(0),
        "pair_geom2": np.empty(0),
        "exclude_signature": _excluded(environments),
    }
    return found | _bodies(solver, match.links) | _joints(solver, model, match) | _geoms(solver, model, match) | (
        _equalities(solver, model, match)
    )  # fmt: skip


def _bodies(solver: Any, at: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    links = solver.dyn_info.links
    there = at >= 0
    of_link = {int(link): body for body, link in enumerate(at) if link >= 0} | {-1: 0}

    def rows(array: Any, otherwise: Any) -> NDArray[np.float64]:
        values = _host(array)
        shape = (slice(None), *([np.newaxis] * (values.ndim - 1)))
        return np.where(there[shape], values[at], otherwise).astype(np.float64)

    turn, tensors = rows(links.inertial_quat, (1, 0, 0, 0)), rows(links.inertial_i, np.zeros((3, 3)))
    moments, axes = np.zeros((len(at), 3)), np.zeros((len(at), 4))
    for body, (quaternion, tensor) in enumerate(zip(turn, tensors, strict=True)):
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, quaternion)
        frame = matrix.reshape(3, 3)
        moments[body], vectors = np.linalg.eigh(frame @ tensor @ frame.T)
        if np.linalg.det(vectors) < 0:
            vectors[:, 0] *= -1
        mujoco.mju_mat2Quat(axes[body], vectors.ravel())
    parents = _host(links.parent_idx)
    return {
        "body_parentid": np.array([of_link[int(parents[link])] if link >= 0 else 0 for link in at]),
        "body_pos": rows(links.pos, 0),
        "body_quat": rows(links.quat, (1, 0, 0, 0)),
        "body_mass": rows(links.inertial_mass, 0),
        "body_ipos": rows(links.inertial_pos, 0),
        "body_inertia": moments,
        "body_iquat": axes,
    }


def _joints(solver: Any, model: Any, match: Any) -> dict[str, NDArray[Any]]:
    joints, dofs, at = solver.dyn_info.joints, solver.dyn_info.dofs, match.joints
    first = np.asarray(model.jnt_dofadr, dtype=np.int64)
    kinds = np.array([int(_JOINTS[int(kind)]) for kind in _host(joints.type)[at]], dtype=np.int64)
    slides = (kinds == int(mjtJoint.mjJNT_SLIDE))[:, np.newaxis]
    limits = _host(dofs.limit)[first]
    parameters = _as_stated(_host(joints.sol_params)[at], (model.jnt_solref, model.jnt_solimp), _least(solver, model))
    zero = _host(solver.qpos0)
    zero = zero if zero.ndim == 1 else zero[:, 0]
    of_link = {int(link): body for body, link in enumerate(match.links)}
    return {
        "jnt_type": kinds,
        "jnt_bodyid": np.array([of_link[solver.joints[j].link.idx] for j in at], dtype=np.int64),
        "jnt_pos": _host(joints.pos)[at],
        "jnt_axis": np.where(slides, _host(dofs.motion_vel)[first], _host(dofs.motion_ang)[first]),
        "qpos0": zero,
        "qpos_spring": zero,  # springs draw to it
        "jnt_qposadr": np.asarray(model.jnt_qposadr),
        "jnt_limited": np.isfinite(limits).all(axis=1),
        "jnt_range": limits,
        "jnt_stiffness": _host(dofs.stiffness)[first],
        "jnt_solref": parameters[:, :2],
        "jnt_solimp": parameters[:, 2:],
        "dof_jntid": np.asarray(model.dof_jntid),
        **{f"dof_{name}": _host(getattr(dofs, name)) for name in ("damping", "armature", "frictionloss")},
    }


def _geoms(solver: Any, model: Any, match: Any) -> dict[str, NDArray[Any]]:
    geoms, at = solver.dyn_info.geoms, match.geoms
    if not len(at):
        return {}
    kinds = np.array([int(GEOMS[int(kind)]) for kind in _host(geoms.type)])
    data, sizes = _host(geoms.data), np.zeros((len(at), 3))
    for geom, kind in enumerate(kinds):
        factors = _HALVES.get(mjtGeom(int(kind)), ())
        sizes[geom, : len(factors)] = data[geom, : len(factors)] * factors
    coefficients = ("friction", "friction_torsional", "friction_rolling")
    friction = np.stack([_host(getattr(geoms, name)) for name in coefficients], axis=1)
    condim = np.asarray(model.geom_condim)[at]
    without_effect = np.stack([condim < 0, condim < 4, condim < 6], axis=1)  # friction against turning, and rolling
    parameters = _as_stated(_host(geoms.sol_params), (model.geom_solref[at], model.geom_solimp[at]), 0.0)
    of_link = {int(link): body for body, link in enumerate(match.links)}
    points = [np.asarray(geom.init_verts, dtype=np.float64) for geom in solver.geoms]
    counts = np.array([len(verts) for verts in points], dtype=np.int64)
    return {
        "geom_type": kinds,
        "geom_bodyid": np.array([of_link[int(link)] for link in _host(geoms.link_idx)]),
        "geom_size": sizes,
        "geom_pos": _host(geoms.pos).astype(np.float64),
        "geom_quat": _host(geoms.quat).astype(np.float64),
        "geom_friction": np.where(without_effect, np.asarray(model.geom_friction)[at], friction),
        "geom_contype": _host(geoms.contype),
        "geom_conaffinity": _host(geoms.conaffinity),
        "geom_solref": parameters[:, :2],
        "geom_solimp": parameters[:, 2:],
        "geom_dataid": np.arange(len(at)),
        "mesh_vertnum": counts,
        "mesh_vertadr": np.cumsum(counts) - counts,
        "mesh_vert": np.concatenate(points),
    }


def _equalities(solver: Any, model: Any, match: Any) -> dict[str, NDArray[Any]]:
    equalities, count = solver.dyn_info.equalities, len(solver.equalities)
    kinds = np.array([int(EQUALITIES[int(kind)]) for kind in _host(equalities.eq_type)[:count, 0]], dtype=np.int64)
    parameters = _as_stated(
        _host(equalities.sol_params)[:count, 0], (model.eq_solref, model.eq_solimp), _least(solver, model)
    )
    numbers = {}
    for key in ("eq_obj1id", "eq_obj2id"):
        things = []
        for kind, number in zip(kinds, _host(getattr(equalities, key))[:count, 0], strict=True):
            of = match.joints if kind == int(mjtEq.mjEQ_JOINT) else match.links
            at = np.flatnonzero(of == number)
            things.append(int(at[0]) if len(at) else -1)
        numbers[key] = np.array(things, dtype=np.int64)
    body = int(mjtObj.mjOBJ_BODY)
    return {
        "eq_type": kinds,
        **numbers,
        "eq_objtype": np.where(kinds == int(mjtEq.mjEQ_JOINT), int(mjtObj.mjOBJ_JOINT), body),
        "eq_active0": np.ones(count),
        "eq_data": _host(equalities.eq_data)[:count, 0],
        "eq_solref": parameters[:, :2],
        "eq_solimp": parameters[:, 2:],
    }


def _as_stated(parameters: NDArray[Any], stated: tuple[Any, Any], least: float) -> NDArray[np.float64]:
    """Solver parameters, solref and solimp, as the model states them where Genesis holds what MuJoCo makes of them as
    it steps: time constants of two steps at least, and impedances within MuJoCo's range.

    least  time constant [s]; 0: any
    """
    own = np.concatenate(stated, axis=1).astype(np.float64)
    used = own.copy()
    used[:, 0] = np.where((own[:, 0] > 0) & (own[:, 0] < least), least, own[:, 0])
    used[:, [2, 3, 5]] = np.clip(used[:, [2, 3, 5]], mujoco.mjMINIMP, mujoco.mjMAXIMP)
    used[:, 4], used[:, 6] = np.maximum(used[:, 4], 0), np.maximum(used[:, 6], 1)
    return np.where(np.abs(parameters - used) <= 1e-6 * np.maximum(1, np.abs(used)), own, parameters)


def _least(solver: Any, model: Any) -> float:
    safe = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    return 2 * float(solver._substep_dt) if safe else 0.0


def _excluded(environments: ModelEnvironments) -> NDArray[Any]:
    """Of the pairs of bodies that the model excludes, those that do not collide."""
    together = touching(environments)
    signatures = np.asarray(environments.compiled.model.exclude_signature)
    apart = [tuple(sorted((int(s) >> 16, int(s) & 0xFFFF))) not in together for s in signatures]
    return np.asarray(signatures[np.array(apart, dtype=bool)])


def touching(environments: ModelEnvironments) -> set[tuple[int, int]]:
    """Pairs of MuJoCo's bodies with geoms that Genesis' collider may find in contact."""
    solver, model, match = environments.solver, environments.compiled.model, environments.match
    if not len(match.geoms):
        return set()
    pairs = np.argwhere(_host(solver.collider.collider_info.collision_pair_idx) >= 0)
    body = np.asarray(model.geom_bodyid)[match.geoms]
    return {(min(a, b), max(a, b)) for a, b in ((int(body[g]), int(body[h])) for g, h in pairs)}


def _host(array: Any) -> NDArray[Any]:
    return np.asarray(array.to_numpy())
