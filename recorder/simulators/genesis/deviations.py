"""What Genesis' rigid solver does with the contact parameters of a scene, and has otherwise than MuJoCo compiles a
model file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import (
    LARGER,
    combination,
    materials_and_robot,
    springs,
    unlimited_speed,
)
from gpusimbench.recorder.scenes.model import ModelScene, choices, solver_options
from gpusimbench.recorder.simulators.genesis.held_parameters import UNREAD, touching
from gpusimbench.recorder.simulators.genesis.imported import ModelEnvironments
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco import imported as of_mujoco
from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.newton.mujoco_terms import colliding_bodies, different
from gpusimbench.schemas.imported import PARAMETERS, Imported
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few


def deviations(scene: Scene, options: GenesisOptions) -> tuple[Deviation, ...]:
    """The parameters that Genesis honours otherwise than the scene gives them, or not at all."""
    if isinstance(scene, ModelScene):
        return ()  # its contacts are compared with MuJoCo's, whose rule for a pair is the same
    found = [combination("friction", LARGER, "Genesis' rule for a pair of geoms")]
    found += springs(
        materials_and_robot(scene),
        "Genesis has one friction coefficient a geom; the kinetic one is used",
        "0 (critically damped contacts)",
        "Genesis' rigid contacts have no coefficient of restitution: they are damped springs of the time constant "
        "constraint_timeconst",
    )
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "Genesis' joints have no velocity limit"))
        if options.integrator != "Euler":
            found.append(
                Deviation(
                    "joint.max_torque",
                    " ".join(str(joint.max_torque) for joint in scene.robot.joints()),
                    "the same, less the servo's damping",
                    "Genesis' implicit integrators count a servo's damping as part of the inertia, also while its "
                    "torque is at the limit: such a joint accelerates less (--option integrator=Euler does not)",
                )
            )
    return tuple(found)


_READ = "so Genesis holds it"
_SHOWN = 4  # names of a deviation
_LEAST_FRICTION = 0.01  # of a contact (genesis 1.4.5, collider/contact.py)
_OFF = (
    "CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "SPRING", "DAMPER", "PASSIVE", "CLAMPCTRL",
    "ACTUATION",
)  # fmt: skip
"""Of what MuJoCo's flags switch off, what Genesis does all the same."""


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
            if len(rows) and parameter.key not in UNREAD:
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
    wanted, used = colliding_bodies(model, np.arange(model.nbody)), touching(environments)
    for pairs, word, other in (
        (wanted - used, "collide", "do not collide"), (used - wanted, "do not collide", "collide"),
    ):  # fmt: skip
        if pairs:
            listed = [f"{labels[a]} and {labels[b]}" for a, b in sorted(pairs)]
            yield Deviation("contact.pairs", f"{few(listed, _SHOWN)} {word}", other, "by Genesis' rules of pairs")
    shapes = [g for g in range(model.ngeom) if collides(model, g)]
    slippery = [model.geom(g).name or f"geom{g}" for g in shapes if model.geom_friction[g, 0] < _LEAST_FRICTION]
    if len(slippery) > 1:
        yield Deviation(
            "contact.friction", f"less than {_LEAST_FRICTION:g} between {few(slippery, _SHOWN)}",
            f"{_LEAST_FRICTION:g}", "Genesis' least friction of a contact",
        )  # fmt: skip
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
            shown = f"{used:g}" if isinstance(used, float) else str(used)
            yield Deviation(f"option.{name}", str(wanted), shown, reason)
    flags = int(model.opt.disableflags)
    off = [name.lower() for name in _OFF if flags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", 0))]
    if off:
        yield Deviation("option.disableflags", f"without {', '.join(off)}", "with it", "Genesis is given no such flag")
