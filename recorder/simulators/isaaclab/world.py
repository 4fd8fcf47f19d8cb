"""One Isaac Lab simulation: its stage, its environments, the state of what moves in them."""

from __future__ import annotations

import gc
import warnings
from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.isaaclab.newton import Newton
from gpusimbench.recorder.simulators.isaaclab.physx import Physx
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.fields import StateField

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
