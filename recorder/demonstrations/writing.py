"""Demonstrations, written as the recording that gpusimbench.wrap would have made of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.demonstrations.data_set import DataSet, Demonstration
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.vector.fields import GIVEN, array_name, field_of, recorded_dtype
from gpusimbench.recorder.vector.modes import Mode
from gpusimbench.recorder.vector.origin import KEYWORDS, SPEC_ID, VECTORIZED, attachments
from gpusimbench.schemas.errors import DamagedRecording, Unreachable
from gpusimbench.schemas.fields import DIMENSIONLESS, UNKNOWN
from gpusimbench.schemas.vector import DATA_SET, FINAL_GIVEN, NOT_GIVEN, PHYSICS

_ROWS = 50
_BLOCK = 1 << 20  # bytes that are read at a time
_FLAGS = ("terminated", "truncated", "stepped", "episode", "episode_step", FINAL_GIVEN)
_NOT_KNOWN = f"where {FINAL_GIVEN} is 0, the data set lacks it, and the observation before it stands there"

Columns = dict[str, NDArray[Any]]


def write(
    demonstrations: Sequence[Demonstration],
    path: Path,
    source: DataSet,
    *,
    spec_id: str,
    keywords: Mapping[str, Any] | None,
    dt: float,
) -> None:
    """Write a recording in which a few environments go through the episodes, dealt in their order.

    path      of the recording
    source    the data set, of whose files the recording has the SHA-256, one after another
    spec_id, keywords  of the environment, for Gymnasium's registry; None where the data set does not tell the keywords
    dt        simulated time of a step [s]

    UsageError where the recording exists. DamagedRecording where episodes have different arrays.
    """
    n_env = min(source.at_once, len(demonstrations))
    dealt = [list(demonstrations[env::n_env]) for env in range(n_env)]
    columns = _columns(dealt, source.path)
    rewarded = all(one.rewarded for one in demonstrations)
    steps = len(columns["reward"]) - 1
    notes = {name: [_NOT_KNOWN] for name in columns if name.startswith("final_observation")}
    if not rewarded:
        notes["reward"] = ["the data set has no rewards; 0 stands for them"]
    fields = [
        field_of(
            name,
            array.dtype,
            array.shape[2:],
            *notes.get(name, []),
            unit=DIMENSIONLESS if name in _FLAGS or name.endswith(GIVEN) else UNKNOWN,
        )
        for name, array in columns.items()
    ]
    digest = hashlib.sha256()
    for one in source.files:
        try:
            with one.open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
        except OSError as error:  # which would look as if the results could not be written
            raise Unreachable(f"cannot read {one}: {error.strerror}") from None
    with RecordingWriter(
        path, simulator=DATA_SET, version=source.version, scene=spec_id, n_env=n_env, dt=dt,
        steps=steps, fields=fields, view=(), compression="zstd", attachments=attachments(dealt),
        options={
            "autoreset_mode": Mode.DISABLED.value, SPEC_ID: spec_id,
            **({} if keywords is None else {KEYWORDS: json.dumps(keywords, sort_keys=True)}),
            "seeds": "not given", "source": source.path.name or source.name, "source_sha256": digest.hexdigest(),
            **({} if rewarded else {NOT_GIVEN: "reward"}),
            **({VECTORIZED: source.made.vectorization} if source.made.vectorization != "sync" else {}),
        },
    ) as log:  # fmt: skip
        for begin in range(0, steps + 1, _ROWS):
            rows = slice(begin, begin + _ROWS)
            log.append(*(array[rows].astype(recorded_dtype(array.dtype)) for array in columns.values()))


def _columns(dealt: Sequence[Sequence[Demonstration]], source: Path) -> Columns:
    """Every array of the recording, [row, env, ...]."""
    first, n_env = dealt[0][0], len(dealt)
    rows = 1 + max(sum(map(len, of_env)) for of_env in dealt)
    kinds = {**first.actions, **first.observations}
    kinds |= {name.replace("observation", "final_observation", 1): array for name, array in first.observations.items()}
    kinds |= {f"{PHYSICS}{name}": array for name, array in first.physics.items()}
    found = {name: np.zeros((rows, n_env, *array.shape[1:]), array.dtype) for name, array in kinds.items()}
    for name in first.infos:
        found |= {
            array_name(name): np.zeros((rows, n_env)),
            f"{array_name(name)}{GIVEN}": np.zeros((rows, n_env), bool),
        }
    found["reward"] = np.zeros((rows, n_env), first.rewards.dtype)
    found |= {name: np.zeros((rows, n_env), np.int32 if "episode" in name else np.bool_) for name in _FLAGS}
    for env, of_env in enumerate(dealt):
        at = 0
        for number, one in enumerate(of_env):
            _put(found, env, at, number, one, source)
            at += len(one)
        found["episode"][at:, env] = len(of_env)  # which has no step
    return found


def _put(columns: Columns, env: int, at: int, number: int, one: Demonstration, source: Path) -> None:
    """Write an episode whose first observation is in row `at`."""
    n = len(one)
    before, after = slice(at, at + n), slice(at + 1, at + n + 1)
    given: dict[str, tuple[slice, NDArray[Any]]] = {name: (after, array) for name, array in one.actions.items()}
    for name, array in one.observations.items():
        whole = array if len(array) > n else np.concatenate([array, array[-1:]])
        given[name] = (before, whole[:-1])
        final = name.replace("observation", "final_observation", 1)
        given[final] = (
            (slice(at, at + n + 1), whole) if not at else (after, whole[1:])
        )  # in row 0 the first observation
        columns[FINAL_GIVEN][after, env] = True
        columns[FINAL_GIVEN][at + n, env] = len(array) > n
    given |= {f"{PHYSICS}{name}": (before, array) for name, array in one.physics.items()}
    given["reward"] = (after, one.rewards)
    for name, array in one.infos.items():
        values = array.astype(np.float64)
        told = ~np.isnan(values)
        given[array_name(name)] = (after, np.where(told, values, 0.0))
        given[f"{array_name(name)}{GIVEN}"] = (after, told)
    for name, (rows, array) in given.items():
        column = columns.get(name)
        if column is None or column.shape[2:] != array.shape[1:] or column.dtype != array.dtype:
            raise DamagedRecording(f"{source}: {name} is not the same kind of array in all episodes")
        column[rows, env] = array
    columns["episode"][before, env] = number
    columns["episode_step"][before, env] = np.arange(n)
    columns["stepped"][after, env] = True
    columns["terminated"][at + n, env], columns["truncated"][at + n, env] = one.terminated, one.truncated
