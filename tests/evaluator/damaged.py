"""Recordings damaged in known ways. Each way is a function of a whole file's bytes, or a change of what is written."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from gpusimbench.recorder.capture import state_work
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.block_parts import encode_fingerprints
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PACKAGES, PROVENANCE, SCENE
from tests.synthetic import Shown, changing, grid, write_recording

Messages = list[tuple[str, int, int, bytes]]
"""Topic, sequence, log time and content of the messages of a file."""

_HEAD = 9


def places(data: bytes, opcode: int) -> list[int]:
    """Where the top-level records of a type begin."""
    found, position = [], 8
    while position + _HEAD <= len(data):
        if data[position] == opcode:
            found.append(position)
        position += _HEAD + struct.unpack_from("<Q", data, position + 1)[0]
    return found


def flipped(data: bytes, position: int) -> bytes:
    """With one bit changed."""
    changed = bytearray(data)
    changed[position] ^= 4
    return bytes(changed)


def inserted(data: bytes, opcode: int, content: bytes = b"nothing that MCAP has") -> bytes:
    """With one more record at the end of the data section, whose CRC is made right again."""
    at = places(data, 15)[0]
    grown = data[:at] + struct.pack("<BQ", opcode, len(content)) + content
    end = struct.pack("<BQI", 15, 4, zlib.crc32(grown))
    # what the summary says of places before the insertion stays true; its own place is another
    footer = places(data, 2)[0]
    return grown + end + _footer(data[at + len(end) : footer], len(grown) + len(end))


def without_crcs(data: bytes) -> bytes:
    """With a data section that says that it has no CRC."""
    at = places(data, 15)[0]
    return data[: at + _HEAD] + bytes(4) + data[at + _HEAD + 4 :]


def miscounted(data: bytes) -> bytes:
    """With statistics that count a message too many, under a right CRC."""
    at = places(data, 11)[0] + _HEAD
    begin = places(data, 15)[0] + _HEAD + 4
    changed = bytearray(data[: places(data, 2)[0]])
    changed[at : at + 8] = struct.pack("<Q", struct.unpack_from("<Q", changed, at)[0] + 1)
    return bytes(changed[:begin]) + _footer(bytes(changed[begin:]), begin)


def misindexed(data: bytes) -> bytes:
    """With an index of messages that names another time; the data section's CRC is made right again."""
    at = places(data, 7)[0] + _HEAD + 6
    end = places(data, 15)[0]
    changed = bytearray(data)
    changed[at] ^= 1
    changed[end + _HEAD : end + _HEAD + 4] = struct.pack("<I", zlib.crc32(changed[:end]))
    return bytes(changed)


def _footer(summary: bytes, begin: int) -> bytes:
    # without summary offsets, which the insertion may have moved
    head = struct.pack("<BQQQ", 2, 20, begin, 0)
    return summary + head + struct.pack("<I", zlib.crc32(summary + head)) + b"\x89MCAP0\r\n"


def rewritten(
    source: Path,
    target: Path,
    change: Callable[[Messages], Iterable[Any]],
    encoding: str = "protobuf",
    metadata: Callable[[dict[str, str]], dict[str, str]] = dict,
) -> Path:
    """Written again by the official library, which makes all CRCs and indexes right, with other messages, and other
    metadata of channels."""
    with source.open("rb") as stream, target.open("wb") as out:
        reader = make_reader(stream)
        writer = Writer(out, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start(profile=reader.get_header().profile)
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        channels: dict[str, int] = {}
        messages: Messages = []
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, encoding, number, metadata(channel.metadata)
                )
            messages.append((channel.topic, message.sequence, message.log_time, message.data))
        for topic, sequence, log_time, content in change(messages):
            writer.add_message(channels[topic], log_time, content, 0, sequence)
        writer.finish()
    return target


def _raw(topic: str, kind: str, **values: Any) -> dict[str, Any]:
    return {"shown": Shown(raw=((topic, f"gsb.v1.{kind}", message_class(f"gsb.v1.{kind}")(**values)),))}


def _events(*events: dict[str, Any]) -> dict[str, Any]:
    make = message_class("gsb.v1.Event")
    return {"shown": Shown(raw=tuple(("/run/event", "gsb.v1.Event", make(**event)) for event in events))}


def _timed_hashes(**_: Any) -> dict[str, Any]:
    raw = (("/fingerprint/timed", "gsb.v1.FingerprintBlock",
            encode_fingerprints(np.full((1, 2), 7, dtype=np.uint64), first_step=2, stride=1)),)  # fmt: skip
    return {"shown": Shown(raw=raw)}


