"""What Newton's solvers do with the contact parameters of a scene; and what its importer and solvers make of MJCF
otherwise than MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import (
    LARGER,
    MEAN,
    combination,
    materials_and_robot,
    one_friction,
    other_restitution,
    unlimited_speed,
)
from gpusimbench.recorder.scenes.model import actuator_names, solver_options
from gpusimbench.recorder.simulators.newton.imported import Imported
from gpusimbench.recorder.simulators.newton.mujoco_terms import (
    SHOWN,
    UNREAD,
    as_mujoco_has_it,
    as_newton_has_it,
    bodies_of_solver,
    body_names,
    colliding_bodies,
    different,
    different_contacts,
    different_options,
    different_pairs,
    joint_name,
    single_joints,
)
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few, plural

_ONE_FRICTION = "Newton has one friction coefficient a shape; the kinetic one is used"

_FRICTION_OF_A_PAIR = {
    "mujoco": LARGER,
    "xpbd": MEAN,
    "steel": MEAN,
    "semi-implicit": MEAN,
    "featherstone": MEAN,
    "vbd": "the geometric mean of the two coefficients",
    "kamino": MEAN,
}

_NO_RESTITUTION = {
    "mujoco": "contacts are damped springs of ke and kd",
    "semi-implicit": "contacts are damped springs of ke and kd",
    "featherstone": "contacts are damped springs of ke and kd",
    "vbd": "contacts are damped springs of ke and kd",
}

_STICTION = {
    "steel": "friction patches hold what rests by a spring along the surface, up to the same coefficient",
    "semi-implicit": "friction is viscous, of gain kf, up to the coefficient: nothing sticks",
    "featherstone": "friction is viscous, of gain kf, up to the coefficient: nothing sticks",
    "vbd": "friction is smoothed below a slip of friction_epsilon: nothing sticks",
}


def deviations(scene: Scene, options: NewtonOptions) -> tuple[Deviation, ...]:
    """The parameters that the chosen solver honours otherwise than the scene gives them, or not at all."""
    solver = options.solver
    found = [combination("friction", _FRICTION_OF_A_PAIR[solver], f"rule of {solver}")]
    for material in materials_and_robot(scene):
        found += [
            one_friction(material, f"{_ONE_FRICTION}; {_STICTION[solver]}" if solver in _STICTION else _ONE_FRICTION),
            other_restitution(material, *_restitution(solver, options.rebounds, material.restitution)),
        ]
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "MJCF, by which Newton reads robots, has no velocity limits"))
        if solver != "mujoco" and any(joint.stiffness or joint.damping for joint in scene.robot.joints()):
            torques = " ".join(str(joint.max_torque) for joint in scene.robot.joints())
            found.append(Deviation("joint.max_torque", torques, "not enforced", f"servos of {solver} have no limit"))
    return tuple(found)


def _restitution(solver: str, switched_on: bool, wanted: float) -> tuple[str, str]:
    if solver in _NO_RESTITUTION:
        return "none of its own", f"{solver} has no coefficient of restitution: {_NO_RESTITUTION[solver]}"
    if solver == "kamino":
        return str(wanted), "of a pair the smaller coefficient"
    if not switched_on:
        return "0", f"{solver} is not asked for it (option 'restitution')"
    if solver == "steel":
        return str(wanted), "of a pair the mean of the two; only where they close faster than 0.5 m/s"
    return str(wanted), "of a pair the mean of the two"


_ACTUATOR = (
    "trntype", "dyntype", "gaintype", "biastype", "gear", "gainprm", "biasprm", "dynprm", "ctrllimited", "ctrlrange",
    "forcelimited", "forcerange", "actlimited", "actrange",
)  # fmt: skip
_WRAP = ("type", "prm")
_TENDON = ("num", "stiffness", "damping", "frictionloss", "limited", "range")
_PAIR = ("dim", "friction", "solref", "solimp", "margin", "gap")
_EQUALITY = ("type", "data", "solref", "solimp", "active0")
_KINDS = {"actuator": "actuators", "tendon": "tendons", "eq": "equalities", "pair": "pairs"}
_NAMES = {
    "gaintype": "gain_type", "gainprm": "gain", "biastype": "bias_type", "biasprm": "bias", "dyntype": "dynamics_type",
    "dynprm": "dynamics", "ctrlrange": "control_range", "forcerange": "force_range", "actrange": "activation_range",
    "active0": "active",
}  # fmt: skip
"""Kinds and parameters of schemas.imported by the words of MjModel's arrays, where they are others."""


