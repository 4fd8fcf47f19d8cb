"""A scene compiled by MuJoCo, for every engine that takes its model from there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.mjcf import deviations, emit_mjcf
from gpusimbench.recorder.scenes.model import (
    BALLS,
    BODIES,
    JOINTS,
    ModelScene,
    choices,
    compiled,
    keyframe_of,
    moving,
)
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.mujoco.geometry import geometry_of
from gpusimbench.recorder.simulators.mujoco.layout import Balls, FreeBodies, Joints, StateGroup, rotate_to_body
from gpusimbench.recorder.simulators.mujoco.options import GEOM_ATTRIBUTES, OPTION_ATTRIBUTES, MjcfOptions
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.view.geometry import GEOMETRY, MEDIA_TYPE

SCENE_FILE = "scene.xml"
"""A registered scene as MJCF, by the name that it has in a recording."""

KNOWS_AUTORESET = hasattr(mujoco.mjtDisableBit, "mjDSBL_AUTORESET")
"""Whether this release can be told not to reset a state that went bad; older ones always do, with a warning."""

_QVEL = 6  # of a free joint: linear velocity in the world frame 3, angular velocity in the body's frame 3


@dataclass(frozen=True)
class MjcfModel:
    """One environment as MuJoCo compiles it, and where its numbers are.

    scene   that it was made from
    xml     MJCF
    model   mujoco.MjModel
    qpos0   initial positions, shape [nq]
    qvel0   initial velocities, shape [nv]
    layout  where the numbers of the recorded fields are, in their order
    """

    scene: Scene
    xml: str
    model: Any
    qpos0: NDArray[np.float64]
    qvel0: NDArray[np.float64]
    layout: tuple[StateGroup, ...]

    @property
    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """The model as a recording carries it; files of the user's own are attached as they are, and what viewers draw
        of them beside these."""
        if isinstance(self.scene, ModelScene):
            return {GEOMETRY: (MEDIA_TYPE, geometry_of(self.model))}
        return {SCENE_FILE: ("application/xml", self.xml.encode())}

    @property
    def deviations(self) -> tuple[Deviation, ...]:
        """What MuJoCo does otherwise than the scene says; nothing, where the scene is MuJoCo's own language."""
        return () if isinstance(self.scene, ModelScene) else deviations(self.scene)

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """Layout of the state."""
        return tuple(field for part in self.layout for field in part.fields(dtype))

    @property
    def coordinates(self) -> NDArray[np.int64]:
        """Places in qpos of x, y and z of the bodies in `fields`."""
        return np.concatenate([np.empty(0, dtype=np.int64), *(part.coordinates() for part in self.layout)])

    def split(self, qpos: NDArray[np.floating], qvel: NDArray[np.floating]) -> States:
        """qpos [..., nq] and qvel [..., nv] as the arrays of `fields`, in their own precision; views where possible."""
        return tuple(array for part in self.layout for array in part.split(qpos, qvel))

    def joined(self, states: States) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The arrays of `fields`, [env, item, width], as qpos [env, nq] and qvel [env, nv]: the inverse of `split`, but
        for the rounding of angular velocities, which are rotated."""
        n_env = len(states[0])
        qpos, qvel = np.tile(self.qpos0, (n_env, 1)), np.tile(self.qvel0, (n_env, 1))
        left = iter(np.asarray(array, dtype=np.float64) for array in states)
        for part in self.layout:
            part.join(left, qpos, qvel)
        return qpos, qvel

    def data(self) -> Any:
        """A mujoco.MjData in the initial state, with everything computed from it."""
        data = mujoco.MjData(self.model)
        data.qpos[:], data.qvel[:] = self.qpos0, self.qvel0
        mujoco.mj_forward(self.model, data)
        return data

    def rollout(self, *, n_step: int, seed: int = 0, n_env: int = 1) -> Iterator[Any]:
        """The mujoco.MjData of each environment after each of n_step steps on MuJoCo C; the same object again and
        again. Environments differ in their actions alone."""
        actions = self.scene.actions
        drawn = None if actions is None else actions.draw(seed, n_env=n_env, first_step=0, n_step=n_step)
        for env in range(n_env if drawn is not None else 1):
            data = self.data()
            yield data
            for step in range(n_step):
                if drawn is not None:
                    data.ctrl[:] = drawn[step, env]
                mujoco.mj_step(self.model, data)
                yield data

    def in_force(self, asked: MjcfOptions, simulator: str) -> dict[str, Any]:
        """The options that the compiled model has; UsageError where one is not the one that was asked for."""
        model = self.model
        found: dict[str, Any] = {
            name: next(word for word, number in words.items() if number == getattr(model.opt, name))
            for name, words in choices().items()
        }
        for name in ("iterations", "ls_iterations", "tolerance", "impratio"):
            found[name] = getattr(model.opt, name)
        if not isinstance(self.scene, ModelScene):  # every geom has the defaults
            found["solref"] = _text(model.geom_solref[0])
            found["solimp"] = _text(model.geom_solimp[0])
            found["condim"] = int(model.geom_condim[0])
        for name, value in found.items():
            wanted = getattr(asked, name)
            if name in ("solref", "solimp"):
                wanted = _text([float(word) for word in wanted.split()])
            if value != wanted:
                raise UsageError(f"option '{name}' of simulator '{simulator}': asked for {wanted}, MuJoCo has {value}")
        return found


def collides(model: Any, geom: int) -> bool:
    """Whether MuJoCo lets a geom touch anything by its masks."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def compile_scene(
    scene: Scene, *, dt: float, options: MjcfOptions, numerics: dict[str, str] | None = None
) -> MjcfModel:
    """Compile a scene with these options.

    numerics  custom numbers that engines read from the model, such as MJX's max_geom_pairs
    """
    if isinstance(scene, ModelScene):
        return _compile_files(scene, dt=dt, options=options, numerics=numerics or {})
    xml = emit_mjcf(
        scene,
        dt=dt,
        option={name: str(getattr(options, name)) for name in OPTION_ATTRIBUTES},
        geom={name: str(getattr(options, name)) for name in GEOM_ATTRIBUTES},
        numerics=numerics,
        autoreset=KNOWS_AUTORESET,
    )
    model = mujoco.MjModel.from_xml_string(xml)
    qpos0, qvel0 = model.qpos0.copy(), np.zeros(model.nv)
    for body in scene.moving():
        start = model.joint(body.name).dofadr[0]
        qvel0[start : start + 3] = body.linear_velocity
        qvel0[start + 3 : start + _QVEL] = rotate_to_body(np.array(body.orientation), np.array(body.angular_velocity))
    layout: list[StateGroup] = [
        FreeBodies.of(model, group, names, [model.joint(name).id for name in names])
        for group, names in scene.groups().items()
    ]
    if scene.robot is not None:
        names = tuple(joint.name for joint in scene.robot.joints())
        robot = Joints.of(model, "robot", names, [model.joint(name).id for name in names])
        layout.append(robot)
        qpos0[robot.at_qpos[:, 0]] = scene.robot.start
        qvel0[robot.at_qvel[:, 0]] = scene.robot.speeds()
    return MjcfModel(scene, xml, model, qpos0, qvel0, tuple(layout))


