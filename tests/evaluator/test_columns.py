"""Messages that are decoded together hold what protobuf reads of each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.read import messages as module
from gpusimbench.evaluator.read.messages import columns
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.wire import varint

_NUMBERS = {3: ("monotonic_ns", "fixed64"), 4: ("used_bytes", "uint64"), 8: ("other_processes", "uint32")}
_SAMPLE = message_class("gsb.v1.MemorySample")

_samples = st.builds(
    dict,
    monotonic_ns=st.integers(-(1 << 63), (1 << 63) - 1),
    used_bytes=st.integers(0, (1 << 64) - 1) | st.integers(0, 300),
    phase=st.sampled_from(["", "timed", "warm-up"]),
    other_processes=st.none() | st.integers(0, (1 << 32) - 1) | st.integers(0, 300),
)


def _check(contents: list[bytes]) -> Any:
    found = columns([memoryview(content) for content in contents], _SAMPLE.FromString, _NUMBERS)
    for place, message in enumerate(map(_SAMPLE.FromString, contents)):
        stands = found.parsed[found.which[place]]
        assert stands.phase == message.phase
        assert stands.HasField("other_processes") == message.HasField("other_processes")
        assert found.numbers["monotonic_ns"].view(np.int64)[place] == message.monotonic_ns
        for name in ("used_bytes", "other_processes"):
            assert found.numbers[name][place] == getattr(message, name)
    return found


@given(st.lists(_samples, max_size=80))
def test_any_numbers(samples: list[dict[str, Any]]) -> None:
    """Numbers of any size and absent fields are those of protobuf."""
    _check([_SAMPLE(**sample).SerializeToString() for sample in samples])


def test_alike_messages_are_parsed_once() -> None:
    """Of a thousand samples that differ in their numbers, as many are parsed as there are shapes."""
    phases = ("warm-up", "timed")
    made = [_SAMPLE(monotonic_ns=k, used_bytes=1 << 20 | k, phase=phases[k % 2]) for k in range(1, 1001)]
    assert len(_check([sample.SerializeToString() for sample in made]).parsed) == 2


@pytest.mark.parametrize(
    "tail",
    [
        varint(4 << 3) + varint(7),  # a second value, which counts
        b"\xa0\x00" + varint(9),  # a tag of two bytes
        varint(4 << 3) + b"\x85\x80\x00",  # a number of more digits than it needs
        varint(4 << 3) + b"\xff" * 9 + b"\x01",  # the largest number
        varint(8 << 3) + b"\xff" * 5 + b"\x01",  # more than the field has bits
        varint(4 << 3 | 5) + bytes(4),  # another type of field
        b"\x0b\x08\x01\x0c",  # a group
        varint(99 << 3) + b"\x01",  # a field of a later version
    ],
)
def test_unusual_bytes(tail: bytes) -> None:
    """What protobuf reads of unusual bytes is what is read here."""
    head = [_SAMPLE(monotonic_ns=k, used_bytes=k % 2, phase="timed").SerializeToString() for k in range(40)]
    _check([content + tail for content in head] + [content + b"" for content in head])


def test_more_shapes_than_are_looked_for() -> None:
    """Messages of one length and ever another phase are still read."""
    found = _check([_SAMPLE(phase=f"{k:04}").SerializeToString() for k in range(3 * module._SHAPES)])
    assert len(found.parsed) == 3 * module._SHAPES


def test_damage_is_an_error() -> None:
    """A message that cannot be parsed is not passed over among others of its length."""
    good = _SAMPLE(phase="timed").SerializeToString()
    with pytest.raises(Exception, match="(?i)pars|utf"):
        columns([memoryview(good)] * 30 + [memoryview(b"\xff" * len(good))], _SAMPLE.FromString, _NUMBERS)
