"""Copies of recordings: with their states packed, and the way back; and of what is whole in a file cut short."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.read.copying import Change, Copier, records_of
from gpusimbench.evaluator.read.described import unconfirmed
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import pack_state, unpack_state
from gpusimbench.schemas.errors import DamagedRecording, DataLost, RecordingError, UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.records import MAGIC, Op
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


@dataclass(frozen=True)
class Stream:
    """What was recovered of a topic, or of all topics of a state field.

    last_step  last step whose state is whole in all environments; None for other streams, and where there is none
    """

    name: str
    messages: int
    last_step: int | None


@dataclass(frozen=True)
class Recovered:
    """A file that was made whole.

    path         of the new file
    status       of the recording: "incomplete", or what its end record says where that was there
    reason       why it is not complete
    streams      in order of appearance
    attachments  their names
    lost_bytes   at the end of the source, that belong to no whole record or lie behind damage
    damage       what ended the reading before the file's end, and what to do; empty where it was cut in the middle of a
                 record
    """

    path: Path
    status: str
    reason: str
    streams: tuple[Stream, ...]
    attachments: tuple[str, ...]
    lost_bytes: int
    damage: str


def recover(source: Path, path: Path) -> Recovered:
    """Everything up to the last whole record or chunk, in its order, finished as an MCAP file.

    No end record is made up: a recording that had none stays incomplete. Where the source had one, and was cut short
    behind it, all of its content is checked against it.

    Raises UsageError where the source is whole or the name is taken; NotARecording or DamagedRecording where nothing
    of it can be read.
    """
    if _is_whole(source):
        copied = "; copy it under its final name, and check the copy" if unconfirmed(source) else ""
        raise UsageError(f"{source} is a whole file; there is nothing to recover{copied}")
    end, damage = len(MAGIC), ""
    with new_file(path) as target:
        copier = Copier(target, source, compression=_compression(source))
        try:
            for record, _, end_of_it in records_of(source):
                copier.add(record)
                end = end_of_it
        except DamagedRecording as error:
            damage = error.advised
        copier.finish()
        try:
            made = Recording(target.path)
            verify(made)
        except RecordingError as error:
            kind = type(error) if isinstance(error, DamagedRecording) else DamagedRecording
            raise kind(str(error).replace(str(target.path), str(source))) from None
        found = Container(target.path)
        streams, attachments = _streams(made, found), tuple(found.attachment_names())
    return Recovered(path, made.status, made.reason, streams, attachments, source.stat().st_size - end, damage)


def _is_whole(source: Path) -> bool:
    try:
        container = Container(source)
        container.verify()
    except DamagedRecording:
        return False
    return container.finished


def _compression(source: Path) -> str:
    # that of the first chunk, so that the file stays as large as it was
    try:
        found = next((compression for record, compression, _ in records_of(source) if record.opcode == Op.MESSAGE), "")
    except DamagedRecording:
        return "none"
    return found or "none"


def _streams(recording: Recording, container: Container) -> tuple[Stream, ...]:
    counts: dict[str, int] = {}
    for topic in container.channels:
        parts = topics.parse_state(topic)
        name = f"state {parts.group}/{parts.field}" if parts else topic
        counts[name] = counts.get(name, 0) + len(container.messages(topic))
    last = {}
    for field in recording.fields:
        array = recording.state(field.group, field.field)
        last[f"state {field.name}"] = int(array.steps[-1]) if len(array) else None
    return tuple(Stream(name, count, last.get(name)) for name, count in counts.items())
