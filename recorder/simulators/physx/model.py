"""A model file on its way into PhysX: compiled by MuJoCo, planned, written as USD, and what is lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.scenes.emit.usd_prim import Apis
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.recorder.simulators.mujoco.model import compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options
from gpusimbench.recorder.simulators.physx.articulations import Articulations
from gpusimbench.recorder.simulators.physx.held_parameters import (
    HeldParameters,
    Source,
    deviations_of_model,
    held_parameters,
    imported_of,
)
from gpusimbench.recorder.simulators.physx.options import PhysxOptions
from gpusimbench.recorder.simulators.physx.plan import plan
from gpusimbench.recorder.simulators.physx.servos import Driven
from gpusimbench.recorder.simulators.physx.session import Session
from gpusimbench.recorder.simulators.physx.stage import emit_model, vector
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation


class Model:
    """A model file as PhysX is given it.

    compiled  by MuJoCo
    plan      which links and joints it becomes
    driven    what its controls do to them
    springs   whether springs and damping of joints are part of their drives
    """

    springs = True

    def __init__(self, scene: ModelScene, *, dt: float) -> None:
        """Refused as of trees.plan and servos.Driven."""
        self.compiled = compile_scene(scene, dt=dt, options=own_options(scene))
        self.plan = plan(self.compiled.model, scene.file)
        self._file = scene.file
        self.driven = Driven(self.compiled.model, "PhysX", "other engines take such models", springs=self.springs)

    @property
    def gravity(self) -> Vector:
        """The gravity that acts [m/s^2]: none where the model's flags switch it off."""
        options = self.compiled.model.opt
        off = int(options.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        return (0.0, 0.0, 0.0) if off else vector(options.gravity)

    def usd(self, apis: Apis, *, spacing: float, isaac_lab: bool = False) -> str:
        """One environment; apis, spacing and isaac_lab as of stage.emit_model."""
        return emit_model(
            self.plan, self.driven.servos, gravity=self.gravity, apis=apis, spacing=spacing, isaac_lab=isaac_lab
        )

    def articulations(self, session: Session, *, n_env: int, origins: Sequence[Vector], device: Any) -> Articulations:
        """All environments, once they are in the session."""
        found = Articulations(
            session, self.plan, self.compiled, self.driven, n_env=n_env, origins=origins, device=device
        )
        self.attach(found)
        return found

    def attach(self, source: Source) -> None:
        """Ask this from now on what the engine holds."""
        self._source = source

    def deviations(self, options: PhysxOptions, *, gpu: bool) -> list[Deviation]:
        """What PhysX has otherwise, once it has all environments."""
        return deviations_of_model(self.plan, self._held(), options, file=self._file, gpu=gpu)

    def imported(self, dt: float) -> Imported:
        """What PhysX holds, once it has all environments."""
        return imported_of(self.plan, self._held(), dt=dt)

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions and orientations wxyz of what `imported` calls bodies, [env, body, ...]; an added link is where
        its body is."""
        poses = self._source.link_poses()
        bodies = of_c(self.compiled.model).names["bodies"]
        frames = {link.prim: link.frame for tree in self.plan.trees for link in tree.links if link.body < 0}
        extra = [frames[name] for name in self._added()]
        poses = np.concatenate([poses[:, : len(bodies)], poses[:, extra]], axis=1)
        return poses[..., :3], poses[..., 3:]

    def _added(self) -> Sequence[str]:
        return list(self._held().added)

    def _held(self) -> HeldParameters:
        return held_parameters(self.plan, self.driven.servos, self._source)
