"""Hashes of arrays that a program has beside its simulator, as a recording has them: the topics /program/<name>."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import MAX_MESSAGES, Messages
from gpusimbench.schemas import topics


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
