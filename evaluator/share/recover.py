"""What is whole in a file that was cut short, as a file that every MCAP reader opens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.read.copying import Copier, records_of
from gpusimbench.evaluator.read.described import unconfirmed
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import DamagedRecording, RecordingError, UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.records import MAGIC, Op
from gpusimbench.schemas.writing import new_file


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
