"""A user's own model file as a scene: what every engine must agree on, by the model's own names.

The description holds names and limits as MuJoCo compiles them, and the SHA-256 of the model's files; engines read
everything else from the files. State is laid out in MuJoCo's order of bodies and joints:

    bodies   every body on a free joint, such as the base of a walking robot
    joints   every hinge and slide
    balls    every ball joint
"""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model.contents import NO_KEYFRAME, controls_of, keyframe_of, moving, solver_options
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.model_files import unpack

BODIES, JOINTS, BALLS = "bodies", "joints", "balls"
"""Groups of the state."""

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
    controls       what the actuators are given, as of contents.ACTIONS
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

    with tempfile.TemporaryDirectory(prefix="gsb-model-") as folder:
        main = unpack(archive, Path(folder))
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
            said = " ".join(str(error).replace(folder, "").split())
            raise UsageError(f"MuJoCo {mujoco.__version__} does not compile {main.name}: {said}") from None
        finally:
            mujoco.set_mju_user_warning(None)


def model_scene(
    name: str, archive: bytes, *, keyframe: str = "", actions: str = "", file: bytes | None = None
) -> ModelScene:
    """The scene of a model's files.

    name      that it is recorded under
    keyframe  as of contents.keyframe_of
    actions   as of contents.controls_of
    file      of actions, as of contents.controls_of

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
        raise UsageError(f"{own} has no joint, so that nothing in it moves")
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
