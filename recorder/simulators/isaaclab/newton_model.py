"""A model file under Isaac Lab's Newton: what it is given, and what MuJoCo Warp, its solver, holds of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.emit.usd_prim import Apis, literal
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.newton.imported import Imported as Places
from gpusimbench.recorder.simulators.newton.mujoco_terms import (
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
from gpusimbench.recorder.simulators.physx.held_parameters import HeldParameters, imported_of
from gpusimbench.recorder.simulators.physx.model import Model
from gpusimbench.recorder.simulators.physx.options import PhysxOptions
from gpusimbench.recorder.simulators.physx.plan import ADDED_SHARE, Link
from gpusimbench.recorder.simulators.physx.stage import emit_model
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few

_NAMED = 4  # in a deviation
_REASON = "so Isaac Lab, Newton's importer and SolverMuJoCo make it"
_COMPARED = "not read by name; what differs is among the deviations of a recording, and the kinematics compare frames"

_LAST = {int(mujoco.mjtJoint.mjJNT_FREE): 5, int(mujoco.mjtJoint.mjJNT_BALL): 2}
"""Of degrees of freedom of a joint, the last; 0 of others."""

_LIMITS = {"solref": "joints.limit_solref", "solimp": "joints.limit_solimp", "margin": "joints.margin"}


class MuJoCoWords:
    """The attributes (mjc:) of the joints, geoms and bodies of a mujoco.MjModel."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def joint(self, joint: int) -> list[str]:
        """Of a hinge or slide."""
        model, dof, at = self._model, int(self._model.jnt_dofadr[joint]), int(self._model.jnt_qposadr[joint])
        numbers = {
            "armature": model.dof_armature[dof], "damping": model.dof_damping[dof],
            "frictionloss": model.dof_frictionloss[dof], "stiffness": model.jnt_stiffness[joint],
            "springref": model.qpos_spring[at] - model.qpos0[at], "margin": model.jnt_margin[joint],
        }  # fmt: skip
        return [
            *_numbers(numbers),
            _array("solreflimit", model.jnt_solref[joint]),
            _array("solimplimit", model.jnt_solimp[joint]),
            _array("solreffriction", model.dof_solref[dof]),
            _array("solimpfriction", model.dof_solimp[dof]),
        ]

    def geom(self, geom: int) -> list[str]:
        """Of a shape that collides."""
        model = self._model
        words = ("condim", "priority", "contype", "conaffinity")
        return [
            *(f"int mjc:{word} = {int(getattr(model, f'geom_{word}')[geom])}" for word in words),
            *_numbers({word: getattr(model, f"geom_{word}")[geom] for word in ("solmix", "margin", "gap")}),
            _array("solref", model.geom_solref[geom]),
            _array("solimp", model.geom_solimp[geom]),
        ]

    def body(self, body: int) -> list[str]:
        """Of a link."""
        return _numbers({"gravcomp": self._model.body_gravcomp[body]})

    def friction(self, coefficients: Sequence[float]) -> list[str]:
        """Of a material: the torsional and the rolling one [m], after that against sliding."""
        _, torsional, rolling = coefficients
        return _numbers({"torsionalfriction": torsional, "rollingfriction": rolling})


def _numbers(numbers: dict[str, Any]) -> list[str]:
    return [f"double mjc:{name} = {literal(float(number))}" for name, number in numbers.items()]


def _array(name: str, numbers: Iterable[Any]) -> str:
    return f"double[] mjc:{name} = [{', '.join(literal(float(number)) for number in numbers)}]"


