"""What Newton holds of a model file, by MuJoCo's names, as it is recorded.

Solver mujoco steps a mujoco_warp.Model that SolverMuJoCo makes of Newton's, so that is read, name by name; of the other
solvers Newton's own arrays, as far as the solver reads them (made.as_newton_has_it).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.mujoco import imported as of_mujoco
from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.newton.imported import Imported as Places
from gpusimbench.recorder.simulators.newton.mujoco_terms import UNREAD, as_newton_has_it, colliding_bodies
from gpusimbench.recorder.simulators.warp import worlds
from gpusimbench.schemas.imported import PARAMETERS, Imported, Values

_DOFS = {0: 6, 1: 3}  # of mujoco.mjtJoint's free and ball joints; others have one
_FRAMES = "Newton holds frames of joints; the kinematics compare them"
_KINDS = "Newton holds other kinds of joints; the kinematics compare them"
_MASKS = "Newton decides by groups of shapes; excludes and pairs are compared"
_UNLIMITED = 1e6  # [N m or N] Newton's default stands for no limit
_OF_DOFS = {"armature": "joint_armature", "damping": "joint_damping", "frictionloss": "joint_friction"}


def held_parameters(newton_model: Any, solver: Any, places: Places, model: Any, *, name: str, dt: float) -> Imported:
    """What a newton.Model holds, the first of its worlds.

    solver  that was made of it
    places  where bodies and joints are in it
    model   the mujoco.MjModel that MuJoCo itself makes of the file
    name    of the solver
    dt      that it is told at each step [s]
    """
    found = _of_solver(solver, places, model) if name == "mujoco" else _of_newton(newton_model, places, model, name)
    return replace(found, values={**found.values, "model/timestep": np.array([[dt]])})


def _of_solver(solver: Any, places: Places, model: Any) -> Imported:
    made, reference = solver.mj_model, of_mujoco.of_c(model)
    names = reference.names
    at = np.array([_number(places.bodies, int(body)) for body in solver.mjc_body_to_newton.numpy()[0]])
    last = {int(places.at_qd[j]) + _DOFS.get(int(model.jnt_type[j]), 1) - 1: j for j in range(model.njnt)}
    joints = [last.get(int(dof), -1) for dof in solver.mjc_jnt_to_newton_dof.numpy()[0][: made.njnt]]
    named: dict[str, Sequence[str]] = {
        "bodies": [_listed(names["bodies"], body, "body of Newton's") for body in at],
        "joints": [_listed(names["joints"], joint, "joint of Newton's") for joint in joints],
    }
    named["geoms"] = [_geom(made, geom, at, model, names["geoms"]) for geom in range(made.ngeom)]
    named["actuators"] = _actuators(made, names["actuators"])
    found = of_mujoco.imported(made, worlds.reader(solver.mjw_model), "SolverMuJoCo", named)
    equalities = tuple(_constraint(found, number, reference) for number in range(len(found.names["equalities"])))
    unread = dict(found.unread)
    values = dict(found.values)
    for key, why in (("geoms/contype", _MASKS), ("geoms/conaffinity", _MASKS)):
        values.pop(key, None)
        unread[key] = why
    if "joints/force_range" in values:
        limits = values["joints/force_range"].astype(np.float64)
        values["joints/force_range"] = np.where(np.abs(limits) >= _UNLIMITED, np.sign(limits) * np.inf, limits)
    collide = colliding_bodies(made, at)
    excluded = []
    for signature, label in zip(model.exclude_signature, names["excludes"], strict=True):
        pair = tuple(sorted((int(signature) >> 16, int(signature) & 0xFFFF)))
        excluded += [label] if pair not in collide else []
    return Imported({**found.names, "excludes": tuple(excluded), "equalities": equalities}, values, unread)


def _of_newton(newton_model: Any, places: Places, model: Any, name: str) -> Imported:
    reference = of_mujoco.of_c(model)
    single = np.flatnonzero(model.jnt_type != 0)  # of free joints Newton holds nothing beyond that they are there
    quantities = as_newton_has_it(newton_model, places, model, name)
    order = {"bodies": np.argsort(places.bodies, kind="stable"), "joints": np.argsort(places.at_qd, kind="stable")}
    names: dict[str, tuple[str, ...]] = {"model": ("model",), "tendons": (), "equalities": ()}
    names |= {kind: tuple(reference.names[kind][int(i)] for i in rows) for kind, rows in order.items()}
    values: dict[str, Values] = {"model/gravity": newton_model.gravity.numpy()[:1].astype(np.float64)}
    unread = {
        "bodies/parent": _FRAMES, "bodies/position": _FRAMES,
        "bodies/orientation": _FRAMES, "joints/type": _KINDS, "joints/body": _KINDS, "joints/reference": _KINDS,
        **_lost(name),
    }  # fmt: skip
    for parameter in PARAMETERS:
        rows = quantities.get(f"{parameter.kind}.{parameter.name}")
        if rows is None:
            continue
        if parameter.name == "inertia":
            rows = np.array([of_mujoco.six(row.reshape(3, 3)) for row in rows])
        if parameter.kind == "bodies":
            whole = np.concatenate([np.zeros((1, rows.shape[1])), rows])  # of the world, which has none
        else:
            whole = np.full((model.njnt, rows.shape[1]), np.nan)
            whole[single] = rows
            if parameter.name in _OF_DOFS and parameter.name not in UNREAD.get(name, ()):
                whole = _by_dof(getattr(newton_model, _OF_DOFS[parameter.name]).numpy(), places, model)
            if parameter.name == "range":
                whole[model.jnt_type == 0] = (-np.inf, np.inf)
        values[parameter.key] = _meant(whole, reference.values.get(parameter.key))[order[parameter.kind]]
    return Imported(names, values, unread)


def _by_dof(values: NDArray[np.float32], places: Places, model: Any) -> NDArray[np.float64]:
    found = np.full((model.njnt, max(_DOFS.values())), np.nan)
    for joint in np.flatnonzero(model.jnt_type != 0):
        count, first = _DOFS.get(int(model.jnt_type[joint]), 1), int(places.at_qd[joint])
        found[joint, :count] = values[first : first + count]
    return found


def _lost(name: str) -> dict[str, str]:
    # kinds and parameters that these solvers have nothing for
    why = f"solver {name} has no {{}}"
    return {
        "tendons": why.format("tendons"),
        "equalities": why.format("constraints of equality"),
        "geoms": "not read of solvers with contacts of their own",
        "pairs": "not read of solvers with contacts of their own",
        "excludes": "not read of solvers with contacts of their own",
        "actuators": "not read; the recorder applies their forces",
        **{f"joints/limit_{word}": why.format("such parameters of limits") for word in ("solref", "solimp")},
        "bodies/gravity_compensation": why.format("compensation of gravity"),
        "joints/force_range": why.format("limits of the drives of joints"),
        **{f"model/{word}": why.format("forces of a medium") for word in ("wind", "density", "viscosity")},
    }


def _meant(rows: NDArray[np.float64], reference: Values | None) -> NDArray[np.float64]:
    # no number where the reference has none, such as an axis of a ball joint
    if reference is None or reference.dtype.kind == "U" or reference.shape != rows.shape:
        return rows
    return np.where(np.isnan(reference.astype(np.float64)), np.nan, rows)


def _number(bodies: NDArray[np.int64], body: int) -> int:
    found = np.flatnonzero(bodies == body)
    return int(found[0]) if len(found) else -1


def _listed(names: Sequence[str], number: int, otherwise: str) -> str:
    return names[number] if 0 <= number < len(names) else otherwise


def _geom(made: Any, geom: int, at: NDArray[np.int64], model: Any, names: Sequence[str]) -> str:
    # SolverMuJoCo calls a geom by its label in Newton, a path that ends with its name or number in its body
    body = int(at[made.geom_bodyid[geom]])
    own = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    collide = [g for g in own if collides(model, g)]
    if int((made.geom_bodyid == made.geom_bodyid[geom]).sum()) == len(collide):
        own = collide  # SolverMuJoCo has no others
    last = re.sub(r"_\d+$", "", str(made.geom(geom).name).rpartition("/")[2])
    named = [g for g in own if model.geom(g).name == last]
    numbered = re.search(r"_geom_(\d+)$", last)
    if not named and numbered and int(numbered[1]) < len(own):
        named = [own[int(numbered[1])]]
    return names[named[0]] if named else f"{last} of Newton's"


def _constraint(found: Imported, number: int, reference: Imported) -> str:
    # a constraint of equality has no name in Newton: it is that of the same objects
    keys = ("equalities/type", "equalities/objects")
    own = [str(found.values[key][number, 0]) for key in keys]
    for index, name in enumerate(reference.names["equalities"]):
        if [str(reference.values[key][index, 0]) for key in keys] == own:
            return name
    return found.names["equalities"][number]


def _actuators(made: Any, names: Sequence[str]) -> list[str]:
    # they have no names in Newton: their order is MuJoCo's, as far as their number is
    numbers = range(len(made.actuator_trntype))
    return [_listed(names, number, f"actuator{number} of Newton's") for number in numbers]


def link_poses(
    poses: NDArray[np.float32], places: Places, model: Any, names: Mapping[str, Sequence[str]]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Poses [env, body, 7], xyzw, of Newton's bodies as positions and orientations wxyz of those that are named."""
    reference = of_mujoco.of_c(model).names["bodies"]
    own = [int(places.bodies[reference.index(name)]) if name in reference else -1 for name in names["bodies"]]
    still = np.zeros((len(poses), 1, 7), dtype=poses.dtype)
    still[..., 6] = 1
    whole = np.concatenate([poses, still], axis=1)[:, own]  # -1: the world
    return whole[..., :3], whole[..., [6, 3, 4, 5]]
