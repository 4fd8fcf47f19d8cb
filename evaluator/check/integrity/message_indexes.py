"""The message indexes behind a chunk, held against its messages."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.schemas.mcap.records import ChunkIndex, Record

_LISTED = 3  # channels


class MessageIndexes:
    """Where the messages of a chunk are, and where the message indexes behind the chunk say that they are.

    entry  what the summary has to say of it, but for the message indexes
    """

    def __init__(self, entry: ChunkIndex) -> None:
        self.entry = entry
        self._there: dict[int, array[int]] = {}  # by channel: time and place of each message, flat
        self._indexed: dict[int, array[int]] = {}
        self._index_bytes = 0

    def add_message(self, channel: int, log_time: int, position: int) -> None:
        """A message of the chunk, and where in it that begins."""
        self._there.setdefault(channel, array("Q")).extend((log_time, position))

    def add_index(self, record: Record, channel: int, entries: memoryview) -> None:
        """A message index that follows the chunk."""
        self._indexed.setdefault(channel, array("Q")).frombytes(entries)
        self.entry.places[channel] = record.begin
        self._index_bytes += record.length

    def check(self, problems: Problems) -> ChunkIndex:
        """Compare messages and indexes, a chunk without any index being whole; returns the entry of the summary."""
        begin = self.entry.start
        times = [np.frombuffer(found, np.uint64)[::2] for found in self._there.values()]
        first, last = (int(pick([pick(part) for part in times])) if times else 0 for pick in (np.min, np.max))
        if times and (first, last) != (self.entry.first_time, self.entry.last_time):
            problems.add(Kind.index, f"the chunk at byte {begin} says other times than its messages")
        wrong = [
            channel
            for channel in self._indexed.keys() | self._there.keys()
            if not np.array_equal(_sorted(self._indexed.get(channel)), _sorted(self._there.get(channel)))
        ]
        if self._indexed and wrong:
            channels = ", ".join(map(str, sorted(wrong)[:_LISTED]))
            problems.add(Kind.index, f"behind the chunk at byte {begin}, for channel {channels}")
        return self.entry._replace(index_bytes=self._index_bytes)


def _sorted(flat: array[int] | None) -> NDArray[np.uint64]:
    # pairs in order, shape [message, 2]
    pairs = np.frombuffer(flat, np.uint64).reshape(-1, 2) if flat else np.empty((0, 2), np.uint64)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
