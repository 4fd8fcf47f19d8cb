"""Ways to spoil a recording, each with what must come of it.

A mutator takes a random generator and the good recordings, and returns a Mutant. The same generator gives the same
mutant.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from random import Random

import lz4.frame
import zstandard

from tests.hostile import records as mcap
from tests.hostile.contents import hostile_json, hostile_protobuf, other_end, with_right_digests
from tests.hostile.records import Attachment, Chunk, File, Item, Message, Record


class Promise(Enum):
    """What must come of a mutant, besides nothing but errors of ours, in bounded time and memory."""

    NOTICED = auto()
    """It is refused, or reads as incomplete, or every number and word in it is the original's."""

    SAME = auto()
    """It is no change of content: it must be accepted, and every number and word be the original's."""

    BEYOND_THE_HASH = auto()
    """As NOTICED, but for the words of the end record that its hash does not cover."""

    FORGED = auto()
    """The digests were made anew, so that it may say anything; only the manner of failing is promised."""


@dataclass(frozen=True)
class Mutant:
    """A spoiled file.

    original    index of the recording that it was made from
    prefix      nothing but what CRCs notice was done: an incomplete one must hold true states, from the first on
    """

    data: bytes
    original: int
    promise: Promise = Promise.NOTICED
    prefix: bool = False


Corpus = Sequence[bytes]
Mutator = Callable[[Random, Corpus], Mutant]

MUTATORS: dict[str, Mutator] = {}