def _compile_files(scene: ModelScene, *, dt: float, options: MjcfOptions, numerics: dict[str, str]) -> MjcfModel:
    _, model = compiled(scene.archive, numerics)
    model.opt.timestep = dt
    numbers = choices()
    for name in OPTION_ATTRIBUTES:
        value = getattr(options, name)
        setattr(model.opt, name, numbers[name][value] if name in numbers else value)
    if KNOWS_AUTORESET:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    _, key = keyframe_of(model, scene.keyframe)
    qpos0, qvel0 = (model.qpos0, np.zeros(model.nv)) if key is None else (key.qpos, key.qvel)
    kinds = mujoco.mjtJoint
    slides = frozenset(joint.name for joint in scene.joints if joint.slides)
    free, balls = moving(model, kinds.mjJNT_FREE), moving(model, kinds.mjJNT_BALL)
    single = moving(model, kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE)
    parts: list[StateGroup] = [
        FreeBodies.of(model, BODIES, free.names, free.joints),
        Joints.of(model, JOINTS, single.names, single.joints, slides=slides),
        Balls.of(model, BALLS, balls.names, balls.joints),
    ]
    layout = tuple(part for part in parts if part.names)
    return MjcfModel(scene, "", model, qpos0.copy(), qvel0.copy(), layout)


def raised_tolerance(given: float, held: float) -> tuple[Deviation, ...]:
    """What MuJoCo Warp's put_model does with the tolerance of a model: it computes in single precision, and takes 1e-6
    where the model has less."""
    if np.float32(given) == np.float32(held):
        return ()
    reason = "MuJoCo Warp takes no smaller tolerance, because it computes in single precision"
    return (Deviation("option.tolerance", f"{given:g}", f"{held:g}", reason),)


def _text(values: Iterable[float]) -> str:
    return " ".join(np.format_float_positional(value, trim="-") for value in values)


def compile_varied(
    scene: Scene,
    variation: Variation | None,
    *,
    n_env: int,
    dt: float,
    options: MjcfOptions,
    numerics: dict[str, str] | None = None,
) -> list[Any]:
    """A mujoco.MjModel for each environment, none where no parameter varies; arguments as of compile_scene.

    So MuJoCo's own compiler derives for every engine what depends on masses and sizes, such as the inverse weights of
    constraints.
    """
    if variation is None:
        return []
    scenes = (variation.of(scene, env) for env in range(n_env))
    return [compile_scene(one, dt=dt, options=options, numerics=numerics).model for one in scenes]


def varied_fields(model: Any, models: Sequence[Any]) -> dict[str, NDArray[Any]]:
    """The fields of MjModel in which any of some models differs from a model of the same structure: [env, ...]."""
    names = [name for name in dir(model) if not name.startswith("_") and isinstance(getattr(model, name), np.ndarray)]
    return {
        name: np.stack([getattr(other, name) for other in models])
        for name in names
        if any(not np.array_equal(getattr(model, name), getattr(other, name)) for other in models)
    }
