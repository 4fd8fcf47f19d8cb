"""What stands behind the data section, held against it: many readers look at nothing else."""

from __future__ import annotations

import zlib
from typing import Any

from mcap import records
from mcap.opcode import Opcode

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.records import parse
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.schemas.cursor import Cursor
from gpusimbench.schemas.declarations import Declarations
from gpusimbench.schemas.location import Place

_KINDS = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.FOOTER: records.Footer,
}
_CRC = 4


def check_summary(path: Place, scan: Scan, problems: Problems) -> None:
    """Compare the summary with what the data section holds; a file without a summary is whole."""
    if not scan.finished:
        return
    found: dict[int, list[Any]] = {}
    for record in scan.summary:
        if record.opcode not in _KINDS:
            problems.add(Kind.record, f"a record of type {record.opcode} lies behind the data section's end")
            continue
        with problems.noting(Kind.summary):
            found.setdefault(record.opcode, []).append(parse(_KINDS[Opcode(record.opcode)], record.content))
    if found.get(Opcode.FOOTER):
        _check_crc(scan, found[Opcode.FOOTER][0], problems)
    with problems.noting(Kind.summary, path=path):
        _check_declarations(path, scan)
    _check_declared(scan, found, problems)
    _check_places(scan, found, problems)
    if found.get(Opcode.STATISTICS):
        _check_statistics(scan, found, problems)


def _check_crc(scan: Scan, footer: Any, problems: Problems) -> None:
    summary = scan.summary
    end = summary[-1].begin + summary[-1].length - _CRC
    begin = footer.summary_start or summary[-1].begin
    if begin != summary[0].begin:
        problems.add(Kind.summary, f"the footer says that it begins at byte {begin}, it does at {summary[0].begin}")
        return
    if not footer.summary_crc:
        problems.add(Kind.crc_missing, "the summary has no CRC")
    elif zlib.crc32(scan.data[begin:end]) != footer.summary_crc:
        problems.add(Kind.summary_crc, "bytes behind the data section were changed")


def _check_declarations(path: Place, scan: Scan) -> None:
    # as the readers do, who refuse a summary that contradicts itself
    declared = Declarations(path)
    for record in scan.summary:
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            begin = record.begin + record.length - len(record.content)
            declared.take(record.opcode, Cursor(path, record.content, 0, len(record.content), begin))


def _check_declared(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    for opcode, declared, what in (
        (Opcode.SCHEMA, scan.schemas, "schema"),
        (Opcode.CHANNEL, scan.channels, "channel"),
    ):
        said = {record.id: record for record in found.get(opcode, [])}
        for number, record in declared.items() if said else ():
            if number not in said:
                problems.add(Kind.summary, f"{what} {number} is not in it")
            elif said[number] != record:
                problems.add(Kind.summary, f"{what} {number} is another one than in the data section")


def _check_places(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    for opcode, what in (
        (Opcode.CHUNK_INDEX, "chunks"),
        (Opcode.ATTACHMENT_INDEX, "attachments"),
        (Opcode.METADATA_INDEX, "metadata records"),
    ):
        listed = found.get(opcode, [])
        said = {_offset(record): record for record in listed}
        if len(said) < len(listed):
            problems.add(Kind.summary, f"its index of {what} lists {len(listed) - len(said)} of them again")
        there = {_offset(record): record for record in scan.expected.get(opcode, [])}
        if said and said != there:
            wrong = sum(said.get(offset) != there.get(offset) for offset in said.keys() | there.keys())
            problems.add(Kind.summary, f"its index of {what} is wrong for {wrong} of them")


def _offset(record: Any) -> int:
    return int(record.chunk_start_offset if isinstance(record, records.ChunkIndex) else record.offset)


def _check_statistics(scan: Scan, found: dict[int, list[Any]], problems: Problems) -> None:
    said = found[Opcode.STATISTICS][0]
    declared = {channel.id for channel in found.get(Opcode.CHANNEL, [])}
    there = {
        "messages": (said.message_count, sum(scan.counts.values())),
        "channels": (said.channel_count, len(scan.channels.keys() | declared)),
        "attachments": (said.attachment_count, len(scan.expected.get(Opcode.ATTACHMENT_INDEX, []))),
        "metadata records": (said.metadata_count, scan.metadata_records),
        "chunks": (said.chunk_count, len(scan.expected.get(Opcode.CHUNK_INDEX, []))),
        "ns as the first time": (said.message_start_time, scan.first_time or 0),
        "ns as the last time": (said.message_end_time, scan.last_time),
    }
    for what, (claimed, counted) in there.items():
        if claimed != counted:
            problems.add(Kind.summary, f"its statistics count {claimed} {what}, there are {counted}")
    if {n: c for n, c in said.channel_message_counts.items() if c} != scan.counts:
        problems.add(Kind.summary, "its statistics count other messages by channel than there are")
