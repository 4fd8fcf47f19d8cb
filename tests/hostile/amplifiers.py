"""Files of a few megabytes that would take gigabytes as objects: one for each thing that a file may have many of."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path

from gpusimbench.schemas.messages import message_class
from tests.hostile import records as mcap
from tests.hostile.contents import with_right_digests
from tests.hostile.records import Attachment, Chunk, File, Message, Record
from tests.synthetic import Shown, grid, write_recording

_PLACE = "\ufffeplace\ufffe"


def _with_json(file: File, name: str, key: str, text: str) -> File:
    def changed(data: bytes) -> bytes:
        return json.dumps({**json.loads(data), key: _PLACE}).replace(json.dumps(_PLACE), text).encode()

    items = (
        Attachment(i.name, i.media_type, changed(i.data)) if isinstance(i, Attachment) and i.name == name else i
        for i in file.items
    )
    return File(tuple(items))


def _with_records(file: File, records: list[Record]) -> File:
    return File((*file.items, Chunk("zstd", tuple(records))))


def _amplified(file: File) -> Iterator[tuple[str, File]]:
    values = ",".join(["[]"] * 600_000)
    yield "values of provenance", _with_json(file, "provenance.json", "host", f'{{"a":[{values}]}}')
    yield "values of a scene", _with_json(file, "scene.json", "extra", f"[{values}]")
    named = ",".join(f'"{i:x}":""' for i in range(1_060_000))
    yield "variables", _with_json(file, "provenance.json", "environment", f"{{{named}}}")
    yield "one text", _with_json(file, "provenance.json", "host", f'{{"a":"\U0001f600{"&" * 3_000_000}"}}')
    lines = ",".join(f'"{i}":"\U0001f600{"&" * 1_000_000}"' for i in range(10))
    yield "long texts", _with_json(file, "provenance.json", "host", f"{{{lines}}}")
    yield "attachments", File((*file.items, *(Attachment(f"{i:x}", "", b"") for i in range(5000))))
    note = [Record(mcap.METADATA, mcap.pack_text(f"{i:x}") + mcap.pack_text(b"")) for i in range(70_000)]
    yield "metadata", File((*file.items, *note))
    (event,) = (number for number, topic in file.channels().items() if topic == "/run/event")
    said = message_class("gsb.v1.Event")(kind=3, text="x").SerializeToString()
    yield "events", _with_records(file, [Message(event, 1 + i, 1, 1, said).record() for i in range(70_000)])
    texts = {f"{i:x}": "" for i in range(120_000)}
    yield "metadata of a channel", _with_records(file, [mcap.pack_channel(301, 1, "/other", texts)])
    schema = mcap.pack_text("a") + mcap.pack_text("protobuf") + mcap.pack_text(bytes(1 << 20))
    schemas = [Record(mcap.SCHEMA, struct.pack("<H", 1000 + i) + schema) for i in range(70)]
    yield "schemas", _with_records(file, schemas)


def write_amplifiers(folder: Path) -> dict[str, Path]:
    """Write them, by what there is too much of; digests are made to fit, so that nothing else is wrong."""
    event = ("/run/event", "gsb.v1.Event", b"")
    file = mcap.parse(write_recording(folder, grid(2), name="good.mcap", shown=Shown(raw=(event,))).read_bytes())
    found = {}
    for number, (what, amplified) in enumerate(_amplified(file)):
        found[what] = folder / f"{number}.mcap"
        found[what].write_bytes(mcap.assemble(with_right_digests(amplified)))
    return found
