"""Scalars of the infos that a vector environment returns, such as "success", and of which environments they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.fields import GIVEN
from gpusimbench.recorder.vector.modes import Mode
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import on_host

FINAL_INFO = "final_info"
Arrays = dict[str, NDArray[Any]]


def array_name(name: str) -> str:
    """What the array of an info is called."""
    return f"info/{name}"


def nothing_told(names: tuple[str, ...], n_env: int) -> Arrays:
    """The arrays of a row that no step led to."""
    return {
        array: zeros
        for name in names
        for array, zeros in (
            (array_name(name), np.zeros(n_env)),
            (f"{array_name(name)}{GIVEN}", np.zeros(n_env, dtype=np.bool_)),
        )
    }


def given(info: Mapping[str, Any], name: str, n_env: int) -> NDArray[np.bool_]:
    """Of which environments an info is, [env]; UsageError as told."""
    return _scalar(info, name, n_env)[1]


def info_arrays(
    names: tuple[str, ...], info: Mapping[str, Any], mode: Mode, done: NDArray[np.bool_], stepped: NDArray[np.bool_]
) -> Arrays:
    """What a call of step said of the steps that it made: for each name its numbers and whether they were given, [env].

    names    keys of the info; "a/b" is b in the dictionary a
    info     as Gymnasium's vector environments return it: arrays [env], and with an underscore before the key the mask
             of the environments that said it; without a mask, all did
    mode     where it is SAME_STEP, what is said of an episode's last step is in info["final_info"]: elsewhere it is of
             the reset that followed
    done     where an episode ended, [env]
    stepped  where a step was made; a reset's info is not recorded, [env]

    UsageError where an info is not one real number or truth value for each environment.
    """
    found = {}
    for name in names:
        values, given = _scalar(info, name, len(done))
        if mode is Mode.SAME_STEP and done.any():
            last, of_last = _scalar(info, f"{FINAL_INFO}/{name}", len(done))
            values, given = np.where(done, last, values), np.where(done, of_last, given)
        given &= stepped
        found[array_name(name)] = np.where(given, values, 0.0)
        found[f"{array_name(name)}{GIVEN}"] = given
    return found


def _scalar(info: Mapping[str, Any], name: str, n_env: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    given = np.ones(n_env, dtype=np.bool_)
    node: Any = info
    for key in name.split("/"):
        if not isinstance(node, Mapping) or key not in node:
            return np.zeros(n_env), np.zeros(n_env, dtype=np.bool_)
        if f"_{key}" in node:
            given &= on_host(node[f"_{key}"], f"_{key}").astype(np.bool_)
        node = node[key]
    if isinstance(node, np.ndarray) and node.dtype == object:  # what Gymnasium makes of truth values of numpy
        node = np.array([value if one else False for value, one in zip(node, given, strict=True)])
    array = on_host(node, f"info {name}")
    if array.size != n_env or array.shape[:1] != (n_env,):
        raise UsageError(
            f"info {name} has shape {array.shape}; a number for each of {n_env} environments is recorded: give each "
            "component a name of its own in the info, or hash the whole by fingerprint"
        )
    return array.reshape(n_env).astype(np.float64), given
