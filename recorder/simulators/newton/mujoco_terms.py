"""What Newton made of a model file, in the terms of MuJoCo's compiled model, and how the two are compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model import choices
from gpusimbench.recorder.simulators.mujoco.imported import rotation
from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.newton.imported import Imported
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few

Quantities = dict[str, NDArray[np.float64]]
"""Arrays by kind and name of a parameter (schemas.imported), "bodies.mass" or "joints.damping": a row for each body but
the world, or for each joint that is not free, in MuJoCo's order."""

UNREAD = {
    "xpbd": ("armature", "damping", "frictionloss", "stiffness"),
    "featherstone": ("frictionloss",),
    "steel": ("stiffness",),
}
"""By solver, what of joints it does not read (newton 1.8.0, _src/solvers)."""

_UNLIMITED = 1e9  # beyond it, Newton's limits stand for none
_RELATIVE, _ABSOLUTE = 5e-5, 1e-7  # of single precision, with which Newton computes all of this
SHOWN = 4
"""Items that a deviation names."""

_OF_MODEL = ("density", "viscosity", "wind", "gravity")
_OF_SOLVER = ("iterations", "ls_iterations", "noslip_iterations", "tolerance", "impratio", "magnetic")
_GEOM = ("type", "size", "friction", "condim", "solref", "solimp", "margin", "gap", "priority")


def as_mujoco_has_it(model: Any) -> Quantities:
    """The quantities of a mujoco.MjModel [SI]. Inertias are about the centre of mass, in the body's frame, [body, 9];
    ranges are infinite where joints have none."""
    joints = single_joints(model)
    dofs = model.jnt_dofadr[joints]
    turned = np.stack([rotation(quaternion) for quaternion in model.body_iquat])
    inertia = np.einsum("bij,bj,bkj->bik", turned, model.body_inertia, turned)
    limited = np.asarray(model.jnt_limited[joints], dtype=bool)[:, None]
    return {
        "bodies.mass": model.body_mass[1:, None].copy(),
        "bodies.centre_of_mass": model.body_ipos[1:].copy(),
        "bodies.inertia": inertia[1:].reshape(-1, 9),
        "joints.anchor": np.where(_turning(model, joints), model.jnt_pos[joints], 0.0),
        "joints.axis": np.where(_simple(model, joints), model.jnt_axis[joints], 0.0),
        "joints.range": np.where(limited, model.jnt_range[joints], (-np.inf, np.inf)),
        "joints.armature": model.dof_armature[dofs][:, None],
        "joints.damping": model.dof_damping[dofs][:, None],
        "joints.frictionloss": model.dof_frictionloss[dofs][:, None],
        "joints.stiffness": model.jnt_stiffness[joints][:, None],
        "joints.spring_reference": _springs(model, joints, model.qpos_spring[model.jnt_qposadr[joints]]),
    }


def as_newton_has_it(newton_model: Any, imported: Imported, model: Any, solver: str) -> Quantities:
    """The same of a newton.Model, the first of its worlds, as far as the solver reads it: what it does not is zero.

    model  the mujoco.MjModel that MuJoCo itself makes of the file
    """
    joints = single_joints(model)
    bodies = imported.bodies[1:]
    q, qd, own = imported.at_q[joints], imported.at_qd[joints], imported.joints[joints]
    inertia = newton_model.body_inertia.numpy()[bodies].reshape(-1, 9)
    anchors = newton_model.joint_X_c.numpy()[own, :3]
    reference = model.qpos0[model.jnt_qposadr[joints]]
    limits = np.stack([getattr(newton_model, f"joint_limit_{end}").numpy()[qd] for end in ("lower", "upper")], axis=1)
    balls = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_BALL
    limits = np.where((np.abs(limits) >= _UNLIMITED) | balls[:, None], (-np.inf, np.inf), limits + reference[:, None])
    found = {
        "bodies.mass": newton_model.body_mass.numpy()[bodies][:, None],
        "bodies.centre_of_mass": newton_model.body_com.numpy()[bodies],
        "bodies.inertia": inertia,
        "joints.anchor": np.where(_turning(model, joints), anchors, 0.0),
        "joints.axis": np.where(_simple(model, joints), newton_model.joint_axis.numpy()[qd], 0.0),
        "joints.range": limits,
        "joints.armature": newton_model.joint_armature.numpy()[qd][:, None],
        "joints.damping": newton_model.joint_damping.numpy()[qd][:, None],
        "joints.frictionloss": newton_model.joint_friction.numpy()[qd][:, None],
        "joints.stiffness": newton_model.joint_stiffness.numpy()[qd][:, None],
        "joints.spring_reference": _springs(model, joints, newton_model.joint_rest_q.numpy()[q] + reference),
    }
    for name in UNREAD.get(solver, ()):
        found[f"joints.{name}"] = np.zeros_like(found[f"joints.{name}"])
    return {name: array.astype(np.float64) for name, array in found.items()}


