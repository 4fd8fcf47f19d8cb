"""One Isaac Lab simulation: its stage, its environments, the state of their moving bodies."""

from __future__ import annotations

import gc
import warnings
from contextlib import ExitStack
from typing import Any

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.isaaclab.newton import Newton
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.physx import Physx
from gpusimbench.recorder.simulators.isaaclab.scene import scene_cfg, xyzw
from gpusimbench.recorder.simulators.snapshot import Envs

_WORLD = "/World"
_ENVIRONMENTS = f"{_WORLD}/envs"
_GROUPS = f"{_WORLD}/collisions"  # one for each environment


class World:
    """N environments in one simulation; there can be one in a process at a time.

    sim       isaaclab.sim.SimulationContext
    warnings  what the engine had to say of all this
    origins   of the environments in the world frame, torch [env, 3] in float32, on the host
    """

    def __init__(
        self, scene: Scene, physics: Physx | Newton, *, n_env: int, dt: float, options: IsaacLabOptions, device: str
    ) -> None:
        import torch
        from isaaclab.scene import InteractiveScene
        from isaaclab.sim import SimulationCfg, build_simulation_context

        self._dt = dt
        self._open = ExitStack()
        cfg = SimulationCfg(dt=dt, device=device, gravity=scene.gravity, physics=physics.cfg, save_logs_to_file=False)
        with warnings.catch_warnings(record=True) as caught, ExitStack() as undo:
            warnings.simplefilter("default")
            self.sim = self._open.enter_context(build_simulation_context(sim_cfg=cfg))
            undo.callback(self.close)
            described, collections = scene_cfg(scene, n_env=n_env, options=options)
            environments = InteractiveScene(described)
            physics.author(self.sim.stage, cfg.physics_prim_path)
            self.sim.reset()
            self._collections = [_checked(environments[name], bodies) for name, bodies in collections.items()]
            self.origins = torch.as_tensor(environments.env_origins, dtype=torch.float32).cpu()
            self._device = device
            self._counts = [len(bodies) for bodies in collections.values()]
            # some backends have made a very small step by now, enough to set bodies that touch spinning
            self.put(*_start_of(scene, self.origins), None)
            undo.pop_all()
        self.warnings = tuple(dict.fromkeys(str(warning.message) for warning in caught))

    def put(self, poses: Any, speeds: Any, envs: Envs) -> None:
        """Give the bodies of some environments poses and speeds, torch or numpy [env of envs, body, ...], as ``state``
        has them."""
        import torch

        ids = None if envs is None else torch.as_tensor(envs, dtype=torch.int32, device=self._device)
        given = (torch.as_tensor(array, dtype=torch.float32, device=self._device) for array in (poses, speeds))
        parts = zip(self._collections, *(array.split(self._counts, dim=1) for array in given), strict=True)
        for collection, pose, speed in parts:
            collection.write_body_link_pose_to_sim_index(body_poses=pose.contiguous(), env_ids=ids)
            collection.write_body_com_velocity_to_sim_index(body_velocities=speed.contiguous(), env_ids=ids)
            collection.update(0.0)
        # Newton clears its solver's starting point in environments that were written to, but not before a state is
        # read: unread, it would clear what is put there next
        self.state()

    def step(self) -> None:
        """One step, as a user's loop has it; nothing waits for the device."""
        self.sim.step(render=False)
        for collection in self._collections:
            collection.update(self._dt)

    def state(self) -> tuple[Any, Any]:
        """The engine's own torch arrays, which it uses again: poses [env, body, 7], positions and quaternions xyzw;
        speeds [env, body, 6], linear of the centre of mass and angular; all in the world frame, on the device."""
        poses = [collection.data.body_link_pose_w.torch for collection in self._collections]
        speeds = [collection.data.body_com_vel_w.torch for collection in self._collections]
        if len(poses) == 1:
            return poses[0], speeds[0]
        import torch

        return torch.cat(poses, dim=1), torch.cat(speeds, dim=1)

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
        vars(self).pop("_collections", None)
        self._open.close()
        gc.collect()  # what belongs to the engine is in cycles


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
