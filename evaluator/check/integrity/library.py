"""Whether the MCAP library reads the file, and finds in it what we find."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Attachment, Message
from mcap.stream_reader import StreamReader

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.scan import Scan


def check_library(path: Path, scan: Scan, problems: Problems) -> None:
    """Read the whole file with the library, its CRC checks on.

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
