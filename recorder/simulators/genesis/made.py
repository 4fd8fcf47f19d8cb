"""What Genesis holds of a model file, read from its rigid solver under MuJoCo's names, and what it has otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtEq, mjtGeom, mjtJoint, mjtObj
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model.contents import choices, solver_options
from gpusimbench.recorder.simulators.genesis.imported import EQUALITIES, GEOMS, ModelEnvironments, collides
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco import imported as of_mujoco
from gpusimbench.recorder.simulators.newton.made import colliding_bodies, different
from gpusimbench.schemas.imported import PARAMETERS, Imported, Values
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few

_READ = "so Genesis holds it"
_SHOWN = 4  # names of a deviation
_JOINTS = {  # by number of genesis.JOINT_TYPE
    1: mjtJoint.mjJNT_HINGE, 2: mjtJoint.mjJNT_SLIDE, 3: mjtJoint.mjJNT_BALL, 4: mjtJoint.mjJNT_FREE,
}  # fmt: skip
_HALVES = {  # sizes that Genesis has in whole, by kind of shape
    mjtGeom.mjGEOM_CAPSULE: (1.0, 0.5), mjtGeom.mjGEOM_CYLINDER: (1.0, 0.5), mjtGeom.mjGEOM_BOX: (0.5, 0.5, 0.5),
    mjtGeom.mjGEOM_SPHERE: (1.0,), mjtGeom.mjGEOM_ELLIPSOID: (1.0, 1.0, 1.0),
}  # fmt: skip
_OFF = (
    "CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "SPRING", "DAMPER", "PASSIVE", "CLAMPCTRL",
    "ACTUATION",
)  # fmt: skip
"""Of what MuJoCo's flags switch off, what Genesis does all the same."""

_UNREAD = {
    "joints/force_range": "not read; the recorder clamps the forces of actuators",
    "geoms/condim": "Genesis has torsional and rolling friction of all contacts, or of none",
    "actuators": "not read; the recorder makes forces and targets of controls",
}


def held(environments: ModelEnvironments, *, dt: float) -> Imported:
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
    unread = {**found.unread, **_UNREAD}
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
    parameters = _as_stated(_host(joints.sol_params)[at], np.asarray(model.jnt_solref), solver, model)
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
    parameters = _host(geoms.sol_params)
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
    parameters = _as_stated(_host(equalities.sol_params)[:count, 0], np.asarray(model.eq_solref), solver, model)
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


def _as_stated(parameters: NDArray[Any], solref: NDArray[np.float64], solver: Any, model: Any) -> NDArray[np.float64]:
    """Genesis holds time constants of two steps at least. MuJoCo takes them so as it steps (refsafe), and holds what
    the model states."""
    found = parameters.astype(np.float64)
    least = np.float32(2 * solver._substep_dt)
    safe = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    raised = safe & (solref[:, 0] > 0) & (solref[:, 0] < least) & (np.abs(found[:, 0] - least) < 1e-6)
    found[raised, 0] = solref[raised, 0]
    return found


def _excluded(environments: ModelEnvironments) -> NDArray[Any]:
    """Of the pairs of bodies that the model excludes, those that do not collide."""
    touching = _touching(environments)
    signatures = np.asarray(environments.compiled.model.exclude_signature)
    apart = [tuple(sorted((int(s) >> 16, int(s) & 0xFFFF))) not in touching for s in signatures]
    return np.asarray(signatures[np.array(apart, dtype=bool)])


def _touching(environments: ModelEnvironments) -> set[tuple[int, int]]:
    """Pairs of MuJoCo's bodies with geoms that Genesis' collider may find in contact."""
    solver, model, match = environments.solver, environments.compiled.model, environments.match
    if not len(match.geoms):
        return set()
    pairs = np.argwhere(_host(solver.collider.collider_info.collision_pair_idx) >= 0)
    body = np.asarray(model.geom_bodyid)[match.geoms]
    return {(min(a, b), max(a, b)) for a, b in ((int(body[g]), int(body[h])) for g, h in pairs)}


def deviations_of_model(environments: ModelEnvironments, known: Imported, options: GenesisOptions) -> list[Deviation]:
    """What Genesis has otherwise than MuJoCo compiles a model file: the engine's numbers compared with MuJoCo's, and
    what is not the same by the nature of the engine."""
    model = environments.compiled.model
    found = list(_of_parameters(of_mujoco.of_c(model), known))
    found += _of_joints(model)
    found += _of_contacts(environments)
    found += _of_options(model, options, environments.solver)
    return found


