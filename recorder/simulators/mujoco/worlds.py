"""The environments of MuJoCo C, and the two ways in which they are stepped, which give the same bits.

``BatchWorlds`` are the simulations of one ``mujoco.batch.Batch``. ``SeparateWorlds`` have a ``mujoco.MjData`` each and
call ``mj_step``, which releases of MuJoCo have that know no batch.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.mujoco.contacts import misplaced
from gpusimbench.recorder.simulators.mujoco.options import STATE_COMPONENTS
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of
from gpusimbench.schemas.errors import UsageError


class Worlds(ABC):
    """Environments of one model, or of a model each, in the reset state, which all models have in common.

    timing_covers  what ``step`` does, as a recording says it
    """

    timing_covers: str

    @abstractmethod
    def step(self, n_step: int) -> None:
        """Advance all environments by n_step steps, on all threads."""

    @abstractmethod
    def reset(self, envs: Envs) -> None:
        """Bring environments to the model's reset state, with no warnings counted."""

    @abstractmethod
    def read(self, name: str) -> NDArray[Any]:
        """A field of MjData, [env, ...], as it is now; not to be written to, nor to be kept over a step."""

    @abstractmethod
    def write(self, name: str, values: NDArray[Any], envs: Envs = None) -> None:
        """Set a field of the state; values are [env, ...] of the given environments, or one row for all."""

    @abstractmethod
    def warnings(self) -> NDArray[np.int64]:
        """How often MuJoCo warned since the reset, [env, kind]."""

    def misplaced(self) -> NDArray[np.int64] | None:
        """Misplaced contacts of the last step, [env]; None where contacts cannot be read."""
        return None

    @property
    @abstractmethod
    def state_names(self) -> Sequence[str]:
        """The fields of MjData that mjSTATE_INTEGRATION consists of in this release."""


class BatchWorlds(Worlds):
    """Simulations of one mujoco.batch.Batch."""

    timing_covers = "Batch.step of all environments on all threads; no state is copied, nothing is drawn"
    state_names = STATE_COMPONENTS

    def __init__(self, models: Sequence[Any], threads: int) -> None:
        from mujoco.batch import Batch

        self._batch = Batch(models[0], nsim=len(models), nthread=threads)
        if any(model is not models[0] for model in models):
            self._batch.set_models(models)
        self._batch.reset()
        self._bound = {name: self._batch.bind(name) for name in (*STATE_COMPONENTS, "ncon", "nefc")}

    def step(self, n_step: int) -> None:
        """See Worlds.step."""
        self._batch.step(nstep=n_step)

    def reset(self, envs: Envs) -> None:
        """See Worlds.reset."""
        self._batch.reset(ids=envs)

    def read(self, name: str) -> NDArray[Any]:
        """See Worlds.read."""
        return np.asarray(self._bound[name])

    def write(self, name: str, values: NDArray[Any], envs: Envs = None) -> None:
        """See Worlds.write."""
        self._bound[name][rows_of(envs)] = values

    def warnings(self) -> NDArray[np.int64]:
        """See Worlds.warnings."""
        return np.asarray(self._batch.warning)[:, :, 1].astype(np.int64)


class SeparateWorlds(Worlds):
    """A mujoco.MjData for each environment, stepped by mj_step, each thread a share of them."""

    timing_covers = "mj_step of each environment, on all threads; no state is copied, nothing is drawn"

    def __init__(self, models: Sequence[Any], threads: int) -> None:
        self._models = models
        self._data = [mujoco.MjData(model) for model in models]
        count = min(threads, len(models))
        pairs = list(zip(models, self._data, strict=True))
        self._shares = [pairs[k::count] for k in range(count)]
        self._pool = ThreadPoolExecutor(count - 1) if count > 1 else None  # the caller's thread takes the first share

    @property
    def state_names(self) -> Sequence[str]:
        """See Worlds.state_names; older releases have fewer."""
        return [name for name in STATE_COMPONENTS if hasattr(self._data[0], name)]

    def step(self, n_step: int) -> None:
        """See Worlds.step."""
        others = [self._pool.submit(self._advance, share, n_step) for share in self._shares[1:]] if self._pool else []
        self._advance(self._shares[0], n_step)
        for other in others:
            other.result()

    def _advance(self, share: list[tuple[Any, Any]], n_step: int) -> None:
        for model, data in share:
            mujoco.mj_step(model, data, n_step)  # without Python's lock

    def reset(self, envs: Envs) -> None:
        """See Worlds.reset."""
        for env in self._chosen(envs):
            mujoco.mj_resetData(self._models[env], self._data[env])

    def read(self, name: str) -> NDArray[Any]:
        """See Worlds.read."""
        return np.array([getattr(data, name) for data in self._data])

    def write(self, name: str, values: NDArray[Any], envs: Envs = None) -> None:
        """See Worlds.write."""
        chosen = self._chosen(envs)
        now = np.array([getattr(self._data[env], name) for env in chosen])
        now[:] = values
        for env, row in zip(chosen, now, strict=True):
            if row.ndim:
                getattr(self._data[env], name)[:] = row
            else:  # such as the time
                setattr(self._data[env], name, row.item())

    def warnings(self) -> NDArray[np.int64]:
        """See Worlds.warnings."""
        return np.array([data.warning.number for data in self._data], dtype=np.int64)

    def misplaced(self) -> NDArray[np.int64]:
        """See Worlds.misplaced."""
        pairs = zip(self._models, self._data, strict=True)
        return np.array([misplaced_in(model, data) for model, data in pairs], dtype=np.int64)

    def _chosen(self, envs: Envs) -> list[int]:
        return list(range(len(self._data))) if envs is None else [int(env) for env in envs]


def misplaced_in(model: Any, data: Any) -> int:
    """Misplaced contacts of a mujoco.MjData."""
    found = data.contact
    geoms = found.geom.reshape(-1, 2)  # -1: no geom, and no point is outside
    radii = np.where(geoms < 0, 0, model.geom_rbound[geoms])
    return int(misplaced(found.pos.reshape(-1, 3), found.dist, data.geom_xpos[geoms], radii).sum())


def remembers(model: Any) -> str:
    """The flag of a mujoco.MjModel, such as sleep, with which MuJoCo remembers more between steps than
    mjSTATE_INTEGRATION has; empty where there is none."""
    flags = {name: getattr(mujoco.mjtEnableBit, f"mjENBL_{name.upper()}", 0) for name in ("sleep", "ipc")}
    return next((name for name, bit in flags.items() if model.opt.enableflags & int(bit)), "")


def make_worlds(stepping: str, models: Sequence[Any], threads: int) -> Worlds:
    """An environment of each model, which may be the same one, stepped in that way; UsageError where this release of
    MuJoCo does not have it."""
    there = find_spec("mujoco.batch") is not None
    if stepping == "batch" and not there:
        raise UsageError(f"stepping=batch: MuJoCo {mujoco.__version__} has no mujoco.batch; use stepping=mj_step")
    flag = remembers(models[0])
    if stepping == "batch" and flag:
        raise UsageError(f"stepping=batch: mujoco.batch has no models with the flag {flag}; use stepping=mj_step")
    kind = BatchWorlds if there and stepping != "mj_step" and not flag else SeparateWorlds
    return kind(models, threads)
