"""One Isaac Lab simulation: its stage, its environments, the state of what moves in them, and of a scene's bodies."""

from __future__ import annotations

import gc
import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene, Vector
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.isaaclab.newton import Newton
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.physx import Physx
from gpusimbench.recorder.simulators.isaaclab.scene import scene_cfg, xyzw
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.fields import StateField, body_fields

_WORLD = "/World"
_ENVIRONMENTS = f"{_WORLD}/envs"
_GROUPS = f"{_WORLD}/collisions"  # one for each environment


class World(ABC):
    """N environments in one simulation; there can be one in a process at a time.

    sim       isaaclab.sim.SimulationContext
    warnings  what the engine had to say of all this
    origins   of the environments in the world frame, torch [env, 3] in float32, on the host
    """

    def __init__(self, described: Any, physics: Physx | Newton, *, gravity: Vector, dt: float, device: str) -> None:
        """described  isaaclab.scene.InteractiveSceneCfg"""
        import torch
        from isaaclab.scene import InteractiveScene
        from isaaclab.sim import SimulationCfg, build_simulation_context

        self._dt = dt
        self._open = ExitStack()
        cfg = SimulationCfg(dt=dt, device=device, gravity=gravity, physics=physics.cfg, save_logs_to_file=False)
        with warnings.catch_warnings(record=True) as caught, ExitStack() as undo:
            warnings.simplefilter("default")
            self.sim = self._open.enter_context(build_simulation_context(sim_cfg=cfg))
            undo.callback(self.close)
            environments = InteractiveScene(described)
            physics.author(self.sim.stage, cfg.physics_prim_path)
            self.sim.reset()
            self.origins = torch.as_tensor(environments.env_origins, dtype=torch.float32).cpu()
            self._device = device
            self._begin(environments)
            undo.pop_all()
        self.warnings = tuple(dict.fromkeys(str(warning.message) for warning in caught))

    @abstractmethod
    def _begin(self, environments: Any) -> None:
        """Take what moves out of an isaaclab.scene.InteractiveScene, and put it into the scene's first state: some
        backends have made a very small step by now, enough to set bodies that touch spinning."""

    @abstractmethod
    def put(self, positions: Any, velocities: Any, envs: Envs) -> None:
        """Give some environments positions and velocities, torch or numpy [env of envs, ...], as `state` has them."""

    @abstractmethod
    def step(self) -> None:
        """One step, as a user's loop has it; nothing waits for the device."""

    def rehearse(self) -> None:
        """Make a step that is taken back; controls that wait for steps go on waiting."""
        self.step()

    @abstractmethod
    def state(self) -> tuple[Any, Any]:
        """Positions and velocities, torch arrays [env, ...] on the device, which may be used again."""

    @abstractmethod
    def fields(self) -> tuple[StateField, ...]:
        """Layout of the arrays of `split`."""

    @abstractmethod
    def split(self, positions: NDArray[np.float32], velocities: NDArray[np.float32]) -> States:
        """Arrays [step, env, ...] of such states as copies, the arrays of the fields."""

    @abstractmethod
    def merged(self, states: States, positions: NDArray[Any], velocities: NDArray[Any]) -> tuple[Any, Any]:
        """The inverse of `split` for the fields' arrays [env, item, width]; positions and velocities are the first
        state of these environments, and may be written to."""

    def usda(self) -> bytes:
        """The stage as the engine was given it, without the clones of the first environment, and what tells them
        apart."""
        from pxr import Sdf

        whole, found = self.sim.stage.GetRootLayer(), Sdf.Layer.CreateAnonymous(".usda")
        for key in ("upAxis", "metersPerUnit", "kilogramsPerUnit"):
            found.pseudoRoot.SetInfo(key, whole.pseudoRoot.GetInfo(key))
        for path in (_WORLD, _ENVIRONMENTS):
            Sdf.CreatePrimInLayer(found, path).specifier = Sdf.SpecifierDef
        paths = [prim.path for prim in whole.rootPrims if prim.path != _WORLD]
        paths += [
            prim.path for prim in whole.GetPrimAtPath(_WORLD).nameChildren if prim.path not in (_ENVIRONMENTS, _GROUPS)
        ]
        for path in (*paths, f"{_ENVIRONMENTS}/env_0"):
            Sdf.CopySpec(whole, path, found, path)
        text: str = found.ExportToString()
        return text.encode()

    def close(self) -> None:
        """End the simulation, so that another can begin. A second call does nothing."""
        self._let_go()
        self._open.close()
        gc.collect()  # what belongs to the engine is in cycles

    @abstractmethod
    def _let_go(self) -> None:
        """Forget what belongs to the engine."""


