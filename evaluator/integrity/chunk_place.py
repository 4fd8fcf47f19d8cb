"""Where the messages of a chunk are, and where the indexes behind it say that they are."""

from __future__ import annotations

from mcap import records

from evaluator.integrity.problem import Kind, Problems
from evaluator.integrity.records import Record, parse

_SHOWN = 3


class ChunkPlace:
    """One chunk: its own entry for an index of chunks, its messages, and the message indexes that follow it.

    entry  what the summary has to say of it; grows with the message indexes
    """

    def __init__(self, entry: records.ChunkIndex) -> None:
        self.entry = entry
        self._there: dict[int, list[tuple[int, int]]] = {}  # time and place of messages, by channel
        self._indexed: dict[int, list[tuple[int, int]]] = {}

    def add_message(self, channel: int, log_time: int, position: int) -> None:
        """A message of the chunk, and where in it that begins."""
        self._there.setdefault(channel, []).append((log_time, position))

    def add_index(self, record: Record) -> None:
        """A message index that follows the chunk; DamagedRecording where it cannot be read."""
        index = parse(records.MessageIndex, record.content)
        self._indexed.setdefault(index.channel_id, []).extend(index.records)
        self.entry.message_index_offsets[index.channel_id] = record.begin
        self.entry.message_index_length += record.length

    def check(self, problems: Problems) -> None:
        """Compare messages and indexes; a chunk without any index is whole."""
        begin = self.entry.chunk_start_offset
        times = [time for found in self._there.values() for time, _ in found]
        if times and (min(times), max(times)) != (self.entry.message_start_time, self.entry.message_end_time):
            problems.add(Kind.index, f"the chunk at byte {begin} says other times than its messages")
        wrong = [
            channel
            for channel in self._indexed.keys() | self._there.keys()
            if sorted(self._indexed.get(channel, [])) != sorted(self._there.get(channel, []))
        ]
        if self._indexed and wrong:
            channels = ", ".join(map(str, sorted(wrong)[:_SHOWN]))
            problems.add(Kind.index, f"behind the chunk at byte {begin}, for channel {channels}")
