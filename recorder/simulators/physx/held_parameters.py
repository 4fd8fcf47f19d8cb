"""What PhysX holds of a model file, read from the engine, and what of the model it has otherwise or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model import solver_options
from gpusimbench.recorder.simulators.mujoco import imported as of_mujoco
from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.newton.mujoco_terms import Quantities, as_mujoco_has_it, different
from gpusimbench.recorder.simulators.physx.options import PhysxOptions
from gpusimbench.recorder.simulators.physx.plan import ADDED_SHARE, Plan, Tree, apart, friction_of, frictions, may_touch
from gpusimbench.recorder.simulators.physx.servos import Servo
from gpusimbench.recorder.simulators.physx.stage import FAR
from gpusimbench.schemas.imported import PARAMETERS, Imported, Values
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few

_FRAMES = "PhysX does not tell the frames of joints; the kinematics compare them"
_SHAPES = "PhysX does not tell shapes by name"
_HELD = "so PhysX holds it"
_NAMED = 4  # in a deviation
_HULL = 64  # corners of a convex hull, at most

_COMBINED: dict[str, Callable[[float, float], float]] = {
    "max": max,
    "min": min,
    "average": lambda a, b: (a + b) / 2,
    "multiply": lambda a, b: a * b,
}
_OFF = (
    "CONSTRAINT", "FRICTIONLOSS", "LIMIT", "CONTACT", "SPRING", "DAMPER", "PASSIVE", "CLAMPCTRL", "ACTUATION",
)  # fmt: skip
"""Of what MuJoCo's flags switch off, what PhysX would do all the same."""


@dataclass(frozen=True)
class HeldParameters:
    """What PhysX holds, the first environment.

    quantities  as of as_mujoco_has_it: rows of all bodies but the world, and of all joints that are not
                free; what PhysX does not tell is left out. Bodies that never move are not in it: their rows are
                MuJoCo's
    added       names and masses of links that are no bodies of the model's
    """

    quantities: Quantities
    added: dict[str, float]


class Source(Protocol):
    """The articulations of all environments, as the engine has them."""

    def held(self, tree: Tree, name: str) -> tuple[Sequence[str], Sequence[str], NDArray[np.float32]]:
        """What PhysX holds of a tree in environment 0, by the name of a tensor (ovphysx.types.TensorType without
        ARTICULATION_): names of its links, names of its joints, and the rows."""

    def link_poses(self) -> NDArray[np.float32]:
        """Poses of MuJoCo's bodies, positions and quaternions wxyz, [env, body, 7]; those that never move are where
        MuJoCo has them, beside each environment's origin."""


def held_parameters(plan: Plan, servos: dict[int, Servo], source: Source) -> HeldParameters:
    """Read it from the engine's tensors."""
    model = plan.model
    found = {name: array.copy() for name, array in as_mujoco_has_it(model).items()}
    joints = [int(j) for j in np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE)]
    added: dict[str, float] = {}
    for tree in plan.trees:
        links = {link.prim: link for link in tree.links}
        read = {name: source.held(tree, f"BODY_{name}") for name in ("MASS", "COM_POSE", "INERTIA")}
        names = read["MASS"][0]
        for number, name in enumerate(names):
            body, mass = links[name].body, float(read["MASS"][2][number])
            if body < 0:
                added |= {name: mass} if links[name].parent >= 0 else {}  # the first is fixed to the world
                continue
            found["bodies.mass"][body - 1] = mass
            found["bodies.centre_of_mass"][body - 1] = read["COM_POSE"][2][number, :3]
            found["bodies.inertia"][body - 1] = read["INERTIA"][2][number]
        if not tree.joints():
            continue
        of = {plan.joint_prims[joint]: joint for joint in tree.joints()}
        words = ("LIMIT", "ARMATURE", "FRICTION_PROPERTIES", "STIFFNESS", "DAMPING")
        tensors = {word: source.held(tree, f"DOF_{word}") for word in words}
        for number, name in enumerate(tensors["LIMIT"][1]):
            joint, servo = of[name], servos[of[name]]
            row = joints.index(joint)
            limits = tensors["LIMIT"][2][number].astype(np.float64)
            reference = model.qpos0[model.jnt_qposadr[joint]]
            found["joints.range"][row] = np.where(
                np.abs(limits) >= FAR, np.copysign(np.inf, limits), limits + reference
            )
            found["joints.armature"][row] = tensors["ARMATURE"][2][number]
            found["joints.frictionloss"][row] = tensors["FRICTION_PROPERTIES"][2][number, 0]
            found["joints.stiffness"][row] = tensors["STIFFNESS"][2][number] - servo.kp
            found["joints.damping"][row] = tensors["DAMPING"][2][number] - servo.kv - servo.hold
    for name in ("joints.anchor", "joints.axis", "joints.spring_reference"):
        del found[name]
    return HeldParameters(found, added)


