"""A user's own model file as a scene: what every engine must agree on, by the model's own names.

The description holds names and limits as MuJoCo compiles them, and the SHA-256 of the model's files; engines read
everything else from the files. State is laid out in MuJoCo's order of bodies and joints:

    bodies   every body on a free joint, such as the base of a walking robot
    joints   every hinge and slide
    balls    every ball joint
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.scenes.actions import controls_from
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas.action_generator import Controls, JointTargets
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.model_files import unpack
from gpusimbench.schemas.scratch import empty_folder
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.treatment import FromFile

BODIES, JOINTS, BALLS = "bodies", "joints", "balls"
"""Groups of the state."""

ACTIONS = "none, random, random:SPREAD (0 to 1, of each control range about its middle), keyframe or FILE.npz"
"""What actions may be."""

NO_KEYFRAME = "none"
"""A name that stands for the model's own reference state, qpos0."""

_UNLIMITED = -1.0, 1.0  # controls of actuators without a range

_FINITE = (
    "qpos0", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "geom_pos", "geom_quat",
    "geom_size", "jnt_pos", "jnt_axis",
)  # fmt: skip
"""Arrays of a compiled model that every file of it is made of: MuJoCo takes NaN in a model's file, and warns of it."""

_OF_GEOMS = ("solref", "solimp", "condim")  # options of MuJoCo's physics that a model has for each geom


@dataclass(frozen=True)
class ModelJoint:
    """A hinge or a slide.

    slides        whether it is a slide
    lower, upper  limits [rad or m]; None where it has none
    """

    name: str
    slides: bool
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class ModelScene(Scene):
    """A model file as a scene.

    file           name of the model's own file
    files_sha256   of the archive [hex]
    keyframe       that environments begin in; "none": the reference state
    controls       what the actuators are given, as of ACTIONS
    free_bodies    bodies on free joints, in order
    joints         hinges and slides, in order
    balls          ball joints, in order
    archive        the files (schemas.model_files); the description leaves them out
    solver         options of the solver, as the model has them; the description leaves them out
    """

    file: str = ""
    files_sha256: str = ""
    keyframe: str = NO_KEYFRAME
    controls: str = "none"
    free_bodies: tuple[str, ...] = ()
    joints: tuple[ModelJoint, ...] = ()
    balls: tuple[str, ...] = ()
    archive: bytes = field(default=b"", repr=False, metadata={"described": False})
    solver: Mapping[str, str] = field(default_factory=dict, repr=False, metadata={"described": False})

    def options(self, given: Mapping[str, str], known: Collection[str]) -> dict[str, str]:
        """See Scene.options: where the user says nothing, the solver is as the model says."""
        if own := [name for name in _OF_GEOMS if name in given]:
            raise UsageError(f"option '{own[0]}' is for registered scenes; the geoms of {self.file} have their own")
        return {**{name: value for name, value in self.solver.items() if name in known}, **given}

    def groups(self) -> dict[str, tuple[str, ...]]:
        """See Scene.groups."""
        return {BODIES: self.free_bodies} if self.free_bodies else {}

    def needs(self) -> frozenset[Ability]:
        """See Scene.needs: the rest of what the model needs, the engine itself reads in the files."""
        return frozenset({Ability.MODELS})

    def joint_limits(self) -> dict[str, tuple[tuple[float, float], ...]]:
        """See Scene.joint_limits."""
        unlimited = float("-inf"), float("inf")
        limits = [(j.lower, j.upper) if j.lower is not None and j.upper is not None else unlimited for j in self.joints]
        return {JOINTS: tuple(limits)}


def compiled(archive: bytes, numerics: Mapping[str, str] | None = None) -> tuple[str, Any]:
    """The name of a model's own file, and its files as a mujoco.MjModel.

    numerics  custom numbers by name, which stand before those of the model, and replace those of the same name: MJX
              takes the place of a name for the place of its value, and the two differ behind an array of numbers

    UsageError with MuJoCo's message where it does not compile them, DamagedRecording where the archive is none.
    """
    import mujoco

    with empty_folder() as folder:
        main = unpack(archive, folder)
        mujoco.set_mju_user_warning(lambda said: None)  # MuJoCo would write it to a file in the present folder
        try:
            if not numerics:
                return main.name, mujoco.MjModel.from_xml_path(str(main))
            spec = mujoco.MjSpec.from_file(str(main))
            own = [(one.name, list(one.data), one.size) for one in spec.numerics]
            for one in list(spec.numerics):
                spec.delete(one)
            for name, value in numerics.items():
                spec.add_numeric(name=name, data=[float(value)], size=1)
            for name, data, size in own:
                if name not in numerics:
                    spec.add_numeric(name=name, data=data, size=size)
            return main.name, spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            said = " ".join(str(error).replace(str(folder), "").split())
            raise UsageError(f"MuJoCo {mujoco.__version__} does not compile {main.name}: {said}") from None
        finally:
            mujoco.set_mju_user_warning(None)


