"""What the end of a file claims, held against the content: the end record, and the summary behind the data section, for
many readers look at nothing else."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems, without_path
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.evaluator.read.actions import ActionContents
from gpusimbench.evaluator.read.messages import MAX_END_BYTES, Messages
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.read.streams import Fingerprints, read_fingerprints
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.digest import ContentDigest, attachment_name, content_hash, state_name
from gpusimbench.schemas.errors import RecordingError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mcap.declarations import Declarations
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.records import (
    AttachmentIndex,
    ChannelRecord,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Op,
    Schema,
    Statistics,
    parse,
)
from gpusimbench.schemas.mcap.walk import data_crc
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import Provenance, Simulation
from gpusimbench.schemas.source import Source
from gpusimbench.schemas.text import few

_READ_BYTES = 64 << 20
_READ_ROWS = 50  # a block's rows, so that few are decoded twice
_SHOWN = 3
_STATE = "state "
"""What the names of the digests of states begin with."""

_KINDS: dict[int, type[Any]] = {
    Op.SCHEMA: Schema,
    Op.CHANNEL: ChannelRecord,
    Op.STATISTICS: Statistics,
    Op.CHUNK_INDEX: ChunkIndex,
    Op.ATTACHMENT_INDEX: AttachmentIndex,
    Op.METADATA_INDEX: MetadataIndex,
    Op.FOOTER: Footer,
}

_CRC = 4


def read_end(scan: Scan, problems: Problems) -> Any:
    """The end record; None where there is not exactly one that can be read."""
    if len(scan.ends) != 1:
        what = "no end record: the run's process died, or the file was cut short"
        problems.add(Kind.end, f"the run ends {len(scan.ends)} times" if scan.ends else what)
        return None
    if len(scan.ends[0]) > MAX_END_BYTES:
        problems.add(Kind.end, f"the end record has {len(scan.ends[0])} bytes; at most {MAX_END_BYTES} are read")
        return None
    try:
        return message_class("gsb.v1.RunEnd").FromString(scan.ends[0])
    except Exception as error:  # protobuf's DecodeError differs between its backends
        problems.add(Kind.end, f"the end record cannot be parsed: {error}")
        return None


def check_content(
    path: Path, provenance: Provenance | None, simulation: Simulation | None, scan: Scan, end: Any, problems: Problems
) -> None:
    """Recompute every digest that can be; hold state hashes against the states.

    provenance, simulation  None where they cannot be read; what the states are is then not known
    end                     None where nothing claims a digest; the states that are there still have hashes
    """
    if end is None:
        _check_states_alone(path, provenance, simulation, problems)
        return
    claimed = dict(end.digests)
    found = {attachment_name(name): hashlib.sha256(data).hexdigest() for name, data in scan.attachments.items()}
    scan.doubtful.update(
        name for name in scan.attachments if found[attachment_name(name)] != claimed.get(attachment_name(name))
    )
    found |= scan.digest.digests()
    lost: dict[str, str] = {}
    try:
        container = Container(path)
    except RecordingError as error:
        reason = without_path(error, path)
        states = [name for name in claimed if name.startswith(_STATE)]
        moved = [s.topic for s in scan.streams.values() if s.generated or not s.in_order]
        lost = dict.fromkeys([*states, *moved], reason)
        problems.skip(reason, Kind.state_hash)
    else:
        found |= _reordered(container, scan, lost)
        if provenance is not None and simulation is not None:
            found |= _states(container, provenance.configuration, simulation.fields, lost, problems, ended=True)
        else:
            lost |= {name: "nothing says what they are" for name in claimed if name.startswith(_STATE)}
            if topics.fingerprint("capture") in scan.streams:
                problems.skip("nothing says what the states are that the hashes are of", Kind.state_hash)
    if named := sorted(lost):
        problems.add(Kind.digest, f"not checked, since it cannot be read: {few(named, _SHOWN)}: {lost[named[0]]}")
        if states := [name for name in named if name.startswith(_STATE)]:
            problems.skip(lost[states[0]], Kind.state_hash)
    for name in sorted((claimed.keys() | found.keys()) - lost.keys()):
        if claimed.get(name) != found.get(name):
            what = "is missing" if name not in found else "was added" if name not in claimed else "was changed"
            problems.add(Kind.digest, f"{name} {what} since the recording was made")
    names = {number: name for name, number in enum_values("gsb.v1.RunStatus").items()}
    status = names.get(end.status, "").removeprefix("RUN_STATUS_").lower()
    if content_hash(claimed, status, end.reason) != end.content_hash:
        problems.add(Kind.content_hash, "the end record was changed since the recording was made")


def _check_states_alone(
    path: Path, provenance: Provenance | None, simulation: Simulation | None, problems: Problems
) -> None:
    if provenance is None:
        problems.skip("nothing says what the states are", Kind.state_hash)
        return
    container = Container(path)
    lost: dict[str, str] = {}
    _states(container, provenance.configuration, simulation.fields if simulation else (), lost, problems, ended=False)
    for name, reason in lost.items():
        problems.add(Kind.stream, f"{name} cannot be read: {reason}")
        problems.skip(reason, Kind.state_hash)


def _reordered(container: Container, scan: Scan, lost: dict[str, str]) -> dict[str, str]:
    # another tool may have written messages in another order; a digest follows their numbers, and is of drawn actions
    found: dict[str, str] = {}
    actions = ActionContents(container)
    for topic, stream in scan.streams.items():
        if (stream.in_order and not stream.generated) or not topics.has_digest(topic):
            continue
        digest = ContentDigest()
        try:
            if stream.generated:
                actions.digest(topic, digest)
            else:
                for content in container.in_sequence(topic):
                    digest.message(topic, content)
        except RecordingError as error:
            lost[topic] = without_path(error, container.path).removeprefix(f"{topic}: ")
        else:
            found |= digest.digests()
    return found


def _states(
    container: Container, configuration: RunConfiguration, fields: Sequence[StateField], lost: dict[str, str],
    problems: Problems, *, ended: bool,
) -> dict[str, str]:  # fmt: skip
    # digests by name; what cannot be read is added to `lost`. `ended`: nothing was cut off
    stated = {(p.group, p.field) for p in map(topics.parse_state, container.channels) if p}
    arrays: dict[str, StateArray] = {}
    for field in fields:
        if (field.group, field.field) in stated:
            try:
                arrays[state_name(field)] = StateArray(container, configuration, field)
            except RecordingError as error:
                lost[state_name(field)] = without_path(error, container.path)
    if ended and len({len(array) for array in arrays.values()}) > 1:
        problems.add(Kind.stream, "the state fields have different numbers of rows")
        problems.skip("the state fields have different numbers of rows", Kind.state_hash)
    hashes = _hashes(container, configuration, problems)
    missing = [f.name for f in fields if state_name(f) not in lost and not len(arrays.get(state_name(f), ()))]
    if configuration.keep and len(missing) == len(fields):
        return {}  # hashes are of the first step and the last, and no states were kept
    if hashes is not None and missing:
        told = few(missing, _SHOWN)
        problems.skip(f"hashes are of all fields, and states of {told} are not there", Kind.state_hash)
    elif hashes is not None and not fields:
        problems.skip("nothing says what the states are that the hashes are of", Kind.state_hash)
    digests = {name: ContentDigest() for name in arrays}
    for rows in _ranges(list(arrays.values())):
        blocks, steps = [], []
        for name, array in arrays.items():
            if name in lost:
                continue
            try:
                block = array.read(rows, slice(None))
            except RecordingError as error:
                lost[name] = without_path(error, container.path)
                continue
            digests[name].state(array.field, configuration.n_env, block)
            blocks.append(block)
            steps.append(array.steps[rows])
        if hashes is not None and len(blocks) == len(fields):
            _compare(hashes, blocks, steps, problems)
    return {name: digest for name, d in digests.items() if name not in lost for digest in d.digests().values()}


def _hashes(container: Container, configuration: RunConfiguration, problems: Problems) -> Fingerprints | None:
    try:
        return read_fingerprints(Messages(container), "capture", n_env=configuration.n_env, cut_short=True)
    except RecordingError as error:  # told as a stream that cannot be read
        problems.skip(without_path(error, container.path), Kind.state_hash)
        return None


def _compare(hashes: Fingerprints, blocks: Sequence[Any], steps: Sequence[Any], problems: Problems) -> None:
    import numpy as np

    rows = min(map(len, steps))  # a run that was cut short may have a row more of some fields than of others
    common = steps[0][:rows]
    if any((other[:rows] != common).any() for other in steps):
        problems.skip("the state fields are of different steps", Kind.state_hash)
        return
    computed = fingerprint([block[:rows] for block in blocks])
    _, at_recorded, at_computed = np.intersect1d(hashes.steps, common, return_indices=True)
    wrong = (hashes.hashes[at_recorded] != computed[at_computed]).any(axis=1)
    for step in common[at_computed[wrong]]:
        problems.add(Kind.state_hash, f"at step {step}")


def _ranges(arrays: Sequence[StateArray]) -> Iterator[slice]:
    # rows that fit into memory together; the initial state is a block of its own
    if not arrays:
        return
    row = sum(math.prod(array.shape[1:]) * array.dtype.itemsize for array in arrays)
    count = max(1, min(_READ_ROWS, _READ_BYTES // max(row, 1)))
    last = max(len(array) for array in arrays)
    if last:
        yield slice(0, 1)
    for begin in range(1, last, count):
        yield slice(begin, begin + count)


def check_summary(source: Source, scan: Scan, problems: Problems) -> None:
    """Compare the summary with what the data section holds; a file without a summary is whole."""
    if not scan.finished:
        return
    found: dict[int, list[Any]] = {}
    for record in scan.summary:
        if record.opcode == Op.SUMMARY_OFFSET:
            continue
        if record.opcode not in _KINDS:
            problems.add(Kind.record, f"a record of type {record.opcode} lies behind the data section's end")
            continue
        with problems.noting(Kind.summary, path=source.place):
            found.setdefault(record.opcode, []).append(parse(_KINDS[record.opcode], record.cursor(source.place)))
    with problems.noting(Kind.summary, path=source.place):
        if found.get(Op.FOOTER):
            _check_crc(source, scan, found[Op.FOOTER][0], problems)
        _check_declarations(source, scan)
    _check_declared(scan, found, problems)
    _check_places(scan, found, problems)
    if found.get(Op.STATISTICS):
        _check_statistics(scan, found, problems)


def _check_crc(source: Source, scan: Scan, footer: Footer, problems: Problems) -> None:
    summary = scan.summary
    end = summary[-1].end - _CRC
    begin = footer.summary_start or summary[-1].begin
    if begin != summary[0].begin:
        problems.add(Kind.summary, f"the footer says that it begins at byte {begin}, it does at {summary[0].begin}")
        return
    if not footer.summary_crc:
        problems.add(Kind.crc_missing, "the summary has no CRC")
    elif data_crc(source, begin, end) != footer.summary_crc:
        problems.add(Kind.summary_crc, "bytes behind the data section were changed")


def _check_declarations(source: Source, scan: Scan) -> None:
    # as the readers do, who refuse a summary that contradicts itself
    declared = Declarations(source.place)
    for record in scan.summary:
        if record.opcode in (Op.SCHEMA, Op.CHANNEL):
            declared.take(record)


def _check_declared(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    for opcode, declared, what in (
        (Op.SCHEMA, scan.schemas, "schema"),
        (Op.CHANNEL, scan.channels, "channel"),
    ):
        said = {record.id: record for record in found.get(opcode, [])}
        for number, record in declared.items() if said else ():
            if number not in said:
                problems.add(Kind.summary, f"{what} {number} is not in it")
            elif said[number] != record:
                problems.add(Kind.summary, f"{what} {number} is another one than in the data section")
        for number in said.keys() - declared.keys():
            problems.add(Kind.summary, f"{what} {number} is not in the data section")


def _check_places(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    there: dict[int, tuple[str, Mapping[int, Any]]] = {
        Op.CHUNK_INDEX: ("chunks", scan.chunks),
        Op.ATTACHMENT_INDEX: ("attachments", scan.attached),
        Op.METADATA_INDEX: ("metadata records", scan.metadata),
    }
    for opcode, (what, expected) in there.items():
        listed = found.get(opcode, [])
        said = {record.start: record for record in listed}
        if len(said) < len(listed):
            problems.add(Kind.summary, f"its index of {what} lists {len(listed) - len(said)} of them again")
        if said and said != expected:
            wrong = sum(said.get(start) != expected.get(start) for start in said.keys() | expected.keys())
            problems.add(Kind.summary, f"its index of {what} is wrong for {wrong} of them")


def _check_statistics(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    said = found[Op.STATISTICS][0]
    declared = {channel.id for channel in found.get(Op.CHANNEL, [])}
    there = {
        "messages": (said.messages, sum(scan.counts.values())),
        "channels": (said.channels, len(scan.channels.keys() | declared)),
        "attachments": (said.attachments, len(scan.attached)),
        "metadata records": (said.metadata, scan.metadata_records),
        "chunks": (said.chunks, len(scan.chunks)),
        "ns as the first time": (said.first_time, scan.first_time or 0),
        "ns as the last time": (said.last_time, scan.last_time),
    }
    for what, (claimed, counted) in there.items():
        if claimed != counted:
            problems.add(Kind.summary, f"its statistics count {claimed} {what}, there are {counted}")
    if {n: c for n, c in said.by_channel.items() if c} != scan.counts:
        problems.add(Kind.summary, "its statistics count other messages by channel than there are")