def deviations_of_model(
    plan: Plan, known: HeldParameters, options: PhysxOptions, *, file: str, gpu: bool
) -> list[Deviation]:
    """What PhysX has otherwise than MuJoCo compiles a model file: the engine's numbers compared with MuJoCo's, and what
    is not the same by the nature of the engine."""
    model = plan.model
    wanted = as_mujoco_has_it(model)
    names = {
        "bodies": [model.body(b).name or f"body{b}" for b in range(1, model.nbody)],
        "joints": [
            model.joint(j).name or f"joint{j}"
            for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE
        ],
    }  # fmt: skip
    found: list[Deviation] = []
    for quantity, array in known.quantities.items():
        found += different(quantity, names[quantity.partition(".")[0]], (wanted[quantity], array), _HELD)
    found += _of_added(known, plan, file)
    found += _of_joints(model)
    found += _of_contacts(plan, options, gpu=gpu)
    found += _of_the_rest(model)
    return found


def _of_added(known: HeldParameters, plan: Plan, file: str) -> Iterator[Deviation]:
    if known.added:
        several = [plan.model.body(b).name or f"body{b}" for b in np.flatnonzero(plan.model.body_jntnum > 1)]
        yield Deviation(
            "bodies.added", f"the bodies of {file}", f"{len(known.added)} more, of {sum(known.added.values()):.3g} kg",
            f"a link of PhysX has one joint, so that between the joints of {few(several, _NAMED)} are links with a "
            f"share of {ADDED_SHARE:g} of the body's mass",
        )  # fmt: skip


def _of_joints(model: Any) -> Iterator[Deviation]:
    if np.any(model.jnt_limited):
        yield Deviation(
            "joints.limit_solref", "of each limit", "none: a joint never passes its limit",
            "PhysX's limits are not soft; a joint that begins beyond its limit is put back in the first step",
        )  # fmt: skip
    if np.any(model.dof_frictionloss):
        yield Deviation(
            "joints.solreffriction", "of each joint", "none: friction holds a joint up to its effort",
            "PhysX's friction of joints is not soft",
        )  # fmt: skip
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    for what in ("damping", "armature", "frictionloss"):
        dofs = [model.jnt_dofadr[j] for j in free]
        values = [float(getattr(model, f"dof_{what}")[d : d + 6].max()) for d in dofs]
        if any(values):
            yield Deviation(f"bodies.{what}", f"up to {max(values):g}", "0", f"a free body of PhysX has no {what}")
    if np.any(model.jnt_stiffness[free]):
        most = f"up to {model.jnt_stiffness[free].max():g}"
        yield Deviation("bodies.stiffness", most, "0", "a free body of PhysX has no spring of its own")


def _of_contacts(plan: Plan, options: PhysxOptions, *, gpu: bool) -> Iterator[Deviation]:
    model = plan.model
    shapes = [g for g in range(model.ngeom) if collides(model, g)]
    names = [model.geom(g).name or f"geom{g}" for g in range(model.ngeom)]
    pairs = [(g, h) for g in shapes for h in shapes if g < h and may_touch(model, g, h)]
    if not pairs:
        return
    yield Deviation(
        "geoms.solref", "of each geom", "rigid contacts",
        "PhysX's contacts have no solref, solimp, condim or priority, and MuJoCo's no restitution, which is 0 here",
    )  # fmt: skip
    of_a_pair, given = {}, frictions(model)
    for g, h in pairs:
        used = _COMBINED[options.friction_combine](given[g], given[h])
        if abs(used - (wanted := friction_of(model, g, h))) > 1e-6:
            of_a_pair[f"{names[g]} and {names[h]}"] = wanted, used
    if of_a_pair:
        texts = [[f"{pair} {values[k]:g}" for pair, values in of_a_pair.items()] for k in (0, 1)]
        yield Deviation(
            "contact.pair_friction", few(texts[0], _NAMED), few(texts[1], _NAMED),
            f"option 'friction_combine' ({options.friction_combine})",
        )  # fmt: skip
    if turning := [names[g] for g in shapes if model.geom_condim[g] > 3]:
        yield Deviation(
            "contact.condim", f"torsional or rolling friction of {few(turning, _NAMED)}", "none",
            "PhysX's contacts have friction against sliding alone",
        )  # fmt: skip
    if apart_by := [names[g] for g in shapes if model.geom_margin[g]]:
        yield Deviation(
            "geoms.margin", f"of {few(apart_by, _NAMED)}", "0", "contacts of PhysX begin where shapes touch"
        )
    if lost := apart(plan).lost:
        bodies = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
        listed = few([f"{bodies[a]} and {bodies[b]}" for a, b in lost], _NAMED)
        yield Deviation("contact.pairs", f"{listed} collide", "do not collide", "PhysX keeps neighbouring links apart")
    kinds = mujoco.mjtGeom
    if meshes := [names[g] for g in shapes if model.geom_type[g] == kinds.mjGEOM_MESH]:
        yield Deviation(
            "contact.meshes", f"convex hulls of {few(meshes, _NAMED)}", f"hulls of at most {_HULL} corners",
            "PhysX cooks meshes that are convex and small",
        )  # fmt: skip
    if gpu and (round_ := [names[g] for g in shapes if model.geom_type[g] == kinds.mjGEOM_CYLINDER]):
        yield Deviation("contact.cylinders", few(round_, _NAMED), "as PhysX has them on a GPU", "not examined there")


