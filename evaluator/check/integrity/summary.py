"""What stands behind the data section, held against it: many readers look at nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.schemas.mcap.declarations import Declarations
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
from gpusimbench.schemas.source import Source

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
