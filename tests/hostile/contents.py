"""Hostile contents of attachments and messages."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from dataclasses import replace
from random import Random
from typing import Any

from gpusimbench.schemas.digest import content_hash
from gpusimbench.schemas.messages import message_class
from tests.hostile import records as mcap
from tests.hostile.records import Attachment, File, Message

_NUMBERS = (0, -1, 1, 2, 3, 2**31, 2**32 - 1, 2**53 + 1, 2**62, 2**63, 2**64 - 1, 10**300, 1e-300, 1e308, -1e308, 0.5)
_VALUES = (
    None, True, False, [], {}, "", "0", "\ud800", "\x1b[2J", "../../etc/passwd", "<script>", "x" * 100_000, [[]],
    [None], {"a": {}}, [1, 2, 3], ["a", "b"], [0.0] * 1000, [{}] * 1000,
)  # fmt: skip
_TEXTS = ("NaN", "Infinity", "-Infinity", "1e999", "9" * 4000, "9" * 5000, "1" + "0" * 400, "[" * 900 + "]" * 900,
          '{"a":' * 500 + "1" + "}" * 500)  # fmt: skip
_PLACE = "\ufffeplace\ufffe"


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    if isinstance(value, dict):
        for key in value:
            yield from _paths(value[key], (*path, key))
    elif isinstance(value, list):
        for index in range(min(len(value), 3)):
            yield from _paths(value[index], (*path, index))


def hostile_json(rng: Random, data: bytes) -> bytes:
    """One value replaced by another type, size or depth, a key lost or doubled, or no JSON at all."""
    kind = rng.randrange(20)
    if kind == 0:
        return rng.choice((b"", b"{", b"[]", b"null", b"\xff\xfe{}", b"{}" * 2, data[: len(data) // 2], b"\x00" * 9,
                           b"[" * 200_000, b'{"a":' * 100_000, data.decode().encode("utf-16")))  # fmt: skip
    try:
        record = json.loads(data)
        paths = list(_paths(record))
    except (ValueError, RecursionError):
        return data[: rng.randrange(len(data) + 1)]
    if not isinstance(record, dict) or not paths:
        return b"{}"
    path = rng.choice(paths)
    place: Any = record
    for key in path[:-1]:
        place = place[key]
    key = path[-1]
    text: str | None = None
    if kind == 1:
        place.pop(key)
    elif kind == 2 and isinstance(place, dict):
        place.update({f"{i}": i for i in range(1000)})
    elif kind == 3 and isinstance(place[key], list):
        place[key] = place[key] * rng.choice((0, 2, 1000))
    elif kind < 10:
        place[key] = rng.choice(_NUMBERS)
    elif kind < 16:
        place[key] = rng.choice(_VALUES)
    else:
        place[key], text = _PLACE, rng.choice(_TEXTS)
    written = json.dumps(record)
    if text is not None:
        written = written.replace(json.dumps(_PLACE), text)
    return written.encode()


# -- protobuf ----------------------------------------------------------------------------------------------------------

_VARINTS = (0, 1, 2, 3, 127, 2**31, 2**32 - 1, 2**40, 2**40 + 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_FIXED_8 = tuple(struct.pack("<d", v) for v in (0.0, -1.0, 1e308, float("nan"), float("inf"))) + tuple(
    struct.pack("<q", v) for v in (-(2**63), -1, 1, 2**62, 2**63 - 1)
)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*out, value))


def _read(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def _wire(data: bytes) -> list[tuple[int, int, Any]]:
    """Number, wire type and value of each field of a good message."""
    found: list[tuple[int, int, Any]] = []
    at = 0
    while at < len(data):
        tag, at = _read(data, at)
        number, kind = tag >> 3, tag & 7
        value: Any
        if kind == 0:
            value, at = _read(data, at)
        elif kind == 2:
            size, at = _read(data, at)
            value, at = data[at : at + size], at + size
        else:
            size = 8 if kind == 1 else 4
            value, at = data[at : at + size], at + size
        found.append((number, kind, value))
    return found


def _unwire(fields: list[tuple[int, int, Any]]) -> bytes:
    out = bytearray()
    for number, kind, value in fields:
        out += _varint(number << 3 | kind)
        if kind == 0:
            out += _varint(value)
        elif kind == 2:
            out += _varint(len(value)) + value
        else:
            out += value
    return bytes(out)


def hostile_protobuf(rng: Random, data: bytes) -> bytes:
    """One field of another value, size or type, lost, doubled or added; or bytes that are no message."""
    fields = _wire(data)
    kind = rng.randrange(12)
    if kind == 0 or not fields:
        return rng.choice((b"", b"\xff" * 20, b"\x0a", b"\x0b" * 2000, rng.randbytes(40), data[: len(data) // 2]))
    at = rng.randrange(len(fields))
    number, wire, value = fields[at]
    if kind == 1:
        del fields[at]
    elif kind == 2:
        fields.insert(rng.randrange(len(fields) + 1), fields[at])
    elif kind == 3:
        fields.append((rng.choice((1, 2, 3, 4, 9, 11, 12, 13, 99, 2**29 - 1)), 0, rng.choice(_VARINTS)))
    elif kind == 4:
        fields[at] = (number, rng.choice((0, 2)), b"") if wire != 0 else (number, 2, b"\0" * rng.choice((0, 1, 8, 64)))
        if fields[at][1] == 0:
            fields[at] = (number, 0, rng.choice(_VARINTS))
    elif wire == 0:
        fields[at] = (number, 0, rng.choice(_VARINTS))
    elif wire == 2:
        fields[at] = (number, 2, _spoiled(rng, value))
    else:
        fields[at] = (number, wire, rng.choice(_FIXED_8)[: len(value)])
    return _unwire(fields)


def _spoiled(rng: Random, value: bytes) -> bytes:
    match rng.randrange(6):
        case 0:
            return value[: rng.randrange(len(value) + 1)]
        case 1:
            return value * 2
        case 2:
            return value + bytes(8 * rng.randrange(1, 9))
        case 3 if len(value) >= 8:
            at = rng.randrange(len(value) // 8) * 8
            return value[:at] + rng.choice(_FIXED_8) + value[at + 8 :]
        case 4:
            return rng.randbytes(len(value))
    return b""


# -- end records -------------------------------------------------------------------------------------------------------


def _with_end(file: File, change: Any) -> File:
    ends = {number for number, topic in file.channels().items() if topic == "/run/end"}
    found = []
    for record in file.records():
        if record.opcode == mcap.MESSAGE and len(record.body) >= 22 and Message.of(record).channel in ends:
            message = Message.of(record)
            end = message_class("gsb.v1.RunEnd")()
            try:
                end.ParseFromString(message.data)
                change(end)
                record = replace(message, data=end.SerializeToString()).record()  # noqa: PLW2901
            except Exception:  # noqa: S110 - what was spoiled before is left as it is
                pass
        found.append(record)
    return file.with_records(found)


def other_end(rng: Random, file: File) -> File:
    """One thing in the end record changed."""

    def change(end: Any) -> None:
        match rng.randrange(7):
            case 0:
                end.status = rng.choice((0, 1, 2, 3, 4, 77))
            case 1:
                end.reason = rng.choice(("", "something else", "x" * 100_000))
            case 2:
                end.last_step = rng.choice((0, 1, 2**40, 2**64 - 1))
            case 3:
                end.cause = rng.choice((0, 1, 8, 99, -5))
            case 4:
                name = rng.choice(sorted(end.digests))
                end.digests[name] = rng.choice(("", "0" * 64, end.digests[rng.choice(sorted(end.digests))]))
            case 5:
                end.content_hash = rng.choice(("", "0" * 64))
            case 6:
                end.digests.pop(rng.choice(sorted(end.digests)))

    return _with_end(file, change)


def with_right_digests(file: File) -> File:
    """The file with the digests of attachments and messages made anew, and the hash over them, as a forger would.

    Those of states are left as they are: what can be decoded is told by the reader that is being tried.
    """
    topics = file.channels()
    attachments = [item for item in file.items if isinstance(item, Attachment)]
    digests = {f"attachment {a.name}": hashlib.sha256(a.data).hexdigest() for a in attachments}
    streams: dict[str, list[tuple[int, bytes]]] = {}
    for record in file.records():
        if record.opcode == mcap.MESSAGE and len(record.body) >= 22:
            message = Message.of(record)
            streams.setdefault(topics.get(message.channel, ""), []).append((message.sequence, message.data))
    for topic, messages in streams.items():
        if topic != "/run/end" and not topic.startswith("/state/"):
            digest = hashlib.sha256()
            for _, data in sorted(messages):
                digest.update(struct.pack("<Q", len(data)) + data)
            digests[topic] = digest.hexdigest()

    def change(end: Any) -> None:
        states = {name: digest for name, digest in end.digests.items() if name.startswith("state ")}
        end.digests.clear()
        end.digests.update({**digests, **states})
        status = {1: "complete", 2: "failed", 3: "invalid"}.get(end.status, "")
        end.content_hash = content_hash(end.digests, status, end.reason)

    return _with_end(file, change)
