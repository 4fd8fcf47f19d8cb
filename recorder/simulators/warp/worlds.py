"""The state of worlds in a mujoco_warp.Data: saved, assigned and reset, all of them or some."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.mujoco.options import STATE_COMPONENTS
from gpusimbench.recorder.simulators.snapshot import Envs


def kept(data: Any) -> dict[str, NDArray[Any]]:
    """What decides the next step, copies [world, ...] by MuJoCo's names; all else is made anew in each step."""
    return {name: np.array(getattr(data, name).numpy()) for name in STATE_COMPONENTS if hasattr(data, name)}


def assign(data: Any, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
    """Write rows of these arrays, [world of envs, ...]; the other worlds keep their bits."""
    for name, rows in arrays.items():
        target = getattr(data, name)
        if target.size:
            whole = target.numpy()
            whole[slice(None) if envs is None else envs] = rows
            target.assign(whole)


def reset(model: Any, data: Any, envs: Envs) -> None:
    """mujoco_warp.reset_data of these worlds. Overflow bits stay until they are asked for, also those of a reset."""
    import mujoco_warp as mjw
    import warp as wp

    chosen = np.zeros(data.nworld, dtype=bool)
    chosen[slice(None) if envs is None else envs] = True
    bits = data.overflow.numpy().copy()
    mjw.reset_data(model, data, wp.array(chosen, dtype=bool))
    data.overflow.assign(bits)
