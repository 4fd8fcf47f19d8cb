"""One file, examined: every check in turn, each as far as the file lets it come."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Attachment, Message
from mcap.stream_reader import StreamReader

from gpusimbench.evaluator.check.integrity.content import check_content, check_summary, read_end
from gpusimbench.evaluator.check.integrity.problem import OF_STREAMS, WHOLE_CONTENT, Kind, Problems, without_path
from gpusimbench.evaluator.check.integrity.scan import Scan, Stream, scan
from gpusimbench.evaluator.check.integrity.streams import check_streams
from gpusimbench.evaluator.check.integrity.view import check_view
from gpusimbench.evaluator.read.addresses import fetched
from gpusimbench.evaluator.read.described import Described, unconfirmed
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, state_header_in
from gpusimbench.schemas.checks import Budget
from gpusimbench.schemas.errors import NotARecording, RecordingError, Unreachable
from gpusimbench.schemas.location import Location, Place, place
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION, Provenance, Simulation
from gpusimbench.schemas.source import MappedFile


@dataclass(frozen=True)
class Integrity:
    """One file, examined.

    path        of the file
    problems    that were found
    recording   opened, or what remains of it; None where it cannot be opened, and `not_opened` says why
    scan        what a walk over the file's records found; None where it is no MCAP file
    provenance  None where it cannot be read; also of a file that cannot be opened otherwise
    simulation  the same
    end         the end record, None without exactly one
    complete    whether the digests and all that needs the whole content were looked at
    """

    path: Place
    problems: Problems
    recording: Described | None
    not_opened: str
    scan: Scan | None
    provenance: Provenance | None
    simulation: Simulation | None
    end: Any
    complete: bool

    def of(self, kind: Kind) -> tuple[str, ...]:
        """Problems of one kind, one sentence each."""
        return self.problems.of(kind)

    def doubtful(self, name: str) -> bool:
        """Whether an attachment is not what was recorded."""
        return self.scan is not None and name in self.scan.doubtful


def examine(path: str | Place, *, verify: bool = True) -> Integrity:
    """Look at a whole file and note everything that is wrong with it; nothing is raised for what a file holds.

    A file elsewhere is copied for it, since all of it is read more than once.

    verify  False leaves out the digests, the library and the comparison of streams; and of a file elsewhere everything
            but what its summary says and what is read because of that
    """
    given = place(path)
    if not isinstance(given, Location):
        return _examine(given, given, verify=verify)
    try:
        if not verify:
            return _examine_index(given)
        with fetched(given) as copy:
            return _examine(copy, given, verify=True)
    except (NotARecording, Unreachable) as error:
        return _nothing(given, error)


def _examine_index(location: Location) -> Integrity:
    problems = Problems()
    try:
        container = Container(location)
        recording = Recording(location, container.source)
        found = _outline(container)
    except (NotARecording, Unreachable):
        raise
    except RecordingError as error:
        problems.add(Kind.record, without_path(error, location))
        problems.skip(str(error), *(kind for kind in Kind if kind is not Kind.record))
        return Integrity(location, problems, None, str(error), None, None, None, None, complete=False)
    end = _end_of(location, found, problems)
    problems.skip("the file is at an address and was not read as a whole", *(set(Kind) - {Kind.end, Kind.unconfirmed}))
    return Integrity(
        location, problems, recording, "", found, recording.provenance, recording.simulation, end, complete=False
    )


def _examine(path: Path, named: Place, *, verify: bool) -> Integrity:
    # `path` is where the bytes are, and `named` whose they are
    problems = Problems()
    recording, not_opened = None, ""
    try:
        source = MappedFile(path, named)
        recording = Recording(named, source)
    except NotARecording as error:
        return _nothing(named, error)
    except RecordingError as error:
        not_opened = without_path(error, named)
    found = scan(source, problems)
    end = _end_of(named, found, problems)
    budget = Budget()
    provenance = _attached(Provenance, recording and recording.provenance, found, PROVENANCE, problems, budget)
    if provenance is None:
        problems.add(
            Kind.not_a_recording, f"{PROVENANCE} is not there or cannot be read: nothing can be said of the run"
        )
    simulation = _attached(Simulation, recording and recording.simulation, found, SIMULATION, problems, budget)
    if not found.finished:
        problems.skip("the file does not end as it should", Kind.data_crc, Kind.summary, Kind.summary_crc, Kind.library)
    if end is None:
        problems.skip("there is no end record", Kind.digest, Kind.content_hash)
    if not verify:
        problems.skip("nothing was verified", *WHOLE_CONTENT)
    else:
        check_summary(source, found, problems)
        structural = {Kind.record, Kind.cut_short, Kind.chunk_crc, Kind.index}
        if structural.intersection(problems.kinds()):
            problems.skip("the library takes a file at its word, and this one is not sound", Kind.library)
        else:
            _check_library(path, found, problems)
        if recording is not None:
            check_streams(recording, problems)
            with problems.noting(Kind.view, path=named):
                check_view(path, recording, found, problems)
        else:
            problems.skip(not_opened, *OF_STREAMS)
        with problems.noting(Kind.stream, Kind.digest, Kind.content_hash, Kind.state_hash, path=path):
            check_content(path, provenance, simulation, found, end, problems)
    if recording is None and not problems.kinds():
        problems.add(Kind.stream, not_opened)
    found.close()  # many files are examined before any of them is reported
    return Integrity(named, problems, recording, not_opened, found, provenance, simulation, end, complete=verify)


def _end_of(named: Place, found: Scan, problems: Problems) -> Any:
    end = read_end(found, problems)
    if end is not None and (why := unconfirmed(named)):
        problems.add(Kind.unconfirmed, why)
    return end


def _outline(container: Container) -> Scan:
    """What a file's own summary says is in it, as a scan would, as far as facts of a recording ask for it.

    A stream's encodings are those of its last block alone; its sequences are not looked at.
    """
    found = Scan(container.size, library=container.library, finished=container.finished)
    for chunk in container.chunks:
        found.compressions[chunk.compression] = found.compressions.get(chunk.compression, 0) + 1
        found.stored += chunk.end - chunk.begin
        found.unpacked += chunk.uncompressed_size
    for topic, channel in container.channels.items():
        stream = Stream(topic, channel.message, bytes=container.stored_bytes(topic))
        found.streams[topic] = stream
        if topics.parse_state(topic) is not None and (messages := container.messages(topic)):
            size, head = container.peek(messages[-1], STATE_HEAD_BYTES)
            header = state_header_in(head, size)
            stream.encodings = set() if header is None else {header.encoding}
    found.attachments = {name: memoryview(container.attachment(name) or b"") for name in container.attachment_names()}
    found.ends = [bytes(content) for content in container.in_sequence(topics.RUN_END)]
    return found


def _check_library(path: Path, scan: Scan, problems: Problems) -> None:
    """Whether the MCAP library, its CRC checks on, finds the same in the whole file.

    Only for a file whose records, chunks and sizes are sound: the library takes a file at its word.
    """
    messages = attachments = 0
    try:
        with path.open("rb") as stream:
            for record in StreamReader(stream, validate_crcs=True, record_size_limit=scan.size).records:
                messages += isinstance(record, Message)
                attachments += isinstance(record, Attachment)
        with path.open("rb") as stream:
            make_reader(stream).get_summary()
    except Exception as error:  # whatever its parts raise
        problems.add(Kind.library, f"it does not read the file: {str(error) or type(error).__name__}")
        return
    there = sum(scan.counts.values())
    if (messages, attachments) != (there, len(scan.attachments)):
        problems.add(
            Kind.library,
            f"it finds {messages} messages and {attachments} attachments, there are {there} and "
            f"{len(scan.attachments)}",
        )


def _nothing(path: Place, error: RecordingError) -> Integrity:
    problems = Problems()
    problems.add(Kind.not_a_recording, str(error))
    problems.skip(str(error), *Kind)
    return Integrity(path, problems, None, str(error), None, None, None, None, complete=False)


def _attached(kind: Any, parsed: Any, found: Scan, name: str, problems: Problems, budget: Budget) -> Any:
    # what the recording could parse is not parsed again: it may be large
    if parsed is None and name in found.attachments:
        with problems.noting(Kind.stream):
            parsed = kind.from_json(bytes(found.attachments[name]), budget)
    return parsed
