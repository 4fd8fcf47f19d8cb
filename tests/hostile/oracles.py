"""One file read in four ways that must agree: mapped, in parts as one elsewhere, by the MCAP library, by gsb-check.

A mapped file is walked, one elsewhere is opened through its summary, gsb-check walks it in the strict mode, and the
library shares no code with any of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Message
from mcap.stream_reader import StreamReader

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.location import Location
from gpusimbench.schemas.source import Source
from tests.hostile.reading import in_time, parts, seen

SECONDS = 10.0
"""No small file may take more CPU time in any of the ways."""

BYTES = 512 << 20
"""Nor may one of them make the process grow by more."""


class Parts(Source):
    """Bytes as a file elsewhere."""

    near = False
    workers = 1

    def __init__(self, data: bytes) -> None:
        self.place = Location("memory://fuzzed.mcap")
        self.size = len(data)
        self._data = data

    def read(self, begin: int, end: int) -> memoryview:
        """See Source.read; a copy, as a server's answer is."""
        if not 0 <= begin <= end <= self.size:
            raise AssertionError(f"bytes {begin} to {end} of {self.size} were asked for")
        return memoryview(self._data[begin:end])

    def confirm(self) -> None:
        """See Source.confirm."""


@dataclass(frozen=True)
class Outcome:
    """What came of reading a file: why it was refused, or what is in it, by name."""

    refused: str
    status: str
    content: dict[str, str]


def _read(recording: Recording) -> Outcome:
    verify(recording)
    return Outcome("", recording.status, seen(recording))


def _outcome(path: Path, source: Source | None = None) -> Outcome:
    try:
        recording = Recording(source.place if source is not None else path, source)
        for read in parts(recording).values():  # each of them, though others are damaged
            with contextlib.suppress(GsbError):
                read()
        return _read(recording)
    except GsbError as error:
        return Outcome(str(error), "", {})


def _by_library(path: Path) -> dict[str, str]:
    # digests of the messages of each topic, in the order of their numbers, and of each attachment
    found: dict[str, list[tuple[int, bytes]]] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                found.setdefault(topics[record.channel_id], []).append((record.sequence, record.data))
            elif isinstance(record, Attachment):
                found.setdefault(f"attachment {record.name}", []).append((0, record.data))
    return {name: _digest(data for _, data in sorted(messages)) for name, messages in found.items()}


def _by_us(recording: Recording) -> dict[str, str]:
    container = recording._container
    found = {}
    for topic in container.channels:
        read = (container.read(message) for message in container.messages(topic))
        found[topic] = _digest(data for _, data in sorted((number, bytes(content)) for number, content in read))
    empty = _digest(())
    attachments = {f"attachment {n}": _digest([container.attachment(n) or b""]) for n in container.attachment_names()}
    return {name: digest for name, digest in found.items() if digest != empty} | attachments


def _digest(contents: object) -> str:
    digest = hashlib.sha256()
    for content in contents:  # type: ignore[attr-defined]
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()


def disagreement(path: Path, *, thorough: bool = True) -> str:
    """What is wrong with how a file is read, in a line that begins with its kind; empty where nothing is.

    thorough  False asks gsb-check only about files that somebody read

    Raises what a reader raises that is no GsbError.
    """
    began, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with _no_warnings(), in_time():
        what = _disagreement(path, thorough=thorough)
    if (took := time.process_time() - began) > SECONDS:
        return f"slow: {took:.0f} s"
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) << 10
    return what or (f"large: {grown >> 20} MiB" if grown > BYTES else "")


@contextlib.contextmanager
def _no_warnings() -> Iterator[None]:
    disabled = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(disabled)


def _disagreement(path: Path, *, thorough: bool) -> str:
    near, far = _outcome(path), _outcome(path, Parts(path.read_bytes()))
    if not near.refused and not far.refused:
        differing = sorted(n for n in near.content | far.content if near.content.get(n) != far.content.get(n))
        if differing or near.status != far.status:
            return f"content: {near.status} here, {far.status} elsewhere, other {', '.join(differing)}"
    if near.refused and not far.refused:
        return f"laxer elsewhere: refused here: {near.refused}"
    if near.refused and far.refused and not thorough:
        return ""
    examined = examine(path)
    sound = not examined.problems.kinds()
    if sound and (near.refused or far.refused):
        return f"sound: gsb-check finds nothing: here {near.refused or 'read'}; elsewhere {far.refused or 'read'}"
    if near.refused or near.status == "incomplete":
        return ""
    try:
        by_library = _by_library(path)
    except Exception as error:
        return f"library: read here, not by it: {type(error).__name__}: {error}" if sound else ""
    by_us = _by_us(Recording(path))
    differing = sorted(n for n in by_library | by_us if by_library.get(n) != by_us.get(n))
    return f"library: other {', '.join(differing)[:200]}" if differing else ""
