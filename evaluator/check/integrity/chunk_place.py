"""Where the messages of a chunk are, and where the indexes behind it say that they are."""

from __future__ import annotations

from array import array
from struct import Struct

import numpy as np
from mcap import records
from numpy.typing import NDArray

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.records import Record
from gpusimbench.schemas.errors import DamagedRecording

_SHOWN = 3
_INDEX_HEAD = Struct("<HI")  # of a message index: its channel, and the bytes of its entries
_ENTRY = 16


class ChunkPlace:
    """One chunk: its own entry for an index of chunks, its messages, and the message indexes that follow it.

    entry  what the summary has to say of it; grows with the message indexes
    """

    def __init__(self, entry: records.ChunkIndex) -> None:
        self.entry = entry
        self._there: dict[int, array[int]] = {}  # by channel: time and place of each message, flat
        self._indexed: dict[int, array[int]] = {}

    def add_message(self, channel: int, log_time: int, position: int) -> None:
        """A message of the chunk, and where in it that begins."""
        self._there.setdefault(channel, array("Q")).extend((log_time, position))

    def add_index(self, record: Record) -> None:
        """A message index that follows the chunk; DamagedRecording where it cannot be read."""
        content = record.content
        if len(content) < _INDEX_HEAD.size:
            raise DamagedRecording("a MessageIndex record cannot be read: it is shorter than its own head")
        channel, size = _INDEX_HEAD.unpack_from(content)
        if size % _ENTRY or size > len(content) - _INDEX_HEAD.size:
            raise DamagedRecording("a MessageIndex record cannot be read: it is not as long as it says")
        self._indexed.setdefault(channel, array("Q")).frombytes(content[_INDEX_HEAD.size : _INDEX_HEAD.size + size])
        self.entry.message_index_offsets[channel] = record.begin
        self.entry.message_index_length += record.length

    def check(self, problems: Problems) -> None:
        """Compare messages and indexes; a chunk without any index is whole."""
        begin = self.entry.chunk_start_offset
        times = [np.frombuffer(found, np.uint64)[::2] for found in self._there.values()]
        first, last = (int(pick([pick(part) for part in times])) if times else 0 for pick in (np.min, np.max))
        if times and (first, last) != (self.entry.message_start_time, self.entry.message_end_time):
            problems.add(Kind.index, f"the chunk at byte {begin} says other times than its messages")
        wrong = [
            channel
            for channel in self._indexed.keys() | self._there.keys()
            if not np.array_equal(_sorted(self._indexed.get(channel)), _sorted(self._there.get(channel)))
        ]
        if self._indexed and wrong:
            channels = ", ".join(map(str, sorted(wrong)[:_SHOWN]))
            problems.add(Kind.index, f"behind the chunk at byte {begin}, for channel {channels}")


def _sorted(flat: array[int] | None) -> NDArray[np.uint64]:
    # pairs in order, shape [message, 2]
    pairs = np.frombuffer(flat, np.uint64).reshape(-1, 2) if flat else np.empty((0, 2), np.uint64)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