class NewtonModel(Model):
    """A model file as Isaac Lab's Newton is given it: the links and joints of PhysX's stage, with MuJoCo's own
    attributes."""

    springs = False  # MuJoCo's own attributes are for them

    def __init__(self, scene: ModelScene, *, dt: float) -> None:
        """Refused as of Model."""
        try:
            super().__init__(scene, dt=dt)
        except Refused as error:
            raise Refused(f"Isaac Lab's Newton is given the links and joints that PhysX is given: {error}") from None

    def usd(self, apis: Apis, *, spacing: float, isaac_lab: bool = False) -> str:
        """See Model.usd."""
        return emit_model(
            self.plan, self.driven.servos, gravity=self.gravity, apis=apis, spacing=spacing, isaac_lab=isaac_lab,
            words=MuJoCoWords(self.compiled.model),
        )  # fmt: skip

    def read(self, manager: Any) -> None:
        """Find the first environment in what Isaac Lab's manager of Newton has made."""
        self._solver = manager._solver  # Isaac Lab shows the solver nowhere else
        self._places = self._found(manager.backend.model)

    def _found(self, made: Any) -> Places:
        model, plan = self.compiled.model, self.plan
        first = {path: number for number, path in enumerate(made.body_label) if "/env_0/" in path}
        of_joints = {path: number for number, path in enumerate(made.joint_label) if "/env_0/" in path}
        children, q, qd = (getattr(made, f"joint_{word}").numpy() for word in ("child", "q_start", "qd_start"))
        bodies = np.full(model.nbody, -1, dtype=np.int64)
        joints, at_q, at_qd = (np.full(model.njnt, -1, dtype=np.int64) for _ in range(3))
        for tree in plan.trees:
            for link in tree.links:
                if link.body >= 0:
                    bodies[link.body] = _ends_with(first, f"/{tree.prim}/{link.prim}")
            own = {joint: f"/{plan.joint_prims[joint]}" for joint in tree.joints()}
            for joint, name in own.items():
                joints[joint] = _ends_with({p: n for p, n in of_joints.items() if f"/{tree.prim}/" in p}, name)
            if tree.free >= 0:
                (joints[tree.free],) = np.flatnonzero(children == bodies[tree.links[0].body])
        at_q[:], at_qd[:] = q[joints], qd[joints]
        return Places(None, bodies, joints, at_q, at_qd, self.compiled.layout)  # type: ignore[arg-type]

    def _added(self) -> Sequence[str]:
        return [link.prim for link in self._added_links()]

    def _added_links(self) -> list[Link]:
        return [link for tree in self.plan.trees for link in tree.links if link.body < 0 and link.parent >= 0]

    def deviations(self, options: PhysxOptions, *, gpu: bool) -> list[Deviation]:
        """What the solver has otherwise than MuJoCo compiles the file, read from it."""
        return [*deviations_of_solver(self._solver, self._places, self.compiled.model, _REASON), *self._of_links()]

    def _of_links(self) -> Iterator[Deviation]:
        model = self.compiled.model
        if added := self._added_links():
            several = [model.body(b).name or f"body{b}" for b in np.flatnonzero(model.body_jntnum > 1)]
            yield Deviation(
                "bodies.added", f"the bodies of {self._file}", f"{len(added)} more",
                f"a link of a USD articulation has one joint, so that between the joints of {few(several, _NAMED)} are "
                f"links with a share of {ADDED_SHARE:g} of the body's mass",
            )  # fmt: skip
        if model.nu:
            yield Deviation(
                "actuators", "MuJoCo's", "targets and gains of Isaac Lab's implicit actuators, and forces",
                "the recorder makes them of the controls; their sum for a joint is the same",
            )  # fmt: skip

    def imported(self, dt: float) -> Imported:
        """What the solver holds."""
        made = self._solver.mj_model
        quantities = quantities_of_solver(self._solver, self._places, self.compiled.model)
        masses = {}
        for link in self._added_links():
            (number,) = [b for b in range(made.nbody) if made.body(b).name.endswith(link.prim)]
            masses[link.prim] = float(made.body_mass[number])
        found = imported_of(self.plan, HeldParameters(quantities, masses), dt=dt)
        unread = {key: why for key, why in found.unread.items() if key not in found.values}
        return replace(found, unread={key: _COMPARED if "PhysX" in why else why for key, why in unread.items()})


def _ends_with(places: dict[str, int], end: str) -> int:
    found = [number for path, number in places.items() if path.endswith(end)]
    if len(found) != 1:
        raise GsbError(f"Newton has {len(found)} of what the stage calls {end}")
    return found[0]


def quantities_of_solver(solver: Any, imported: Places, model: Any) -> Quantities:
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


def deviations_of_solver(solver: Any, imported: Places, model: Any, reason: str) -> list[Deviation]:
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


def _numbers_of_joints(solver: Any, imported: Places, model: Any) -> list[int]:
    """By number of the model's joints, SolverMuJoCo's, which it knows by the last of their degrees of freedom."""
    dofs = solver.mjc_jnt_to_newton_dof.numpy()[0][: solver.mj_model.njnt]
    last = [_LAST.get(int(kind), 0) for kind in model.jnt_type]
    return [int(np.flatnonzero(dofs == start + more)[0]) for start, more in zip(imported.at_qd, last, strict=True)]