def _of_the_rest(model: Any) -> Iterator[Deviation]:
    said = ", ".join(f"{key} {value}" for key, value in solver_options(model).items())
    yield Deviation(
        "option", said, "those of PhysX's solver",
        "they are of MuJoCo's integrator and solver; springs, damping and servos are implicit here, and TGS moves "
        "positions in as many parts of a step as it has iterations",
    )  # fmt: skip
    for key in ("density", "viscosity"):
        if value := getattr(model.opt, key):
            yield Deviation(f"model.{key}", f"{value:g}", "0", "PhysX has no forces of a medium")
    flags = int(model.opt.disableflags)
    off = [name.lower() for name in _OFF if flags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0))]
    if off:
        yield Deviation("option.disableflags", f"without {', '.join(off)}", "with it", "PhysX is given no such flag")
    against = model.body_gravcomp
    if partly := [model.body(b).name or f"body{b}" for b in range(1, model.nbody) if against[b] not in (0, 1)]:
        yield Deviation(
            "bodies.gravity_compensation", few(partly, _NAMED), "0", "gravity acts on a link of PhysX, or does not"
        )
    massless = [
        model.body(b).name or f"body{b}"
        for b in range(1, model.nbody) if model.body_weldid[b] and not model.body_mass[b]
    ]  # fmt: skip
    if massless:
        yield Deviation("bodies.massless", few(massless, _NAMED), "nearly so", "a link of PhysX has a mass")


def imported_of(plan: Plan, known: HeldParameters, *, dt: float) -> Imported:
    """The parameters that PhysX holds, by MuJoCo's names."""
    model = plan.model
    reference = of_mujoco.of_c(model)
    bodies, joints = list(reference.names["bodies"]), list(reference.names["joints"])
    single = np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE)
    extra = list(known.added)
    names = {
        "model": ("model",), "bodies": (*bodies, *extra), "joints": tuple(joints), "tendons": (), "equalities": (),
        "pairs": (),
    }  # fmt: skip
    values: dict[str, Values] = {"model/timestep": np.array([[dt]])}
    for parameter in PARAMETERS:
        rows = known.quantities.get(f"{parameter.kind}.{parameter.name}")
        if rows is None:
            continue
        if parameter.name == "inertia":
            rows = np.array([of_mujoco.six(row.reshape(3, 3)) for row in rows])
        whole = np.full((len(names[parameter.kind]), rows.shape[1]), np.nan)
        if parameter.kind == "bodies":
            whole[0] = 0.0
            whole[1 : len(bodies)] = rows
            if parameter.name == "mass":
                whole[len(bodies) :, 0] = list(known.added.values())
        else:
            whole[single] = rows
            if parameter.name == "range":
                whole[[j for j in range(model.njnt) if j not in single]] = (-np.inf, np.inf)
        values[parameter.key] = whole
    unread = {
        "model/gravity": "PhysX does not tell it; the trials compare what it does",
        **{f"model/{word}": "PhysX has no forces of a medium" for word in ("wind", "density", "viscosity")},
        **{f"bodies/{word}": _FRAMES for word in ("parent", "position", "orientation")},
        "bodies/gravity_compensation": "PhysX has none but that a link has no gravity",
        **{f"joints/{word}": _FRAMES for word in ("type", "body", "anchor", "axis", "reference")},
        "joints/spring_reference": "PhysX holds one target of a drive; the trials compare what it does",
        "joints/force_range": "not read; the recorder clamps the forces of motors",
        **{f"joints/limit_{word}": "PhysX's limits are not soft" for word in ("solref", "solimp")},
        "joints/margin": "PhysX's limits have no margin",
        "geoms": _SHAPES,
        "excludes": _SHAPES,
        "actuators": "not read; the recorder makes forces and targets of controls",
    }
    return Imported(names, values, unread)
