"""Copies of recordings with their states packed, and the way back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.read.copying import Change, Copier, records_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.blocks import pack_state, unpack_state
from gpusimbench.schemas.errors import DamagedRecording, DataLost
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.writing import new_file


@dataclass(frozen=True)
class Copied:
    """A copy that was checked against what it was made from.

    source, path     of the files
    bytes_before     size of the source [byte]
    bytes_after      size of the copy [byte]
    content_hash     of both
    """

    source: Path
    path: Path
    bytes_before: int
    bytes_after: int
    content_hash: str


def pack(source: Path, path: Path, *, level: int) -> Copied:
    """A copy with every block of states packed, at a level of Zstandard, and chunks compressed.

    The source is verified first. The copy gets its name once it was read back and has the same content hash.
    Raises UsageError where the name is taken, DataLost for a recording without an end, DamagedRecording.
    """
    return _copy(source, path, lambda data: pack_state(data, level=level), compression="zstd")


def unpack(source: Path, path: Path) -> Copied:
    """A copy with every block of states and actions as the array that it is, chunks not compressed; checked as in
    `pack`. Versions that know no packed states and no generated actions read it."""
    return _copy(source, path, unpack_state, compression="none", draw=True)


def _copy(source: Path, path: Path, change: Change, *, compression: str, draw: bool = False) -> Copied:
    recording = Recording(source)
    if not recording.content_hash:
        raise DataLost(_without_end(Container(source)))
    verify(recording)
    with new_file(path) as target:
        copier = Copier(target, source, compression=compression, change=change, draw=draw)
        for record, _, _ in records_of(source):
            copier.add(record)
        copier.finish()
        copy = Recording(target.path)
        verify(copy)
        if copy.content_hash != recording.content_hash:
            raise DamagedRecording(f"{source}: its copy has another content hash, {copy.content_hash}; it is not kept")
        size = target.path.stat().st_size
    return Copied(source, path, source.stat().st_size, size, recording.content_hash)


def _without_end(container: Container) -> str:
    if container.finished:
        return f"{container.path} has no end record, so nothing says what a copy of it has to hold; share it as it is"
    return f"{container.path} was cut short: gsb-share recover makes a whole file of what is there"