def bodies_of_solver(solver: Any, imported: Imported) -> NDArray[np.int64]:
    """By number of a body of SolverMuJoCo's, the model's; 0 for the world and for what the model does not have."""
    of_newton = solver.mjc_body_to_newton.numpy()[0]
    at = np.full(len(of_newton), -1)
    for body, newton_body in enumerate(of_newton):
        found = np.flatnonzero(imported.bodies == newton_body)
        at[body] = found[0] if len(found) else 0
    return at


def different_options(model: Any, made: Any, reason: str) -> Iterator[Deviation]:
    """Options and flags of two mujoco.MjModels that are not the same."""
    for kind, options in (("model", _OF_MODEL), ("option", _OF_SOLVER)):
        for option in options:
            values = [np.atleast_1d(getattr(m.opt, option)).astype(float)[None] for m in (model, made)]
            yield from different(f"{kind}.{option}", [""], values, reason)
    for option, words in _words().items():
        said = [", ".join(w for w, at in words.items() if _has(m.opt, option, at)) or "none" for m in (model, made)]
        if said[0] != said[1]:
            yield Deviation(f"option.{option}", said[0], said[1], reason)


def _words() -> dict[str, dict[str, int]]:
    """Options that are a choice, and flags, by the words for them; MuJoCo's numbers."""
    flags: dict[str, dict[str, int]] = {}
    for option, kind, prefix in (
        ("disableflags", mujoco.mjtDisableBit, "mjDSBL_"),
        ("enableflags", mujoco.mjtEnableBit, "mjENBL_"),
    ):
        names = [name for name in dir(kind) if name.startswith(prefix) and name != "mjDSBL_AUTORESET"]  # engines set it
        flags[option] = {name.removeprefix(prefix).lower(): int(getattr(kind, name)) for name in names}
    return {**choices(), **flags}


def _has(options: Any, option: str, number: int) -> bool:
    value = int(getattr(options, option))
    return bool(value & number) if option.endswith("flags") else value == number


def different_contacts(
    model: Any, made: Any, at: NDArray[np.int64], reason: str, *, unordered: bool = False
) -> Iterator[Deviation]:
    """Shapes that collide, body by body, and pairs of bodies that may; at is by body of `made`, that of `model`.

    unordered  `made` has the shapes that collide and no others, those of a body in any order, and bodies that never
               move may be parts of its world
    """
    names = ["world", *body_names(model)]
    merged = np.array([body for body in range(model.nbody) if not (at == body).any()], dtype=np.int64)
    for body in range(model.nbody):
        if body in merged:
            continue
        own = [_colliding(model, body), _colliding(made, int(np.flatnonzero(at == body)[0]))]
        if unordered:
            own[0] += [geom for other in merged if not body for geom in _colliding(model, int(other))]
            own[1] = list(np.flatnonzero(at[made.geom_bodyid] == body))
            own = [_by_size(m, geoms) for m, geoms in zip((model, made), own, strict=True)]
        if len(own[0]) != len(own[1]):
            yield Deviation(f"{names[body]}.shapes", f"{len(own[0])} that collide", str(len(own[1])), reason)
        if len(own[0]) != len(own[1]) or not own[0]:
            continue
        for what in _GEOM:
            if what == "size":
                sizes = [_sizes(m, geoms) for m, geoms in zip((model, made), own, strict=True)]
            else:
                sizes = [getattr(m, f"geom_{what}")[geoms] for m, geoms in zip((model, made), own, strict=True)]
            rows = [np.asarray(a, dtype=float).reshape(len(geoms), -1) for a, geoms in zip(sizes, own, strict=True)]
            labels = [model.geom(g).name or f"geom{g}" for g in own[0]]
            yield from different(f"{names[body]}.{what}", labels, rows, reason)
    own_numbers = np.where(np.isin(np.arange(model.nbody), merged), 0, np.arange(model.nbody))
    yield from different_pairs(model, colliding_bodies(model, own_numbers), colliding_bodies(made, at), reason)


def different_pairs(
    model: Any, wanted: set[tuple[int, int]], used: set[tuple[int, int]], reason: str
) -> Iterator[Deviation]:
    """Pairs of bodies that touch in one of two models only."""
    names = ["world", *body_names(model)]
    for pairs, word in ((wanted - used, "collide"), (used - wanted, "do not collide")):
        if pairs:
            listed = [f"{names[a]} and {names[b]}" for a, b in sorted(pairs)]
            opposite = "do not collide" if word == "collide" else "collide"
            yield Deviation("contact.pairs", f"{few(listed, SHOWN)} {word}", opposite, reason)