_LENGTHS_8 = (0, 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
_LENGTHS_4 = (0, 1, 2**31, 2**32 - 1)


def _mutator(function: Mutator) -> Mutator:
    MUTATORS[function.__name__] = function
    return function


def _pick(rng: Random, corpus: Corpus) -> tuple[int, bytes]:
    index = rng.randrange(len(corpus))
    return index, corpus[index]


def _pick_finished(rng: Random, corpus: Corpus) -> tuple[int, File]:
    files = [(i, f) for i, f in enumerate(map(mcap.parse, corpus)) if f.finished]
    return rng.choice(files)


# -- of bytes ----------------------------------------------------------------------------------------------------------


@_mutator
def flipped_bits(rng: Random, corpus: Corpus) -> Mutant:
    """One to four bits, anywhere."""
    index, data = _pick(rng, corpus)
    return Mutant(_flipped(rng, data), index, prefix=True)


@_mutator
def flipped_bits_with_right_crcs(rng: Random, corpus: Corpus) -> Mutant:
    """The same, with CRCs made anew: only the digests are left to notice."""
    index, data = _pick(rng, corpus)
    return Mutant(mcap.with_right_crcs(_flipped(rng, data)), index)


def _flipped(rng: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


@_mutator
def cut_short(rng: Random, corpus: Corpus) -> Mutant:
    """The end is missing, or zeros stand in its place, as after a loss of power."""
    index, data = _pick(rng, corpus)
    keep = rng.randrange(len(data))
    tail = rng.choice((0, 0, rng.randrange(1 << 16)))
    return Mutant(data[:keep] + bytes(tail), index, prefix=True)


@_mutator
def hostile_length(rng: Random, corpus: Corpus) -> Mutant:
    """One length says something else."""
    index, data = _pick(rng, corpus)
    return Mutant(_with_length(rng, data), index, prefix=True)


@_mutator
def hostile_length_with_right_crcs(rng: Random, corpus: Corpus) -> Mutant:
    """The same behind right CRCs."""
    index, data = _pick(rng, corpus)
    return Mutant(mcap.with_right_crcs(_with_length(rng, data)), index)


def _with_length(rng: Random, data: bytes) -> bytes:
    at, width = rng.choice(mcap.lengths(data))
    value = rng.choice(_LENGTHS_8 if width == 8 else _LENGTHS_4)
    return data[:at] + value.to_bytes(width, "little") + data[at + width :]


@_mutator
def spliced_anywhere(rng: Random, corpus: Corpus) -> Mutant:
    """The beginning of one recording and the end of another, or of itself."""
    index, data = _pick(rng, corpus)
    _, other = _pick(rng, corpus)
    return Mutant(data[: rng.randrange(len(data))] + other[rng.randrange(len(other)) :], index)


@_mutator
def followed_by_something(rng: Random, corpus: Corpus) -> Mutant:
    """Bytes behind the end: zeros, noise, another recording."""
    index, data = _pick(rng, corpus)
    tail = rng.choice((bytes(rng.randrange(1, 5000)), rng.randbytes(99), corpus[rng.randrange(len(corpus))]))
    return Mutant(data + tail, index, prefix=True)


# -- of records --------------------------------------------------------------------------------------------------------


def _top_level(rng: Random, data: bytes, other: bytes) -> bytes:
    records = mcap.split(data)
    a, b = sorted(rng.sample(range(len(records)), 2))
    match rng.randrange(6):
        case 0:
            del records[a]
        case 1:
            records.insert(b, records[a])
        case 2:
            records[a], records[b] = records[b], records[a]
        case 3:
            del records[a:b]
        case 4:
            theirs = mcap.split(other)
            records = records[:a] + theirs[rng.randrange(len(theirs)) :]
        case 5:
            records[a] = Record(rng.choice((*range(16), 0x80, 255)), records[a].body)
    return mcap.join(records)


@_mutator
def moved_records(rng: Random, corpus: Corpus) -> Mutant:
    """Records lost, doubled, swapped, renamed, or those of another recording from some record on."""
    index, data = _pick(rng, corpus)
    return Mutant(_top_level(rng, data, _pick(rng, corpus)[1]), index)


@_mutator
def moved_records_with_right_crcs(rng: Random, corpus: Corpus) -> Mutant:
    """The same behind right CRCs."""
    index, data = _pick(rng, corpus)
    return Mutant(mcap.with_right_crcs(_top_level(rng, data, _pick(rng, corpus)[1])), index)


# -- of messages and chunks, in a file that is right in every index and CRC --------------------------------------------


@_mutator
def moved_chunks(rng: Random, corpus: Corpus) -> Mutant:
    """Chunks lost, doubled or swapped."""
    index, file = _pick_finished(rng, corpus)
    items = list(file.items)
    a, b = (rng.choice([i for i, item in enumerate(items) if isinstance(item, Chunk)]) for _ in range(2))
    match rng.randrange(3):
        case 0:
            del items[a]
        case 1:
            items.insert(b, items[a])
        case 2:
            items[a], items[b] = items[b], items[a]
    return Mutant(mcap.assemble(replace(file, items=tuple(items))), index)


@_mutator
def moved_messages(rng: Random, corpus: Corpus) -> Mutant:
    """Messages lost, doubled, swapped, given another topic, time or number, or another's content."""
    index, file = _pick_finished(rng, corpus)
    return Mutant(mcap.assemble(_move(rng, file)), index)


@_mutator
def moved_messages_without_digests(rng: Random, corpus: Corpus) -> Mutant:
    """The same with digests made anew."""
    index, file = _pick_finished(rng, corpus)
    return Mutant(mcap.assemble(with_right_digests(_move(rng, file))), index, Promise.FORGED)


def _move(rng: Random, file: File) -> File:
    found = list(file.records())
    numbers = [i for i, r in enumerate(found) if r.opcode == mcap.MESSAGE]
    for _ in range(rng.choice((1, 1, 3))):
        a, b = rng.choice(numbers), rng.choice(numbers)
        one, two = Message.of(found[a]), Message.of(found[b])
        match rng.randrange(8):
            case 0:
                found[a] = Record(200, b"")
                numbers.remove(a)
            case 1:
                found.insert(len(found), found[a])
            case 2:
                found[a], found[b] = found[b], found[a]
            case 3:
                found[a] = replace(one, channel=rng.choice((two.channel, 77))).record()
            case 4:
                found[a] = replace(one, log_time=rng.choice((0, two.log_time, 2**63, 2**64 - 1))).record()
            case 5:
                found[a] = replace(one, sequence=rng.choice((two.sequence, one.sequence + 1, 2**32 - 1))).record()
            case 6:
                found[a] = replace(one, data=two.data).record()
            case 7:
                found[a] = replace(one, data=one.data[: rng.randrange(len(one.data) + 1)]).record()
    return file.with_records(found)


@_mutator
def moved_attachments(rng: Random, corpus: Corpus) -> Mutant:
    """Attachments of another recording, of another name, lost, or there twice."""
    index, file = _pick_finished(rng, corpus)
    _, theirs = _pick_finished(rng, corpus)
    items: list[Item] = list(file.items)
    at = rng.choice([i for i, item in enumerate(items) if isinstance(item, Attachment)])
    mine = items[at]
    other = rng.choice([item for item in theirs.items if isinstance(item, Attachment)])
    assert isinstance(mine, Attachment)
    match rng.randrange(6):
        case 0:
            items[at] = replace(mine, data=other.data)
        case 1:
            items[at] = replace(mine, name=other.name)
        case 2:
            del items[at]
        case 3:
            items.append(replace(mine, data=other.data))
        case 4:
            items.append(replace(other, name="../../" + other.name))
        case 5:
            same = [o for o in theirs.items if isinstance(o, Attachment) and o.name == mine.name]
            items[at] = rng.choice(same or [other])
    return Mutant(mcap.assemble(replace(file, items=tuple(items))), index)


@_mutator
def renamed_channels(rng: Random, corpus: Corpus) -> Mutant:
    """Topics of other names, numbers declared twice, in the data or in the summary alone."""
    index, file = _pick_finished(rng, corpus)
    names = file.channels()
    a, b = rng.choice(list(names)), rng.choice(list(names))
    topic = rng.choice(
        (names[b], names[a] + "x", "/state/cubes/position/" + "9" * 5000, "/state/cubes/position/000001", "/action/x/٠",
         "/fingerprint/capture", "", "/state/cubes/position/000000", "\x1b[2J", "/count/timed/contacts", "/run/end"),
    )  # fmt: skip
    liar = mcap.pack_channel(a, rng.choice((1, 2, 99)), topic)
    if rng.random() < 0.5:
        data = mcap.join([r for r in mcap.split(mcap.assemble(file)) if r.opcode != mcap.CHANNEL])
        data = data[: -len(mcap.MAGIC) - 29] + liar.bytes() + data[-len(mcap.MAGIC) - 29 :]
        return Mutant(mcap.with_right_crcs(data), index)
    found = [liar if r.opcode == mcap.CHANNEL and r.body[:2] == liar.body[:2] else r for r in file.records()]
    return Mutant(mcap.assemble(file.with_records(found if rng.random() < 0.5 else [liar, *file.records()])), index)


@_mutator
def two_recordings_in_one(rng: Random, corpus: Corpus) -> Mutant:
    """Some of one recording's records and then some of another's, all right in form."""
    index, one = _pick_finished(rng, corpus)
    _, two = _pick_finished(rng, corpus)
    items = one.items[: rng.randrange(1, len(one.items) + 1)] + two.items[rng.randrange(len(two.items) + 1) :]
    return Mutant(mcap.assemble(replace(one, items=items)), index)


@_mutator
def another_end(rng: Random, corpus: Corpus) -> Mutant:
    """An end record that says something else under the same hash."""
    index, file = _pick_finished(rng, corpus)
    return Mutant(mcap.assemble(other_end(rng, file)), index, Promise.BEYOND_THE_HASH)


# -- what is no content ------------------------------------------------------------------------------------------------


@_mutator
def other_layout(rng: Random, corpus: Corpus) -> Mutant:
    """Other chunks, compression, publish times, indexes and metadata records: nothing that a recording says."""
    index, file = _pick_finished(rng, corpus)
    found = []
    for record in file.records():
        if record.opcode == mcap.MESSAGE and rng.random() < 0.5:
            record = replace(Message.of(record), publish_time=rng.randrange(2**64)).record()  # noqa: PLW2901
        found.append(record)
    compression = rng.choice(("", "lz4", "zstd"))
    changed = file.with_records(found, compression=compression, per_chunk=rng.choice((1, 3, 50, 10**6)))
    note = Record(mcap.METADATA, mcap.pack_text("note") + mcap.pack_text(mcap.pack_text("a") + mcap.pack_text("b")))
    items = changed.items
    if rng.random() < 0.3:
        items = tuple(i for i in items if not (isinstance(i, Record) and i.opcode == mcap.METADATA))
    if rng.random() < 0.3:
        items = (*items, note, Record(0x99, b"of somebody's own"))
    if rng.random() < 0.2:
        # without chunks
        items = tuple(part for i in items for part in (i.records if isinstance(i, Chunk) else (i,)))
    changed = replace(changed, items=items)
    return Mutant(mcap.assemble(changed, index=rng.random() < 0.8), index, Promise.SAME)


# -- hostile contents --------------------------------------------------------------------------------------------------


@_mutator
def json_attachments(rng: Random, corpus: Corpus) -> Mutant:
    """Provenance, simulation or scene of wrong types, sizes and depths, under the old digests or new ones."""
    index, file = _pick_finished(rng, corpus)
    places = [
        i for i, item in enumerate(file.items) if isinstance(item, Attachment) and item.name.endswith(".json")
    ]  # fmt: skip
    items = list(file.items)
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.choice(places)
        attachment = items[at]
        assert isinstance(attachment, Attachment)
        items[at] = replace(attachment, data=hostile_json(rng, attachment.data))
    changed = replace(file, items=tuple(items))
    if rng.random() < 0.1:
        return Mutant(mcap.assemble(changed), index)
    return Mutant(mcap.assemble(with_right_digests(changed)), index, Promise.FORGED)


@_mutator
def protobuf_messages(rng: Random, corpus: Corpus) -> Mutant:
    """Numbers, lengths and bytes of messages that no recorder would write, under the old digests."""
    index, file = _pick_finished(rng, corpus)
    return Mutant(mcap.assemble(_with_hostile_messages(rng, file)), index)


@_mutator
def protobuf_messages_without_digests(rng: Random, corpus: Corpus) -> Mutant:
    """The same with digests made anew."""
    index, file = _pick_finished(rng, corpus)
    return Mutant(mcap.assemble(with_right_digests(_with_hostile_messages(rng, file))), index, Promise.FORGED)


def _with_hostile_messages(rng: Random, file: File) -> File:
    found = list(file.records())
    topics = file.channels()
    ends = {number for number, topic in topics.items() if topic == "/run/end"}
    numbers = [
        i for i, r in enumerate(found) if r.opcode == mcap.MESSAGE and Message.of(r).channel not in ends
    ]  # fmt: skip
    # a topic of many messages must not hide the others
    channel = rng.choice(sorted({Message.of(found[i]).channel for i in numbers}))
    mine = [i for i in numbers if Message.of(found[i]).channel == channel]
    for at in rng.sample(mine, min(len(mine), rng.choice((1, 1, 2)))):
        message = Message.of(found[at])
        found[at] = replace(message, data=hostile_protobuf(rng, message.data)).record()
    return file.with_records(found)


# -- bombs -------------------------------------------------------------------------------------------------------------


def _zstd_without_size(data: bytes) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=False).compress(data)


def _zstd_of_a_huge_window(data: bytes) -> bytes:
    parameters = zstandard.ZstdCompressionParameters(window_log=30, write_content_size=0)
    return zstandard.ZstdCompressor(compression_params=parameters).compress(data)


_ZEROS = bytes(1 << 24)
_SKIPPABLE = struct.pack("<II", 0x184D2A50, 4) + b"skip"


def _bombs(raw: bytes) -> dict[str, tuple[str, bytes, int | None]]:
    """Compression, stored bytes and announced size of chunks; the records in them are `raw`, or something else."""
    zstd, lz4s = mcap.compress("zstd", raw), mcap.compress("lz4", raw)
    half = len(raw) // 2
    return {
        "two frames": ("zstd", mcap.compress("zstd", raw[:half]) + mcap.compress("zstd", raw[half:]), None),
        "two lz4 frames": ("lz4", mcap.compress("lz4", raw[:half]) + mcap.compress("lz4", raw[half:]), None),
        "a frame and zeros": ("zstd", zstd + mcap.compress("zstd", _ZEROS), None),
        "a lz4 frame and zeros": ("lz4", lz4s + mcap.compress("lz4", _ZEROS), None),
        "no size": ("zstd", _zstd_without_size(raw), None),
        "no size and zeros": ("zstd", _zstd_without_size(raw + _ZEROS), None),
        "a huge window": ("zstd", _zstd_of_a_huge_window(raw + _ZEROS), len(raw)),
        "skippable frames": ("zstd", _SKIPPABLE * 3 + zstd, None),
        "noise behind": ("zstd", zstd + b"noise", None),
        "lz4 noise behind": ("lz4", lz4s + b"noise", None),
        "cut": ("zstd", zstd[:-1], None),
        "lz4 cut": ("lz4", lz4s[:-5], None),
        "more than announced": ("zstd", mcap.compress("zstd", raw + _ZEROS), None),
        "lz4 more than announced": ("lz4", lz4.frame.compress(raw + _ZEROS, store_size=False), None),
        "less than announced": ("zstd", zstd, len(raw) + 1),
        "a gigabyte announced": ("zstd", zstd, 1 << 30),
        "lz4 a gigabyte announced": ("lz4", lz4s, 1 << 30),
        "everything announced": ("zstd", zstd, 2**64 - 1),
        "lz4 everything announced": ("lz4", lz4s, 2**63),
        "nothing announced": ("zstd", zstd, 0),
        "lz4 nothing announced": ("lz4", lz4s, 0),
        "nothing stored": ("zstd", b"", None),
        "lz4 nothing stored": ("lz4", b"", None),
        "another method": ("brotli", zstd, None),
        "no method": ("", raw, len(raw) + 1),
    }


BOMBS = tuple(_bombs(b""))


@_mutator
def bombs(rng: Random, corpus: Corpus) -> Mutant:
    """Chunks that unpack into more, less or something else than they announce."""
    index, file = _pick_finished(rng, corpus)
    return bomb(rng.choice(BOMBS), rng, file, index)


def bomb(kind: str, rng: Random, file: File, index: int) -> Mutant:
    """One kind of bomb in place of one chunk."""
    at = rng.choice([i for i, item in enumerate(file.items) if isinstance(item, Chunk)])
    chunk = file.items[at]
    assert isinstance(chunk, Chunk)
    raw = b"".join(r.bytes() for r in chunk.records)
    compression, stored, size = _bombs(raw)[kind]
    items = (*file.items[:at], mcap.pack_chunk(compression, raw, stored, size=size), *file.items[at + 1 :])
    return Mutant(mcap.assemble(replace(file, items=items)), index)