def deviations_of_import(
    newton_model: Any, solver: Any, imported: Imported, model: Any, name: str, *, of_file: bool = True
) -> list[Deviation]:
    """Where a model in Newton is not as MuJoCo compiles it.

    solver   that was made of newton_model
    name     of the solver
    of_file  the model is a file, which asks for MuJoCo's options and contact parameters; a registered scene does not
    """
    unread = UNREAD.get(name, ())
    wanted, found = as_mujoco_has_it(model), as_newton_has_it(newton_model, imported, model, name)
    items = {"bodies": body_names(model), "joints": [joint_name(model, j) for j in single_joints(model)]}
    said: list[Deviation] = []
    for quantity, array in wanted.items():
        kind, _, what = quantity.partition(".")
        reason = f"solver {name} has no {what}" if what in unread else "so Newton's importer makes it"
        said += different(quantity, items[kind], (array, found[quantity]), reason)
    if name == "mujoco":
        return said + list(_of_mujoco(solver, imported, model))
    used = _touching_in_newton(imported)
    said += different_pairs(model, colliding_bodies(model) | _paired(model), used, "so Newton's importer makes it")
    return said + list(_not_of_others(model, imported, name, of_file))


def _of_mujoco(solver: Any, imported: Imported, model: Any) -> Iterator[Deviation]:
    """What SolverMuJoCo's own mujoco.MjModel has otherwise, beyond bodies and joints. Refused where it lacks actuators:
    their controls would move others."""
    made = solver.mj_model
    if made.nu != model.nu:
        kept = {made.tendon(t).name for t in range(made.ntendon)}
        lost = [name for name in (model.tendon(t).name for t in range(model.ntendon)) if name not in kept]
        without = f", and lacks the tendons {', '.join(lost)}" if lost else ""
        raise Refused(f"SolverMuJoCo makes {made.nu} of the model's {model.nu} actuators{without}")
    reason = "so Newton's importer and SolverMuJoCo make it"
    yield from different_options(model, made, reason)
    actuators = list(actuator_names(model))
    yield from _table("actuator", _ACTUATOR, actuators, model, made, reason)
    places = solver.mjc_jnt_to_newton_dof.numpy()[0]
    yield from _different_limits(model, made, imported, places, reason)
    targets = [_target(m, at) for m, at in ((model, imported.at_qd), (made, places))]
    yield from different("actuators.target", actuators, [t[:, None] for t in targets], reason)
    tendons = [model.tendon(t).name or f"tendon{t}" for t in range(model.ntendon)]
    yield from _table("tendon", _TENDON, tendons, model, made, reason)
    if model.nwrap == made.nwrap:
        yield from _table("wrap", _WRAP, [str(w) for w in range(model.nwrap)], model, made, reason)
    yield from _table(
        "eq", _EQUALITY, [model.equality(e).name or f"{e}" for e in range(model.neq)], model, made, reason
    )
    pairs = [f"pair{p}" for p in range(model.npair)]
    yield from _table("pair", _PAIR, pairs, model, made, reason)
    if model.npair == made.npair:
        along = [_along(m.pair_solref, m.pair_solreffriction) for m in (model, made)]
        yield from different("pairs.solreffriction", pairs, along, reason)
    yield from different_contacts(model, made, bodies_of_solver(solver, imported), reason)


def _different_limits(
    model: Any, made: Any, imported: Imported, places: NDArray[np.int64], reason: str
) -> Iterator[Deviation]:
    """How soft the limits of joints are; places by joint of `made`: the last of its numbers in joint_qd."""
    joints = np.flatnonzero(model.jnt_limited)
    last = imported.at_qd[joints] + 2 * (model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_BALL)
    own = [int(np.flatnonzero(places[: made.njnt] == at)[0]) for at in last]
    for name in ("solref", "solimp"):
        rows = [getattr(m, f"jnt_{name}")[numbers] for m, numbers in ((model, joints), (made, own))]
        yield from different(f"joints.limit_{name}", [joint_name(model, int(j)) for j in joints], rows, reason)


def _along(solref: NDArray[Any], solreffriction: NDArray[Any]) -> NDArray[Any]:
    """What is in force along the surface: zeros stand for what is in force across it."""
    return np.where(solreffriction.any(axis=1, keepdims=True), solreffriction, solref)


def _paired(model: Any) -> set[tuple[int, int]]:
    """Pairs of bodies of which the model names two shapes as a pair, which touch whatever their masks say."""
    ends = (model.geom_bodyid[geoms] for geoms in (model.pair_geom1, model.pair_geom2))
    return {(min(a, b), max(a, b)) for a, b in zip(*(numbers.tolist() for numbers in ends), strict=True)}