def different(parameter: str, items: list[str], arrays: Sequence[NDArray[Any]], reason: str) -> Iterator[Deviation]:
    """A deviation for the rows of two arrays, wanted and used, that differ by more than single precision explains, if
    any do."""
    wanted, used = arrays
    if not wanted.size:
        return
    finite = np.abs(wanted[np.isfinite(wanted)])
    allowed = np.maximum(_RELATIVE * np.max(np.where(np.isfinite(wanted), np.abs(wanted), 0), axis=1), _ABSOLUTE * (
        1 if not finite.size else min(1.0, float(finite.max()) or 1.0)))  # fmt: skip
    with np.errstate(invalid="ignore"):
        off = np.where(wanted == used, 0.0, np.abs(wanted - used))
    rows = np.flatnonzero((off > allowed[:, None]).any(axis=1))
    if len(rows):
        texts = [
            [f"{items[row]} {' '.join(f'{x:.6g}' for x in array[row])}".strip() for row in rows]
            for array in (wanted, used)
        ]
        yield Deviation(parameter, few(texts[0], SHOWN), few(texts[1], SHOWN), reason)


def single_joints(model: Any) -> NDArray[np.int64]:
    """Numbers of the joints that are not free."""
    return np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE)


def joint_name(model: Any, joint: int) -> str:
    """Its name, or else its number."""
    return str(model.joint(joint).name or f"joint{joint}")


def body_names(model: Any) -> list[str]:
    """Of all bodies but the world, as joint_name."""
    return [str(model.body(body).name or f"body{body}") for body in range(1, model.nbody)]


def _turning(model: Any, joints: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(model.jnt_type[joints] != mujoco.mjtJoint.mjJNT_SLIDE)[:, None]


def _simple(model: Any, joints: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(model.jnt_type[joints] != mujoco.mjtJoint.mjJNT_BALL)[:, None]


def _springs(model: Any, joints: NDArray[np.int64], reference: NDArray[Any]) -> NDArray[np.float64]:
    # where there is a spring
    return np.where(_simple(model, joints)[:, 0] & (model.jnt_stiffness[joints] != 0), reference, 0.0)[:, None]


def _colliding(model: Any, body: int) -> list[int]:
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and collides(model, g)]


def _by_size(model: Any, geoms: list[int]) -> list[int]:
    # shapes of several bodies in one have no order of their own
    rows = np.round(_sizes(model, geoms), 6).tolist()
    order = sorted(range(len(geoms)), key=lambda i: (int(model.geom_type[geoms[i]]), rows[i]))
    return [geoms[i] for i in order]


def _sizes(model: Any, geoms: list[int]) -> NDArray[np.float64]:
    # of planes nothing, as those of engines have no edge; of meshes their number of points
    sizes = np.array(model.geom_size[geoms], dtype=float).reshape(-1, 3)
    kinds = model.geom_type[geoms]
    sizes[kinds == mujoco.mjtGeom.mjGEOM_PLANE] = 0
    sizes[kinds == mujoco.mjtGeom.mjGEOM_MESH] = 0
    lengths = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_CYLINDER: 2}
    for kind, used in lengths.items():
        sizes[kinds == kind, used:] = 0
    return sizes


def colliding_bodies(model: Any, at: NDArray[np.int64] | None = None) -> set[tuple[int, int]]:
    """Pairs of bodies, by their numbers in `at` if that is given, that may touch as MuJoCo decides it."""
    at = np.arange(model.nbody) if at is None else at
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    parents_apart = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    found: set[tuple[int, int]] = set()
    shapes = [_colliding(model, body) for body in range(model.nbody)]
    weld = model.body_weldid
    for a in range(model.nbody):
        for b in range(a + 1, model.nbody):
            if weld[a] == weld[b] or (a, b) in excluded or (b, a) in excluded:
                continue
            up_a, up_b = (weld[model.body_parentid[weld[body]]] for body in (a, b))
            if parents_apart and weld[a] and weld[b] and (weld[a] == up_b or weld[b] == up_a):
                continue
            if any(_may_touch(model, g, h) for g in shapes[a] for h in shapes[b]):
                found.add((min(int(at[a]), int(at[b])), max(int(at[a]), int(at[b]))))
    return found


def _may_touch(model: Any, a: int, b: int) -> bool:
    kind, with_ = model.geom_contype, model.geom_conaffinity
    return bool(kind[a] & with_[b] or kind[b] & with_[a])
