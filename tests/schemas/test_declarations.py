"""What a file declares: how much of it is read, and whether one part of a file declares what another does."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap import declarations
from gpusimbench.schemas.mcap.declarations import Declarations, TooMuch
from gpusimbench.schemas.mcap.records import Cursor, Op, Record
from gpusimbench.schemas.messages import embedded_schema, widened_schema

FILE = Path("a.mcap")


def text(value: str) -> bytes:
    """A string of MCAP."""
    return struct.pack("<I", len(value)) + value.encode()


def schema(number: int, name: str) -> Record:
    """A record of a schema."""
    content = struct.pack("<H", number) + text(name) + text("protobuf") + text("")
    return Record(Op.SCHEMA, 0, memoryview(content))


def channel(number: int, of: int, topic: str, texts: int = 0) -> Record:
    """A record of a channel with so many texts of metadata."""
    pairs = b"".join(text(f"{i}") + text("") for i in range(texts))
    content = struct.pack("<HH", number, of) + text(topic) + text("protobuf") + struct.pack("<I", len(pairs)) + pairs
    return Record(Op.CHANNEL, 0, memoryview(content))


def declared(*records: Record) -> Declarations:
    """What these records declare."""
    found = Declarations(FILE)
    for record in records:
        found.take(record)
    return found


def test_declarations_cover_each_other() -> None:
    """Cover what is the same or a part, and nothing with another schema, topic, number or metadata."""
    whole = declared(schema(1, "a.B"), schema(2, "a.C"), channel(1, 1, "/one"), channel(2, 2, "/two"))
    assert whole.whole
    assert whole.covers(whole)
    assert whole.covers(declared())
    assert whole.covers(declared(schema(2, "a.C"), channel(2, 2, "/two")))
    assert not declared().covers(whole)
    assert not whole.covers(declared(schema(1, "a.X")))
    assert not whole.covers(declared(schema(1, "a.B"), channel(3, 1, "/one")))
    assert not whole.covers(declared(schema(1, "a.B"), channel(1, 1, "/one", texts=1)))
    assert not declared(channel(1, 1, "/one"), schema(1, "a.B")).whole


@pytest.mark.parametrize(
    "records",
    [
        (schema(1, "a.B"), schema(1, "a.C")),
        (channel(1, 0, "/one"), channel(1, 0, "/two")),
        (channel(1, 0, "/one"), channel(2, 0, "/one", texts=1)),
        (channel(1, 1, "/one"), schema(1, "a.B"), channel(1, 1, "/one")),
    ],
)
def test_declarations_that_contradict_each_other(records: tuple[Record, ...]) -> None:
    """Refuse a number of two names, a channel of two topics, a topic of two declarations, or whose type came late."""
    with pytest.raises(DamagedRecording, match="two names|two topics|declared twice"):
        declared(*records)


def test_texts_of_all_channels_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take as many texts as are read, a repeated channel once, and refuse one more."""
    monkeypatch.setattr(declarations, "MAX_DECLARED_TEXTS", 5)
    three, two = channel(1, 0, "/one", texts=3), channel(2, 0, "/two", texts=2)
    found = declared(schema(1, "a.B"), three, three, two)
    with pytest.raises(TooMuch, match="more than the 67108864 bytes or 5 texts that are read"):
        found.take(channel(3, 0, "/three", texts=1))


def test_bytes_of_all_declarations_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take as many bytes of schemas and channels as are read, a repeated record once, and refuse one more."""
    records = (schema(1, "a.B"), channel(1, 1, "/one"), schema(1, "a.B"))
    size = sum(len(record.content) for record in records[:2])
    monkeypatch.setattr(declarations, "MAX_DECLARED_BYTES", size)
    declared(*records)
    monkeypatch.setattr(declarations, "MAX_DECLARED_BYTES", size - 1)
    with pytest.raises(TooMuch, match=f"more than the {size - 1} bytes"):
        declared(*records)


def test_bytes_of_a_channel_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take a channel of the largest size, and refuse one that is a byte longer."""
    size = len(channel(1, 0, "/one").content)
    monkeypatch.setattr(declarations, "MAX_CHANNEL_BYTES", size)
    found = declared(channel(1, 0, "/one"), schema(1, "a.name.that.is.much.longer.than.the.channel"))
    with pytest.raises(TooMuch, match=f"a channel takes {size + 1} bytes to declare; at most {size} are read of one"):
        found.take(channel(2, 0, "/two2"))


def test_places_of_errors_are_those_of_the_data() -> None:
    """Name the byte at which a record is too short: in the data, and behind where the data begins in the file."""
    assert Cursor(FILE, memoryview(bytes(9)), 4, 9).at == 4
    assert Cursor(FILE, memoryview(bytes(9)), 4, 9, 100).at == 104
    with pytest.raises(DamagedRecording, match="a record at byte 7 is shorter than it says"):
        Cursor(FILE, memoryview(bytes(9)), 7, 8).take(2)


def test_an_old_schema_is_widened() -> None:
    """Give today's schema for one that has no more fields, and the stored one where it has others or is no schema."""
    ours = embedded_schema("gsb.v1.StateBlock")
    assert widened_schema("gsb.v1.StateBlock", b"") == ours
    other = embedded_schema("foxglove.SceneUpdate")
    assert widened_schema("gsb.v1.StateBlock", other) == other
    assert widened_schema("gsb.v1.StateBlock", b"\xff") == b"\xff"
    huge = bytes((1 << 20) + 1)
    assert widened_schema("gsb.v1.StateBlock", huge) == huge