def _of_parameters(reference: Imported, known: Imported) -> Iterator[Deviation]:
    for parameter in PARAMETERS:
        labels = known.names.get(parameter.kind, ())
        wanted, used = reference.values.get(parameter.key), known.values.get(parameter.key)
        if wanted is None or not labels:
            continue
        every = reference.names[parameter.kind]
        wanted = wanted[[every.index(label) for label in labels if label in every]]
        if len(wanted) < len(labels):
            yield Deviation(f"{parameter.kind}.count", f"{len(wanted)}", f"{len(labels)}", _READ)
            continue
        name = f"{parameter.kind}.{parameter.name}"
        if used is None:
            default = parameter.default
            if default is None or wanted.dtype.kind == "U":
                continue
            numbers = wanted.astype(np.float64)
            rows = np.flatnonzero(((np.abs(numbers) != default) & ~np.isnan(numbers)).any(axis=1))
            if len(rows) and parameter.key not in _UNREAD:
                texts = [f"{labels[row]} {' '.join(f'{x:.6g}' for x in numbers[row])}" for row in rows]
                yield Deviation(name, few(texts, _SHOWN), "none", f"Genesis has no {parameter.name}")
        elif wanted.dtype.kind == "U":
            apart = [row for row in range(len(labels)) if wanted[row].tolist() != used[row].tolist()]
            if apart:
                said = [few([f"{labels[row]} {array[row, 0]}" for row in apart], _SHOWN) for array in (wanted, used)]
                yield Deviation(name, said[0], said[1], _READ)
        else:
            width = min(wanted.shape[1], used.shape[1])
            both = [array[:, :width].astype(np.float64) for array in (wanted, used)]
            yield from different(name, list(labels), both, _READ)


def _of_joints(model: Any) -> Iterator[Deviation]:
    names = [model.joint(int(j)).name or f"joint{j}" for j in model.dof_jntid]
    own = np.concatenate([model.jnt_solref, model.jnt_solimp], axis=1)[np.asarray(model.dof_jntid, dtype=np.int64)]
    given = np.concatenate([model.dof_solref, model.dof_solimp], axis=1)
    apart = np.flatnonzero((np.asarray(model.dof_frictionloss) != 0) & (own != given).any(axis=1))
    if len(apart):
        yield Deviation(
            "joints.solreffriction", f"of {few([names[d] for d in apart], _SHOWN)}", "that of the joint's limit",
            "Genesis has one set of solver parameters a joint",
        )  # fmt: skip
    if model.ntendon:
        labels = [model.tendon(t).name or f"tendon{t}" for t in range(model.ntendon)]
        yield Deviation(
            "tendons", few(labels, _SHOWN), "none", "Genesis has no tendons; the recorder makes forces of their motors"
        )


def _of_contacts(environments: ModelEnvironments) -> Iterator[Deviation]:
    model = environments.compiled.model
    labels = of_mujoco.of_c(model).names["bodies"]
    wanted, used = colliding_bodies(model, np.arange(model.nbody)), _touching(environments)
    for pairs, word, other in (
        (wanted - used, "collide", "do not collide"), (used - wanted, "do not collide", "collide"),
    ):  # fmt: skip
        if pairs:
            listed = [f"{labels[a]} and {labels[b]}" for a, b in sorted(pairs)]
            yield Deviation("contact.pairs", f"{few(listed, _SHOWN)} {word}", other, "by Genesis' rules of pairs")
    shapes = [g for g in range(model.ngeom) if collides(model, g)]
    smooth = [model.geom(g).name or f"geom{g}" for g in shapes if model.geom_condim[g] == 1]
    if smooth:
        yield Deviation(
            "contact.condim", f"no friction where both are of {few(smooth, _SHOWN)}", "friction of the geoms",
            "Genesis' contacts all have friction",
        )  # fmt: skip


def _of_options(model: Any, options: GenesisOptions, solver: Any) -> Iterator[Deviation]:
    said, words = solver_options(model), choices()
    for name, wanted in said.items():
        used: Any = getattr(options, name)
        if name in ("tolerance", "impratio"):
            used = float(getattr(solver._options, name))
        same = wanted == used if name in words else float(wanted) == float(used)
        if not same:
            reason = "an option of Genesis" if name != "integrator" else "Genesis has no other that is as near"
            yield Deviation(f"option.{name}", str(wanted), str(used), reason)
    flags = int(model.opt.disableflags)
    off = [name.lower() for name in _OFF if flags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0))]
    if off:
        yield Deviation("option.disableflags", f"without {', '.join(off)}", "with it", "Genesis is given no such flag")


def _host(array: Any) -> NDArray[Any]:
    return np.asarray(array.to_numpy())