def model_scene(
    name: str, archive: bytes, *, keyframe: str = "", actions: str = "", file: bytes | None = None
) -> ModelScene:
    """The scene of a model's files.

    name      that it is recorded under
    keyframe  as of keyframe_of
    actions   as of controls_of
    file      of actions, as of controls_of

    UsageError where MuJoCo is not there or does not compile the files, or where the model has no such keyframe or
    actions, nothing that moves, or names that a recording cannot hold.
    """
    try:
        from mujoco import mjtJoint
    except ImportError:
        raise UsageError("a model file is read by MuJoCo, which is not installed here: pip install mujoco") from None
    own, model = compiled(archive)
    if odd := [name for name in _FINITE if not np.isfinite(getattr(model, name)).all()]:
        raise UsageError(
            f"{own} has numbers that are not finite: MuJoCo compiles it with {', '.join(odd)} of NaN or inf"
        )
    if not model.njnt:
        raise UsageError(
            f"{own} has no joint, so that nothing in it moves: give a body a <freejoint/>, or a <joint/> to its parent"
        )
    chosen, key = keyframe_of(model, keyframe)
    controls, drawn = controls_of(model, actions, key, file)
    free, balls = moving(model, mjtJoint.mjJNT_FREE), moving(model, mjtJoint.mjJNT_BALL)
    single = moving(model, mjtJoint.mjJNT_HINGE, mjtJoint.mjJNT_SLIDE)
    _check(own, [*free.names], [*single.names, *balls.names], [*(drawn.joints if drawn else ())])
    return ModelScene(
        name=name,
        summary=f"the model file {own}",
        bodies=(),
        actions=drawn,
        gravity=(float(model.opt.gravity[0]), float(model.opt.gravity[1]), float(model.opt.gravity[2])),
        dt=float(model.opt.timestep),
        file=own,
        files_sha256=hashlib.sha256(archive).hexdigest(),
        keyframe=chosen,
        controls=controls,
        free_bodies=free.names,
        joints=tuple(
            ModelJoint(
                joint,
                bool(model.jnt_type[number] == mjtJoint.mjJNT_SLIDE),
                *(map(float, model.jnt_range[number]) if model.jnt_limited[number] else ()),
            )
            for joint, number in zip(single.names, single.joints, strict=True)
        ),
        balls=balls.names,
        archive=archive,
        solver=solver_options(model),
    )


def _check(file: str, *kinds: list[str]) -> None:
    for names in kinds:
        twice = [name for name, count in Counter(names).items() if count > 1]
        wrong = [name for name in names if "," in name or not name.isprintable()]
        if twice or wrong:
            said = f"two things of the name '{twice[0]}'" if twice else f"a name with a comma in it: {wrong[0]!r}"
            raise UsageError(f"{file} has {said}; a recording lists bodies, joints and actuators by name")


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
            **({"discrete": mjtIntegrator.mjINT_DISCRETE} if hasattr(mjtIntegrator, "mjINT_DISCRETE") else {}),
        },
        "cone": {"elliptic": mjtCone.mjCONE_ELLIPTIC, "pyramidal": mjtCone.mjCONE_PYRAMIDAL},
        "solver": {"Newton": mjtSolver.mjSOL_NEWTON, "CG": mjtSolver.mjSOL_CG, "PGS": mjtSolver.mjSOL_PGS},
    }
    return {name: {word: int(kind) for word, kind in words.items()} for name, words in kinds.items()}


def control_names(model: Any) -> tuple[str, ...]:
    """Names of the controls of a mujoco.MjModel, in its order: of their actuators, and of an actuator that has several
    controls, such as a servo of orientation, its name and their numbers: "wrist.0", "wrist.1", "wrist.2"."""
    actuators = len(model.actuator_trntype)
    counts = getattr(model, "actuator_ctrlnum", [1] * actuators)  # releases before 4.0 have one for each
    return tuple(
        f"{name}.{number}" if count > 1 else name
        for name, count in zip(actuator_names(model), counts, strict=True)
        for number in range(count)
    )


def actuator_names(model: Any) -> tuple[str, ...]:
    """Names of the actuators of a mujoco.MjModel, in its order."""
    return tuple(model.actuator(a).name or f"actuator{a}" for a in range(len(model.actuator_trntype)))


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
    file      what `scenes.actions.packed` made of the file, where actions are from one

    Random controls are uniform within the control range of each actuator, or within +-1 where it has none. UsageError
    where that cannot be.
    """
    names = control_names(model)
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
