"""What of a compiled model is recorded, controlled and begun with: its joints, actuators and keyframes, by name."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

from gpusimbench.recorder.scenes.actions import controls_from
from gpusimbench.schemas.action_generator import Controls, JointTargets
from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.treatment import FromFile

ACTIONS = "none, random, random:SPREAD (0 to 1, of each control range about its middle), keyframe or FILE.npz"
"""What actions may be."""

NO_KEYFRAME = "none"
"""A name that stands for the model's own reference state, qpos0."""

_UNLIMITED = -1.0, 1.0  # controls of actuators without a range


@dataclass(frozen=True)
class Moving:
    """Joints of one kind in a mujoco.MjModel, in its order.

    names   as recorded: of bodies where they are on free joints, else of the joints
    joints  numbers of the joints
    """

    names: tuple[str, ...]
    joints: tuple[int, ...]


def moving(model: Any, *kinds: Any) -> Moving:
    """Joints of these kinds (mujoco.mjtJoint); what has no name is called by its kind and number."""
    import mujoco

    numbers = tuple(int(j) for j in range(model.njnt) if model.jnt_type[j] in [int(kind) for kind in kinds])
    if kinds == (mujoco.mjtJoint.mjJNT_FREE,):
        bodies = [int(model.jnt_bodyid[j]) for j in numbers]
        return Moving(tuple(model.body(body).name or f"body{body}" for body in bodies), numbers)
    return Moving(tuple(model.joint(j).name or f"joint{j}" for j in numbers), numbers)


def choices() -> dict[str, dict[str, int]]:
    """The words that MJCF has for options of the solver, and MuJoCo's number of each."""
    from mujoco import mjtCone, mjtIntegrator, mjtSolver

    kinds = {
        "integrator": {
            "Euler": mjtIntegrator.mjINT_EULER,
            "RK4": mjtIntegrator.mjINT_RK4,
            "implicit": mjtIntegrator.mjINT_IMPLICIT,
            "implicitfast": mjtIntegrator.mjINT_IMPLICITFAST,
        },
        "cone": {"elliptic": mjtCone.mjCONE_ELLIPTIC, "pyramidal": mjtCone.mjCONE_PYRAMIDAL},
        "solver": {"Newton": mjtSolver.mjSOL_NEWTON, "CG": mjtSolver.mjSOL_CG, "PGS": mjtSolver.mjSOL_PGS},
    }
    return {name: {word: int(kind) for word, kind in words.items()} for name, words in kinds.items()}


def solver_options(model: Any) -> dict[str, str]:
    """What a mujoco.MjModel says of its solver, as options of simulators have it. UsageError for an integrator, cone or
    solver that this version does not know."""
    found = {name: repr(getattr(model.opt, name)) for name in ("iterations", "ls_iterations", "tolerance", "impratio")}
    for name, words in choices().items():
        word = next((word for word, number in words.items() if number == getattr(model.opt, name)), None)
        if word is None:
            raise UsageError(f"the model's {name} has MuJoCo's number {getattr(model.opt, name)}, which is not known")
        found[name] = word
    return found


def keyframe_of(model: Any, name: str) -> tuple[str, Any]:
    """Name and view of a keyframe of a mujoco.MjModel; None for the reference state.

    name  empty: the first, if there is one. A keyframe without a name is called by its number

    UsageError where there is none of that name, or where it holds what no engine here is given: activations of
    actuators, or poses of mocap bodies other than the model's.
    """
    names = [model.key(index).name or str(index) for index in range(model.nkey)]
    chosen = name or (names[0] if names else NO_KEYFRAME)
    if chosen == NO_KEYFRAME:
        return NO_KEYFRAME, None
    if chosen not in names:
        has = ", ".join([*names, NO_KEYFRAME])
        raise UsageError(f"the model has no keyframe '{chosen}'; it has {has}{did_you_mean(chosen, names)}")
    index = names.index(chosen)
    if model.key_act[index].any():
        raise UsageError(f"keyframe '{chosen}' sets activations of actuators, which is not supported: --keyframe none")
    mocap = [body for body in range(model.nbody) if model.body_mocapid[body] >= 0]
    poses = zip(mocap, model.key_mpos[index].reshape(-1, 3), model.key_mquat[index].reshape(-1, 4), strict=True)
    if any((model.body_pos[b] != p).any() or (model.body_quat[b] != q).any() for b, p, q in poses):
        raise UsageError(f"keyframe '{chosen}' moves mocap bodies, which is not supported: --keyframe none")
    return chosen, model.key(index)


def controls_of(model: Any, actions: str, keyframe: Any, file: bytes | None) -> tuple[str, JointTargets | None]:
    """What the actuators of a mujoco.MjModel are given at each step, and its short text; None where it is nothing.

    actions   as of ACTIONS; empty: random, if the model has actuators
    keyframe  a view of a keyframe, or None
    file      what `controls_file.packed` made of the file, where actions are from one

    Random controls are uniform within the control range of each actuator, or within +-1 where it has none. UsageError
    where that cannot be.
    """
    names = tuple(model.actuator(index).name or f"actuator{index}" for index in range(model.nu))
    asked = actions or ("random" if names else "none")
    if asked == "none":
        return asked, None
    if not names:
        raise UsageError(f"--actions {asked}: the model has no actuators")
    if asked_of_file := FromFile.parse(asked):
        if file is None or hashlib.sha256(file).hexdigest() != asked_of_file.sha256:
            raise UsageError("the file of actions is not there, or is not the one that the configuration names")
        return asked, controls_from(file, model, names)
    if asked == "keyframe":
        if keyframe is None:
            raise UsageError("--actions keyframe holds the controls of a keyframe, and environments begin in none")
        return asked, _within(dict(zip(names, ((value, value) for value in keyframe.ctrl), strict=True)))
    kind, _, spread = asked.partition(":")
    try:
        share = float(spread) if spread else 1.0
        if kind != "random" or not 0 < share <= 1:
            raise ValueError(asked)
    except ValueError:
        raise UsageError(f"--actions is {ACTIONS}, not '{asked}'") from None
    ranges = {}
    for index, name in enumerate(names):
        low, high = model.actuator_ctrlrange[index] if model.actuator_ctrllimited[index] else _UNLIMITED
        middle, half = (low + high) / 2, (high - low) / 2
        ranges[name] = (middle - share * half, middle + share * half) if share < 1 else (low, high)
    return f"random:{share!r}", _within(ranges)


def _within(ranges: dict[str, tuple[float, float]]) -> Controls:
    try:
        return Controls.within("controls", ranges)
    except ValueError as error:
        raise UsageError(f"an actuator cannot be given controls: {error}") from None
