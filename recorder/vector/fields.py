"""Arrays that environments return, as fields of a recording: of images, hashes or all numbers; and scalars of infos,
such as "success", with the environments that they are of."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.modes import FINAL, Mode
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import DIMENSIONLESS, FIELD_KINDS, UNKNOWN, StateField, array_field
from gpusimbench.schemas.images import image_hash_note, image_hashes
from gpusimbench.schemas.trees import on_host

HASH = "/hash"
"""Ends the names of arrays of hashes."""

Arrays = dict[str, NDArray[Any]]

_AXES = 3  # of an image: height, width, channels, in any order


class Images(Enum):
    """HASH: a 64-bit hash of each frame; NUMBERS: every number of it."""

    HASH = "hash"
    NUMBERS = "numbers"

    @classmethod
    def of(cls, word: str) -> Images:
        """From the word that a user gives; UsageError for another."""
        try:
            return cls(word)
        except ValueError:
            raise UsageError(f"images is 'hash' or 'numbers', not {word!r}") from None

    def recorded(self, arrays: Arrays, notes: dict[str, str], lead: int = 1) -> Arrays:
        """Arrays by name, with hashes in the places of observed images: uint8 with three axes or more.

        lead   axes before those of the image: [env, ...] or [step, env, ...]
        notes  gets one on each array of hashes, by its name
        """
        if self is Images.NUMBERS:
            return arrays
        found: Arrays = {}
        made: dict[int, NDArray[np.float64]] = {}  # what a step led to is often the very array that is observed
        for name, array in arrays.items():
            if not (name.startswith(("observation", FINAL)) and array.dtype == np.uint8 and array.ndim >= lead + _AXES):
                found[name] = array
                continue
            if id(array) not in made:
                made[id(array)] = image_hashes(array, lead)
            found[f"{name}{HASH}"] = made[id(array)]
            notes[f"{name}{HASH}"] = image_hash_note(array.dtype, array.shape[lead:])
        return found


NO_STEP = "0 stands for it where no step was made: at step 0, and where a call of step began the next episode"

NOT_GIVEN = "0 stands for it where its flag says that it was not given"
GIVEN = "_given"
"""Ends the name of the flag beside an array."""

FACTS = ("terminated", "truncated", "stepped", "episode", "episode_step")
"""Flags and counts of each step."""


def recorded_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The dtype in which numbers are recorded: float32 where that has them all, float64 otherwise."""
    return np.dtype(np.float32 if np.can_cast(dtype, np.float32) else np.float64)


def field_of(name: str, dtype: np.dtype[Any], shape: tuple[int, ...], *notes: str, unit: str = UNKNOWN) -> StateField:
    """The field of an array [env, ...]: its name as a recording has it, and what becomes of its numbers.

    shape  of the array of one environment
    notes  on its numbers
    """
    recorded = recorded_dtype(dtype)
    told = [f"recorded from {dtype}"] if recorded != dtype else []
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "array"
    if plain in FIELD_KINDS:  # which would make it a state of bodies or joints
        plain += "_array"
    return array_field(plain, str(recorded), shape, unit=unit, note="; ".join([*told, *notes]))


def fields_of(row: Mapping[str, NDArray[Any]], notes: Mapping[str, str]) -> tuple[StateField, ...]:
    """The fields of arrays [env, ...] by name, in their order.

    notes  on their numbers, by name
    """
    return tuple(
        field_of(
            name,
            array.dtype,
            array.shape[1:],
            *([notes[name]] if name in notes else []),
            unit=DIMENSIONLESS if name in FACTS or name.endswith((GIVEN, HASH)) else UNKNOWN,
        )
        for name, array in row.items()
    )


FINAL_INFO = "final_info"


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
