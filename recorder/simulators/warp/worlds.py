"""The state of worlds in a mujoco_warp.Data: saved, assigned and reset, all of them or some; the parameters of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.mujoco.options import STATE_COMPONENTS
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of
from gpusimbench.schemas.errors import GsbError

_OF_SLEEP = ("dof_length",)  # weights of velocities when bodies fall asleep, which no scene lets them


def kept(data: Any) -> dict[str, NDArray[Any]]:
    """What decides the next step, copies [world, ...] by MuJoCo's names; all else is made anew in each step."""
    return {name: np.array(getattr(data, name).numpy()) for name in STATE_COMPONENTS if hasattr(data, name)}


def assign(data: Any, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
    """Write rows of these arrays, [world of envs, ...]; the other worlds keep their bits."""
    for name, rows in arrays.items():
        target = getattr(data, name)
        if target.size:
            whole = target.numpy()
            whole[rows_of(envs)] = rows
            target.assign(whole)


def reset(model: Any, data: Any, envs: Envs) -> None:
    """mujoco_warp.reset_data of these worlds. Overflow bits stay until they are asked for, also those of a reset."""
    import mujoco_warp as mjw
    import warp as wp

    chosen = np.zeros(data.nworld, dtype=bool)
    chosen[rows_of(envs)] = True
    bits = data.overflow.numpy().copy()
    mjw.reset_data(model, data, wp.array(chosen, dtype=bool))
    data.overflow.assign(bits)


def put_model(model: Any, models: Sequence[Any]) -> Any:
    """A mujoco.MjModel as a mujoco_warp.Model; with `models`, one of each world, what differs between these has an axis
    of worlds."""
    import mujoco_warp as mjw

    varied = model_fields(model, models)
    put = mjw.put_model(model, batch_sizes=dict.fromkeys(varied, len(models)))
    for name, array in varied.items():
        getattr(put, name).assign(array)
    return put


def reader(model: Any) -> Callable[[str], NDArray[Any]]:
    """Reads an array of a mujoco_warp.Model by its name in MjModel, "opt." before those of options; of the first world,
    where each has its own. AttributeError where there is none of that name."""
    import mujoco_warp as mjw

    axes: dict[str, tuple[Any, ...]] = {
        prefix + field.name: getattr(field.type, "shape", ())
        for prefix, owner in (("", mjw.Model), ("opt.", mjw.Option))
        for field in fields(owner)
    }

    def read(name: str) -> NDArray[Any]:
        owner, _, field = name.rpartition(".")
        found = getattr(model.opt if owner else model, field)
        array: NDArray[Any] = np.asarray(found.numpy() if hasattr(found, "numpy") else found)
        if axes[name][:1] == ("*",):
            first: NDArray[Any] = array[0]
            return first
        return _excluded(model, array) if name == "exclude_signature" else array

    return read


def _excluded(model: Any, signatures: NDArray[Any]) -> NDArray[Any]:
    # excludes that the list of pairs, which collision detection goes by, follows
    of = model.geom_bodyid.numpy()
    tested = {tuple(sorted(pair)) for pair in of[model.nxn_geom_pair_filtered.numpy()].tolist()}
    return np.array([s for s in signatures if tuple(sorted((int(s) >> 16, int(s) & 0xFFFF))) not in tested], dtype=int)


def model_fields(model: Any, models: Sequence[Any]) -> dict[str, NDArray[Any]]:
    """Fields of mujoco_warp.Model that differ between the mujoco.MjModels of worlds, [world, ...], by name.

    GsbError where a field differs of which MuJoCo Warp has no copy for each world.
    """
    import mujoco_warp as mjw

    from gpusimbench.recorder.simulators.mujoco.model import varied_fields

    known: dict[str, tuple[Any, ...]] = {field.name: getattr(field.type, "shape", ()) for field in fields(mjw.Model)}
    found = {name: array for name, array in varied_fields(model, models).items() if known.get(name)}
    own = {name: array for name, array in found.items() if known[name][0] == "*"}
    if shared := sorted(found.keys() - own.keys() - {*_OF_SLEEP}):
        raise GsbError(f"MuJoCo Warp has one '{shared[0]}' for all worlds, and with these parameters it differs")
    return own
