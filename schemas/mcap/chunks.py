"""The chunks of a file, opened: checked, decompressed where they are compressed, the last few kept."""

from __future__ import annotations

import zlib
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from gpusimbench.schemas.errors import DamagedRecording, FailedCrc
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap import decompression
from gpusimbench.schemas.mcap.records import RECORD_HEAD, Chunk, ChunkHead, Cursor, Op, check_head
from gpusimbench.schemas.source import Source

_CACHED_CHUNKS = 4
_CACHED_BYTES = 64 << 20  # of chunks that are in memory; the one read last is kept whatever it takes


class Chunks:
    """The chunks of one file, by number in the order of the file; several threads may open them."""

    def __init__(self, place: Place, source: Source) -> None:
        self._place = place
        self._source = source
        self._all: list[Chunk] = []
        self._lock = Lock()
        self._opened: OrderedDict[int, tuple[memoryview, int]] = OrderedDict()
        self._checked = False  # by the caller

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, number: int) -> Chunk:
        return self._all[number]

    def __iter__(self) -> Iterator[Chunk]:
        return iter(self._all)

    def append(self, chunk: Chunk) -> None:
        """Add the next one."""
        self._all.append(chunk)

    def forget(self) -> None:
        """Keep none that is opened."""
        with self._lock:
            self._opened.clear()

    @contextmanager
    def checked(self) -> Iterator[None]:
        """No CRC of a file of this machine is computed within the block: all were checked before, and the caller holds
        digests of what it reads against others."""
        self._checked = self._source.near
        try:
            yield
        finally:
            self._checked = False

    def open(self, number: int) -> tuple[memoryview, int]:
        """The content of a chunk, and the CRC-32 that it has; zero where the writer computed none, or where that was
        found by an earlier call: bytes of a mapping may have been changed since.

        DamagedRecording where it is not what its record says, or the record not what is known of it.
        """
        with self._lock:
            if number in self._opened:
                self._opened.move_to_end(number)
                return self._opened[number]
        chunk = self._all[number]
        begin = chunk.at
        if not self._source.near and chunk.end - chunk.begin > decompression.MAX_BYTES:
            raise DamagedRecording(
                f"{self._place}: the chunk at byte {begin} has {chunk.end - chunk.begin} bytes, more than the "
                f"{decompression.MAX_BYTES} that are read from elsewhere; download it"
            )
        record = self._source.read(begin, chunk.end)
        check_head(self._place, Op.CHUNK, record, chunk.end - chunk.record)
        head = ChunkHead.read(Cursor(self._place, record, RECORD_HEAD, len(record), begin))
        crc = head.crc
        if head.chunk != chunk:
            raise DamagedRecording(f"{self._place}: the chunk at byte {begin} is not what the file's index says")
        stored = record[chunk.begin - begin : chunk.end - begin]
        try:
            data = decompression.decompress(chunk.compression, stored, chunk.uncompressed_size)
        except ValueError as error:
            self._source.confirm()
            # what is compressed by another method may be as it was written
            wrong = FailedCrc if decompression.known(chunk.compression) else DamagedRecording
            raise wrong(f"{self._place}: the chunk at byte {begin} is damaged: {error}") from None
        if crc and not self._checked and zlib.crc32(data) != crc:
            self._source.confirm()
            raise FailedCrc(f"{self._place}: the chunk at byte {begin} fails its CRC")
        mapped = self._source.near and not chunk.compression
        self._keep(number, data, 0 if mapped else crc)
        return data, crc

    def _keep(self, number: int, data: memoryview, crc: int) -> None:
        with self._lock:
            self._opened[number] = data, crc
            kept = sum(map(self._cost, self._opened))
            while len(self._opened) > 1 and (kept > _CACHED_BYTES or len(self._opened) > _CACHED_CHUNKS):
                oldest = next(iter(self._opened))
                kept -= self._cost(oldest)
                del self._opened[oldest]

    def _cost(self, number: int) -> int:
        # memory that an opened chunk takes
        return 0 if self._source.near and not self._all[number].compression else len(self._opened[number][0])
