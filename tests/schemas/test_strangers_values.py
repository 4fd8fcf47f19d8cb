"""Values out of a stranger's JSON and bytes: what is taken at the very limit, and what is refused beyond it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from gpusimbench.schemas import checks, wire
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.trial_units import Extent, extent_of, unit_doubt


def nested(depth: int) -> str:
    """A JSON object with lists that many deep within it, the object counted."""
    return f'{{"a":{"[" * (depth - 1)}{"]" * (depth - 1)}}}'


def test_depth_has_a_limit() -> None:
    """Read lists and objects 64 deep, and none deeper."""
    assert checks.load("a", nested(checks.MAX_DEPTH))["a"]
    with pytest.raises(DamagedRecording, match="more than 64 deep"):
        checks.load("a", nested(checks.MAX_DEPTH + 1))


def test_documents_of_a_file_share_a_budget() -> None:
    """Refuse what is too much of all documents together, and let one be read again at no cost."""
    budget = checks.Budget()
    half = json.dumps({"a": [0] * (checks.MAX_JSON_VALUES // 2 - 2)})
    for _ in range(3):
        checks.load("one", half, budget)
    checks.load("two", half, budget)
    with pytest.raises(DamagedRecording, match=f"three has 1 values; at most {checks.MAX_JSON_VALUES} are read"):
        budget.take("three", "1")


def test_bytes_of_documents_have_a_limit() -> None:
    """Take as many bytes as are allowed, and not one more."""
    budget = checks.Budget()
    budget.take("one", b" " * checks.MAX_JSON_BYTES)
    with pytest.raises(DamagedRecording, match="two has 1 bytes"):
        budget.take("two", b" ")


@pytest.mark.parametrize("document", ['{"a": "%s"}', '{"%s": 0}', '{"a": [{"b": "%s"}]}'])
def test_texts_have_a_limit(document: str) -> None:
    """Read a text or a key of the largest length wherever it is, and refuse one that is longer."""
    assert checks.load("a", document % ("x" * checks.MAX_JSON_TEXT))
    with pytest.raises(DamagedRecording, match=f"a text of {checks.MAX_JSON_TEXT + 1} characters"):
        checks.load("a", document % ("x" * (checks.MAX_JSON_TEXT + 1)))


@pytest.mark.parametrize("name", [field.name for field in fields(RunConfiguration)])
def test_every_value_of_a_configuration_is_read(name: str) -> None:
    """Refuse an object in place of each value, also of one that a file may leave out: none is ignored."""
    plain = RunConfiguration("mujoco", "free-fall", n_env=1, dt=0.01, steps=1).to_json()
    assert RunConfiguration.from_json(plain).to_json() == plain
    with pytest.raises(DamagedRecording):
        RunConfiguration.from_json({**plain, name: {"no text": 1}})


@pytest.mark.parametrize("value", [2, 5, 3])
def test_whole_numbers_within_their_bounds(value: int) -> None:
    """Return a whole number from the lowest to the highest, both allowed, and the default where there is none."""
    assert checks.whole({"n": value}, "n", 2, 5) == value
    assert checks.whole({}, "n", 2, 5, value) == value


@pytest.mark.parametrize("value", [1, 6, 2.0, True, None, "3", 10**40])
def test_whole_numbers_beyond_their_bounds(value: Any) -> None:
    """Refuse a number beyond either bound, and what is no whole number."""
    with pytest.raises(DamagedRecording, match="n is not a whole number from 2 to 5"):
        checks.whole({"n": value}, "n", 2, 5)


def test_numbers_within_their_bounds() -> None:
    """Return numbers from the lowest to the highest as floats; refuse others, booleans and what is not finite."""
    assert [checks.number({"x": x}, "x", 0.5, 2) for x in (0.5, 1, 2)] == [0.5, 1.0, 2.0]
    assert isinstance(checks.number({"x": 1}, "x", 0, 2), float)
    for wrong in (0.4, 2.1, True, None, "1", float("nan")):
        with pytest.raises(DamagedRecording, match="x is not a number from 0.5 to 2"):
            checks.number({"x": wrong}, "x", 0.5, 2)


def test_vectors_are_of_their_size() -> None:
    """Return finite numbers of the given count; refuse fewer, more, and the infinite."""
    largest = sys.float_info.max
    assert checks.vector([1, -largest, largest], 3, "v") == (1.0, -largest, largest)
    for wrong in ([1, 2], [1, 2, 3, 4], [1, 2, float("inf")], [1, 2, True], (1, 2, 3), None):
        with pytest.raises(DamagedRecording, match="v is not a list of 3 finite numbers"):
            checks.vector(wrong, 3, "v")


def test_huge_numbers_are_not_written_out() -> None:
    """Name a number of thirty-one digits without its digits, and write out one of thirty."""
    for value, said in ((10**30, "a huge number"), (-(10**30), "a huge number"), (10**30 - 1, "9" * 30)):
        with pytest.raises(DamagedRecording) as refused:
            checks.whole({"n": value}, "n", 0, 1)
        assert str(refused.value).endswith(f": {said}")


@pytest.mark.parametrize(
    ("read", "taken", "refused"),
    [
        (checks.text, ["", "a"], [1, None, ["a"]]),
        (checks.flag, [True, False], [0, 1, "true", None]),
        (checks.mapping, [{}, {"a": 1}], [[], None, "a"]),
        (checks.items, [[], [1, "a"]], [{}, None, "a"]),
        (lambda *of: list(checks.texts(*of)), [[], ["a", ""]], ["a", ["a", 1]]),
        (checks.text_map, [{}, {"a": "b"}], [[], {"a": 1}]),
        (checks.objects, [[], [{}, {"a": 1}]], [{}, [1]]),
    ],
)
def test_kinds_of_values(read: Callable[[dict[str, Any], str], Any], taken: list[Any], refused: list[Any]) -> None:
    """Return a value of the right kind as it is, and name any other."""
    for value in taken:
        assert read({"key": value}, "key") == value
    for value in refused:
        with pytest.raises(DamagedRecording, match=" is n"):
            read({"key": value}, "key")


def test_values_that_are_missing() -> None:
    """Take a default where there is one, nothing for a collection and false for a flag; refuse the rest."""
    assert checks.text({}, "key", default="d") == "d"
    assert (checks.flag({}, "key"), checks.mapping({}, "key"), checks.items({}, "key")) == (False, {}, [])
    for read in (lambda: checks.text({}, "key"), lambda: checks.whole({}, "key", 0, 9)):
        with pytest.raises(DamagedRecording, match="key is not"):
            read()


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"a": NaN}', '{"a": Infinity}', "{}{}"])
def test_what_is_no_object(text: str) -> None:
    """Refuse what is not JSON, and JSON that is no object."""
    with pytest.raises(DamagedRecording, match=r"^name is not "):
        checks.load("name", text)


@pytest.mark.parametrize("value", [0, 1, 0x7F, 0x80, 300, 2**32, 2**63, 2**64 - 1])
def test_varints_come_back(value: int) -> None:
    """Read a number of up to 64 bits as it was written, in a field of its number."""
    message = wire.varint(9 << 3 | wire.VARINT) + wire.varint(value)
    (field,) = wire.fields(memoryview(message))
    assert (field.number, field.kind, field.value, bytes(field.payload), bytes(field.whole)) == (
        9,
        0,
        value,
        b"",
        message,
    )
    assert len(wire.varint(value)) == max(1, -(-value.bit_length() // 7))


def test_fields_keep_their_places() -> None:
    """Return fields of every wire type in their order, each with its bytes."""
    parts = [b"\x0d" + bytes(4), wire.delimited_head(300, 3) + b"abc", b"\x11" + bytes(8), b"\x18\x05"]
    found = list(wire.fields(memoryview(b"".join(parts))))
    assert [bytes(field.whole) for field in found] == parts
    assert [(field.number, field.kind) for field in found] == [(1, 5), (300, wire.LENGTH_DELIMITED), (2, 1), (3, 0)]
    assert bytes(found[1].payload) == b"abc"


@pytest.mark.parametrize(
    "data", [b"\x80" * 10 + b"\x01", b"\x08", b"\x08\x80", b"\x0a\x03ab", b"\x0d\x00\x00\x00", b"\x0b", b"\x0e"]
)
def test_what_is_no_message(data: bytes) -> None:
    """Refuse a varint of more than ten bytes, a field that is cut short, and a wire type that does not exist."""
    with pytest.raises(ValueError, match="varint|cut short|wire type"):
        list(wire.fields(memoryview(data)))


@pytest.mark.parametrize("size", [0, 1, 3, 127, 128, 5000, 2**40 + 1])
def test_the_size_of_a_field_from_its_head(size: int) -> None:
    """Give the size of a field with tag and length from its first bytes, and None of what is no such field."""
    head = wire.delimited_head(17, size)
    for behind in (b"", b"abc"):
        assert wire.delimited_size(memoryview(head + behind)) == len(head) + size
    assert wire.delimited_size(memoryview(head[:-1])) is None
    assert wire.delimited_size(memoryview(b"")) is None
    assert wire.delimited_size(memoryview(b"\x08\x05")) is None


BOARD = {
    "board": "board",
    "bodies": [
        {"name": "board", "group": "", "position": [1.0, 0.5, 0.0], "shape": {"kind": "box", "size": [2.0, 1.0, 0.1]}},
        {"name": "a", "group": "cubes", "position": [0, 0, 3], "shape": {"kind": "box", "size": [0.2, 0.1, 0.3]}},
        {"name": "b", "group": "cubes", "position": [0, 0, 0], "shape": {"kind": "box", "size": [0.4, 0.4, 0.4]}},
    ],
}


def test_the_extent_of_a_board() -> None:
    """Take the board's rectangle around its position, and the smallest edge of the group's boxes."""
    extent = extent_of(BOARD, "cubes")
    assert extent == Extent("the board", (0.0, 0.0), (2.0, 1.0), 0.1)
    assert extent.side == 2.0
    assert Extent("", (0.0, -3.0), (2.0, 1.0), 0.0).side == 4.0


def test_the_extent_of_a_scene_without_a_board() -> None:
    """Take the rectangle around all bodies by their reach, widened by the height that they fall from."""
    bodies = [
        {"name": "p", "group": "", "position": [9, 9, 9], "shape": {"kind": "plane"}},
        {"name": "s", "group": "g", "position": [1, 2, 3], "shape": {"kind": "sphere", "radius": 0.5}},
        {"name": "c", "group": "g", "position": [-1, 0, 1], "shape": {"kind": "capsule", "radius": 0.5, "length": 2.0}},
        {"name": "b", "group": "g", "position": [0, 4, 0], "shape": {"kind": "box", "size": [2.0, 4.0, 4.0]}},
    ]
    extent = extent_of({"bodies": bodies}, "none")
    # reach: 0.5, 1.5, 3; the sphere's top is at 3.5
    assert (extent.what, extent.edge) == ("the scene", 0.0)
    assert (extent.low, extent.high) == ((-3.0 - 3.5, -1.5 - 3.5), (3.0 + 3.5, 7.0 + 3.5))
    assert extent_of({"bodies": bodies[:1]}, "g") is None


EXTENT = Extent("the board", (0.0, 0.0), (1.0, 0.5), 0.05)
PLACED = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 3), np.linspace(0.1, 0.4, 3)), axis=-1).reshape(1, 9, 2)


def test_positions_in_their_unit_raise_no_doubt() -> None:
    """Say nothing of positions within the extent, nor where fewer than half of the bodies are beside it."""
    assert unit_doubt(PLACED, "m", ["t"], EXTENT) is None
    some = PLACED.copy()
    some[0, :4] += 50.0
    assert unit_doubt(some, "m", ["t"], EXTENT) is None


def test_the_unit_that_would_fit_is_named() -> None:
    """Call a unit wrong where another fits and half of the bodies are far away, with the median distance."""
    doubt = unit_doubt(np.concatenate([PLACED, PLACED * 100, PLACED * 100]), "m", ["one", "two", "three"], EXTENT)
    assert doubt.wrong
    assert doubt.text.startswith("trial two (and 1 more of 3): half of its bodies lie ")
    assert doubt.text.endswith(" m or more beside the board: m cannot be its unit; cm would fit")
    beside = np.hypot(*np.maximum(PLACED[0] * 100 - [1.0, 0.5], 0).T)
    assert f" {np.median(beside):.3g} m or more" in doubt.text
    millimetres = unit_doubt(PLACED * 1000, "m", ["t"], EXTENT)
    assert millimetres.text.endswith("m cannot be its unit; mm would fit")
    assert millimetres.text.startswith("trial t: ")


def test_positions_a_little_beside_only_may_be_wrong() -> None:
    """Ask the reader to look where half of the bodies are beside the extent by less than its length."""
    for away, wrong in ((0.9, False), (1.6, False)):
        doubt = unit_doubt(PLACED + [away, 0.0], "m", ["t"], EXTENT)
        assert doubt.wrong is wrong
        assert ": m may not be its unit" in doubt.text


def test_bodies_on_top_of_each_other_are_in_another_unit() -> None:
    """Find a heap by the room that the bodies' edges leave, and name the unit that spreads it."""
    doubt = unit_doubt(PLACED * 0.01, "cm", ["t"], EXTENT)
    assert doubt.wrong
    assert (
        "its 9 bodies with edges of 0.05 m lie within 0.008 m by 0.003 m: cm cannot be its unit; m would fit"
        in doubt.text
    )
    assert unit_doubt(PLACED * 0.01, "cm", ["t"], Extent("the board", (0.0, 0.0), (1.0, 0.5), 0.0)) is None
