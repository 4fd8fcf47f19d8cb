"""Digests and state hashes of a recording's states, computed anew from the blocks in its file; and the recorded hashes
of arrays that a program has beside its simulator: the topics /program/<name>."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import MAX_MESSAGES, Messages
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.schemas import topics
from gpusimbench.schemas.commands.progress import moved
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fingerprint import expect, fingerprint

_SHARE = 0.5  # of the time that a file takes to be read and verified
_THREADS = 4  # that compute digests of different fields
_BYTES = 256 << 20  # read at a time, at most; a block of all states has 128 MiB
_GROUPED_BYTES = 4 << 20  # smaller blocks are read together


def digest_states(
    digest: ContentDigest, arrays: Sequence[StateArray], n_env: int, *, hashed: bool
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint64]]]:
    """Feed all rows of all fields to a digest; gives the steps of some rows at a time, and their state hashes [step,
    env], without any where they are not to be hashed.

    DamagedRecording where a block is damaged, or where the fields have different rows.
    """
    if hashed:
        expect(sum(math.prod(array.shape) * array.dtype.itemsize for array in arrays))
    ranges = _env_ranges(arrays)
    fed: list[Future[None]] = []
    with ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1)) as pool:
        for rows in _row_ranges(arrays):
            columns = list(pool.map(_columns, arrays, repeat(rows), repeat(ranges)))
            for done in fed:  # digests of the rows before, in whose order these follow
                done.result()
            fed = [
                pool.submit(digest.state_columns, array.field, n_env, parts)
                for array, parts in zip(arrays, columns, strict=True)
            ]
            if hashed:
                found = [fingerprint(states) for states in zip(*columns, strict=True)]
                yield arrays[0].steps[rows], np.concatenate(found, axis=1)
            moved(_SHARE * sum(part.nbytes for parts in columns for part in parts))
        for done in fed:
            done.result()


def _env_ranges(arrays: Sequence[StateArray]) -> tuple[slice, ...]:
    """Ranges of environments that are blocks of their own in the file, and so are read without a copy."""
    ranges = [array.env_ranges for array in arrays]
    return ranges[0] if ranges and all(other == ranges[0] for other in ranges) else (slice(None),)


def _columns(array: StateArray, rows: slice, ranges: Sequence[slice]) -> list[NDArray[Any]]:
    return [array.read(rows, envs, copy=False) for envs in ranges]


def _row_ranges(arrays: Sequence[StateArray]) -> Iterator[slice]:
    """Ranges of rows that fit into memory together, blocks of the file where they are large, so that these are read
    once and not copied; DamagedRecording where the fields have different rows."""
    if not arrays:
        return
    if len({len(array) for array in arrays}) > 1:
        raise DamagedRecording("the state fields have different numbers of rows")
    row = max(1, sum(math.prod(array.shape[1:]) * array.dtype.itemsize for array in arrays))
    begin = end = 0
    for size in arrays[0].block_rows:
        if end > begin and (end - begin + size) * row > _GROUPED_BYTES:
            yield from _split(begin, end, row)
            begin = end
        end += size
    yield from _split(begin, min(end, len(arrays[0])), row)


def _split(begin: int, end: int, row: int) -> Iterator[slice]:
    count = max(1, _BYTES // row)
    for first in range(begin, end, count):
        yield slice(first, min(first + count, end))


@dataclass(frozen=True)
class Updates:
    """Calls of one name, in order.

    order   number of each among the calls of all names, shape [update]
    states  how many states precede each, shape [update]
    arrays  of each the described arrays, "<dtype> <shape> <name>"
    hashes  of each the hashes of its arrays
    """

    order: NDArray[np.int64]
    states: NDArray[np.int64]
    arrays: tuple[tuple[str, ...], ...]
    hashes: tuple[NDArray[np.uint64], ...]


def read_program(messages: Messages) -> dict[str, Updates]:
    """Hashes by name; DamagedRecording where they are not in order, one is missing, or one is not of an array."""
    names = {topic: topics.parse_program(topic) for topic in messages.topics("/program/")}
    found = {
        name: _updates(messages, topic, parts)
        for topic, name in names.items()
        if name is not None and (parts := messages.read(topic, "gsb.v1.ArrayHashes", MAX_MESSAGES))
    }
    if found:
        order = np.sort(np.concatenate([updates.order for updates in found.values()]))
        if (order != np.arange(len(order))).any():
            raise messages.damaged("an update of /program is missing or there twice")
    return found


def _updates(messages: Messages, topic: str, parts: list[Any]) -> Updates:
    arrays: list[tuple[str, ...]] = []
    for number, part in enumerate(parts):
        arrays.append(tuple(part.arrays) if part.arrays or not arrays else arrays[-1])
        if part.update != number or len(part.hashes) != len(arrays[-1]):
            raise messages.damaged(f"{topic} has an update out of order, or hashes of other arrays than it names")
    return Updates(
        order=_increasing(messages, topic, [part.order for part in parts]),
        states=_increasing(messages, topic, [part.states for part in parts]),
        arrays=tuple(arrays),
        hashes=tuple(np.fromiter(part.hashes, np.uint64, len(part.hashes)) for part in parts),
    )


def _increasing(messages: Messages, topic: str, numbers: list[int]) -> NDArray[np.int64]:
    if numbers[-1] >= 1 << 62 or any(later < earlier for earlier, later in zip(numbers, numbers[1:], strict=False)):
        raise messages.damaged(f"the updates of {topic} are not in order")
    return np.array(numbers, dtype=np.int64)