class BodyWorld(World):
    """Positions: poses [env, body, 7], positions and quaternions xyzw. Velocities: [env, body, 6], linear of the centre
    of mass and angular. All in the world frame."""

    def __init__(
        self, scene: Scene, physics: Physx | Newton, *, n_env: int, dt: float, options: IsaacLabOptions, device: str
    ) -> None:
        self._scene = scene
        described, self._named = scene_cfg(scene, n_env=n_env, options=options)
        self._counts = [len(bodies) for bodies in self._named.values()]
        places = {body.name: index for index, body in enumerate(scene.moving())}
        self._groups = [np.array([places[name] for name in names]) for names in scene.groups().values()]
        super().__init__(described, physics, gravity=scene.gravity, dt=dt, device=device)

    def _begin(self, environments: Any) -> None:
        self._collections = [_checked(environments[name], bodies) for name, bodies in self._named.items()]
        self.put(*_start_of(self._scene, self.origins), None)

    def put(self, positions: Any, velocities: Any, envs: Envs) -> None:
        """See World.put."""
        import torch

        ids = None if envs is None else torch.as_tensor(envs, dtype=torch.int32, device=self._device)
        given = (torch.as_tensor(array, dtype=torch.float32, device=self._device) for array in (positions, velocities))
        parts = zip(self._collections, *(array.split(self._counts, dim=1) for array in given), strict=True)
        for collection, pose, speed in parts:
            collection.write_body_link_pose_to_sim_index(body_poses=pose.contiguous(), env_ids=ids)
            collection.write_body_com_velocity_to_sim_index(body_velocities=speed.contiguous(), env_ids=ids)
            collection.update(0.0)
        # Newton clears its solver's starting point in environments that were written to, but not before a state is
        # read: unread, it would clear what is put there next
        self.state()

    def step(self) -> None:
        """See World.step."""
        self.sim.step(render=False)
        for collection in self._collections:
            collection.update(self._dt)

    def state(self) -> tuple[Any, Any]:
        """See World.state."""
        poses = [collection.data.body_link_pose_w.torch for collection in self._collections]
        speeds = [collection.data.body_com_vel_w.torch for collection in self._collections]
        if len(poses) == 1:
            return poses[0], speeds[0]
        import torch

        return torch.cat(poses, dim=1), torch.cat(speeds, dim=1)

    def fields(self) -> tuple[StateField, ...]:
        """See World.fields."""
        notes = {"orientation": "reordered by the recorder from Isaac Lab's xyzw"}
        return body_fields(self._scene.groups(), "float32", notes)

    def split(self, positions: NDArray[np.float32], velocities: NDArray[np.float32]) -> States:
        """See World.split."""
        arrays: list[NDArray[np.float32]] = []
        for group in self._groups:
            pose, speed = positions[:, :, group], velocities[:, :, group]
            arrays += [pose[..., :3], pose[..., [6, 3, 4, 5]], speed[..., :3], speed[..., 3:]]
        return tuple(arrays)

    def merged(self, states: States, positions: NDArray[Any], velocities: NDArray[Any]) -> tuple[Any, Any]:
        """See World.merged."""
        for group, part in zip(self._groups, range(0, len(states), 4), strict=True):
            position, orientation, linear, angular = states[part : part + 4]
            positions[:, group] = np.concatenate([position, orientation[..., [1, 2, 3, 0]]], axis=-1)
            velocities[:, group] = np.concatenate([linear, angular], axis=-1)
        return positions, velocities

    def _let_go(self) -> None:
        vars(self).pop("_collections", None)


def _checked(collection: Any, bodies: tuple[str, ...]) -> Any:
    if tuple(collection.body_names) != bodies:
        raise RuntimeError(f"Isaac Lab has put the bodies {', '.join(bodies)} into another order")
    return collection


def _start_of(scene: Scene, origins: Any) -> tuple[Any, Any]:
    """Poses [env, body, 7] and speeds [env, body, 6] of the scene's bodies in the world frame, torch on the host."""
    import torch

    moving = scene.moving()
    pose = torch.tensor([(*body.position, *xyzw(body.orientation)) for body in moving], dtype=torch.float32)
    speed = torch.tensor([(*body.linear_velocity, *body.angular_velocity) for body in moving], dtype=torch.float32)
    poses = pose.expand(len(origins), -1, -1).clone()
    poses[..., :3] += origins[:, None]
    return poses, speed.expand(len(origins), -1, -1).contiguous()