WRITTEN: dict[str, dict[str, Any]] = {
    "streams": {"elapsed_s": -1.0},
    "clocks": _events({"kind": 1, "phase": "a", "monotonic_ns": 9}, {"kind": 2, "phase": "a", "monotonic_ns": 8}),
    "consistent": _events({"kind": 4, "phase": "capture", "text": "contacts were dropped"}),
    "no-dropouts": {"dropout": "the disk was full"},
    "provenance": {"change": changing(PROVENANCE, host={})},
    "observer": _timed_hashes(),
    "misplaced-contacts": {"shown": Shown(counts={"capture": {"misplaced_contacts": np.ones((5, 2), int)}})},
    "end": {"end": False},
}
"""What to write, by the rule of integrity-1 that it breaks."""

SCENE_CHANGED = {"change": changing(SCENE, dt=0.02)}

BYTES: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "a text": ("recording", lambda data: b"these are not the bytes that you are looking for"),
    "nothing": ("recording", lambda data: b""),
    "another profile": ("recording", lambda data: data.replace(b"gsb.v1", b"gsb.v9", 1)),
    "no provenance": ("recording", lambda data: data[: places(data, 9)[0]]),
    "half": ("whole", lambda data: data[: len(data) // 2]),
    "without its last byte": ("whole", lambda data: data[:-1]),
    "one byte more": ("whole", lambda data: data + b"\n"),
    "an attachment": ("attachment-crc", lambda data: flipped(data, data.index(b'"seed"'))),
    "a chunk": ("chunk-crc", lambda data: flipped(data, places(data, 6)[-2] + 900)),
    "a header": ("data-crc", lambda data: flipped(data, places(data, 1)[0] + 24)),
    "a summary": ("summary-crc", lambda data: flipped(data, places(data, 11)[0] + _HEAD)),
    "a record that nobody knows": ("known-records", lambda data: inserted(data, 0x42)),
    "a second header": ("records", lambda data: inserted(data, 1, data[17:][: struct.unpack_from("<Q", data, 9)[0]])),
    "no CRC": ("crc-present", without_crcs),
    "statistics": ("summary", miscounted),
    "an index": ("message-index", misindexed),
}
"""Changes of a file's bytes, with the rule that each breaks."""


def _without(topic: str) -> Callable[[Messages], Messages]:
    return lambda messages: [m for m in messages if not (m[0].startswith(topic) and m[1] == 0)]


def _changed(messages: Messages) -> Messages:
    return [(t, s, time, data.replace(b"was here", b"went off")) for t, s, time, data in messages]


def _twice(messages: Messages) -> Messages:
    return [copy for m in messages for copy in ([m, m] if m[0].startswith("/fingerprint") else [m])]


REWRITTEN: dict[str, tuple[str, Callable[[Messages], Messages]]] = {
    "a block is missing": ("sequence", _without("/state")),
    "a hash is missing": ("sequence", _without("/fingerprint/capture")),
    "a message is there twice": ("sequence", _twice),
    "another number": ("digests", lambda ms: [(t, s, time, d[:-1] + b"\x01" if t == "/timing/timed" else d)
                                              for t, s, time, d in ms]),
    "another reason": ("content-hash", _changed),
    "messages behind the end": ("end", lambda messages: [messages[-1], *messages[:-1]]),
    "two ends": ("end", lambda messages: [*messages, (*messages[-1][:1], 1, *messages[-1][2:])]),
}  # fmt: skip
"""Changes of a file's messages under right CRCs, with the rule that each breaks."""


def hashes_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the recorder write state hashes of states that are not there."""
    monkeypatch.setattr(state_work, "fingerprint", lambda arrays: fingerprint(arrays) + np.uint64(1))


def whole(folder: Path, *, change: Callable[[str, dict[str, Any]], None] | None = None, **keywords: Any) -> Path:
    """A synthetic recording in which nothing is wrong, but for what `change` does to its JSON."""

    def edited(name: str, record: dict[str, Any]) -> str | None:
        before = json.dumps(record)
        if name == PROVENANCE:
            record["host"] = {"cpu": "test", "usable_threads": 2, "memory_bytes": 1 << 33, "system": "Linux"}
            recorder = {"version": "1", "commit": "c0ffee", "modified": False}
            record["software"] = {"python": "3.11.7", "recorder": recorder, "packages": {"numpy": "2"}}
        if change is not None:
            change(name, record)
        # the scene has a hash, so it keeps its bytes
        return make_scene(record["name"]).to_json() if name == SCENE and json.dumps(record) == before else None

    attach = Sink.attach

    def with_packages(self: Sink, name: str, media_type: str, data: bytes) -> None:
        attach(self, name, media_type, data)
        if name == PROVENANCE:
            attach(self, PACKAGES, "text/plain", b"numpy==2\n")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sink, "attach", with_packages)
        return write_recording(folder, keywords.pop("final", grid(2)), **{"change": edited, **keywords})