def _touching_in_newton(imported: Imported) -> set[tuple[int, int]]:
    """Pairs of bodies, by MuJoCo's numbers, that Newton's own collision detection lets touch."""
    from newton import ShapeFlags

    builder = imported.builder
    numbers = {int(own): body for body, own in enumerate(imported.bodies)}  # the world's is -1 in both
    shapes = [s for s in range(builder.shape_count) if builder.shape_flags[s] & ShapeFlags.COLLIDE_SHAPES]
    at = {s: numbers[int(builder.shape_body[s])] for s in shapes}
    apart = {(min(pair), max(pair)) for pair in builder.shape_collision_filter_pairs}
    group = builder.shape_collision_group
    pairs = ((a, b) for a, b in combinations(shapes, 2) if (a, b) not in apart and at[a] != at[b])
    return {(min(at[a], at[b]), max(at[a], at[b])) for a, b in pairs if _groups_touch(group[a], group[b])}


def _groups_touch(a: int, b: int) -> bool:
    # shapes of a negative group touch all but their own, those of a positive one their own and the negative ones
    if not (a and b):
        return False
    return bool(a == b or b < 0) if a > 0 else bool(a != b)


def _not_of_others(model: Any, imported: Imported, name: str, of_file: bool) -> Iterator[Deviation]:
    """What solvers other than MuJoCo's have nothing for."""
    if not of_file:
        return  # no scene has any of the following
    options = ", ".join(f"{key} {value}" for key, value in solver_options(model).items())
    yield Deviation("option", options, f"those of solver {name}", "they are of MuJoCo's integrator and solver")
    fluid = {key: getattr(model.opt, key) for key in ("density", "viscosity")}
    for key, value in fluid.items():
        if value:
            yield Deviation(f"model.{key}", f"{value:g}", "0", f"solver {name} has no forces of a medium")
    for t in range(model.ntendon):
        words = ("stiffness", "damping", "frictionloss", "limited")
        if has := [w for w in words if np.any(getattr(model, f"tendon_{w}")[t])]:
            label = model.tendon(t).name or f"tendon{t}"
            yield Deviation(f"{label}.{has[0]}", "of a tendon", "none", f"solver {name} has no tendons")
    for e in range(model.neq):
        kind = mujoco.mjtEq(model.eq_type[e]).name.removeprefix("mjEQ_").lower()
        label = model.equality(e).name or f"equality{e}"
        yield Deviation(label, f"constraint of equality, {kind}", "none", f"solver {name} is given none of MuJoCo's")
    if np.any(model.body_gravcomp):
        yield Deviation(
            "bodies.gravity_compensation",
            few(body_names(model), SHOWN),
            "0",
            f"solver {name} has no compensation of gravity",
        )
    if np.any(model.jnt_actfrclimited):
        yield Deviation("joints.force_range", "limited", "unlimited", f"solver {name} does not limit drives")
    if np.any(model.jnt_limited):
        gains = sorted(set(zip(imported.builder.joint_limit_ke, imported.builder.joint_limit_kd, strict=True)))
        springs = few([f"ke {ke:g} and kd {kd:g}" for ke, kd in gains], SHOWN)
        used, why = (f"springs of {springs}", "springs") if name == "featherstone" else ("hard", "hard limits")
        yield Deviation("joints.limit_solref", "of each limited joint", used, f"solver {name} has {why}: no solimp")
    if model.npair:
        yield Deviation(
            "pairs", f"parameters of {plural(model.npair, 'pair')} of geoms", "parameters of the shapes",
            f"solver {name} has contacts of its own, without parameters of pairs",
        )  # fmt: skip
    yield Deviation(
        "geoms.solref", "of each geom", "ke and kd of each shape, where the solver has them",
        f"solver {name} has contacts of its own: no solimp, condim, margin or priority",
    )  # fmt: skip


def _table(
    kind: str, names: tuple[str, ...], items: list[str], model: Any, made: Any, reason: str
) -> Iterator[Deviation]:
    wanted, used = (len(getattr(m, f"{kind}_{names[0]}")) for m in (model, made))
    if wanted != used:
        yield Deviation(f"{_KINDS.get(kind, kind)}.count", str(wanted), str(used), reason)
    if wanted != used or not wanted:
        return
    for name in names:
        rows = [np.asarray(getattr(m, f"{kind}_{name}"), dtype=float).reshape(wanted, -1) for m in (model, made)]
        yield from different(f"{_KINDS.get(kind, kind)}.{_NAMES.get(name, name)}", items, rows, reason)


def _target(model: Any, at_qd: NDArray[np.int64]) -> NDArray[np.float64]:
    of_joints = np.isin(model.actuator_trntype, [mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT])
    targets = np.where(of_joints, model.actuator_trnid[:, 0], 0)
    return np.where(of_joints, at_qd[targets] if len(at_qd) else 0, -1).astype(float)
