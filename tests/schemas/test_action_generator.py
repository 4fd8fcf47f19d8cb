"""Actions that are stored as their generator: drawn again bit for bit, bounded, and refused where they cannot be."""

from __future__ import annotations

import json
import sys
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas import action_generator
from gpusimbench.schemas.action_generator import (
    MAX_WIDTH,
    Controls,
    Generator,
    JointTargets,
    Streams,
    describe_generator,
    read_generator,
)
from gpusimbench.schemas.block_parts import action_parts, generated_action
from gpusimbench.schemas.blocks import decode_action, decode_state, raw_action
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.mixing import GOLDEN32

_PLACE = {"stride": 1, "sim_time_ns": 5}
_ARM = JointTargets("arm", ("a", "b", "c"), (-1.0, 0.0, -2.5), (1.0, 3.0, 2.5))


@st.composite
def generators(draw: Any) -> Generator:
    """Any generator of joint targets or controls."""
    ends = st.tuples(st.floats(-3, 3, width=32), st.floats(0.015625, 1, width=32)).map(lambda r: (r[0], r[0] + r[1]))
    ranges = draw(st.lists(ends, min_size=1, max_size=9))
    names = tuple(f"joint {number}" for number in range(len(ranges)))
    lower, upper = zip(*ranges, strict=True)
    controls = Controls.within("c", dict(zip(names, ranges, strict=True)))
    made = draw(st.sampled_from([JointTargets("t", names, lower, upper), controls]))
    return Generator(made, draw(st.integers(0, 2**64 - 1)))


@st.composite
def streams(draw: Any, first: int) -> Streams:
    """Any streams of some environments: their own or others, from step 0 on or begun anew."""
    n_env = draw(st.integers(1, 9))
    shift, begun = draw(st.integers(0, 2**24)), draw(st.lists(st.integers(0, 300), min_size=n_env, max_size=n_env))
    return Streams(np.arange(n_env, dtype=np.uint32) + np.uint32(first + shift), np.array(begun, dtype=np.uint32))


def _mix(word: int) -> int:
    word ^= word >> 16
    word = word * 0x85EBCA6B % 2**32
    word ^= word >> 13
    word = word * 0xC2B2AE35 % 2**32
    return word ^ word >> 16


def _target(generator: Generator, env: int, step: int, joint: int) -> float:
    # by the formula of state_block.proto, in Python's own numbers
    actions, seed = generator
    word = 0
    for counter in (seed % 2**32, seed // 2**32):
        word = _mix((word + counter + GOLDEN32) % 2**32)
    for counter in (env, step, joint):
        word = _mix((word + (counter + 1) * GOLDEN32) % 2**32)
    grid = actions.grids_of()[joint]
    first, last = -(-actions.lower[joint] // grid), actions.upper[joint] // grid
    return (first + ((word >> 16) * int(last - first + 1) >> 16)) * grid


@given(generators(), st.integers(0, 2**24 - 9), st.integers(0, 400), st.integers(1, 7), st.data())
def test_a_block_is_drawn_again(generator: Generator, env: int, first: int, rows: int, data: Any) -> None:
    """Give the drawn array from the description and the block alone, and the bytes of the raw block."""
    given_streams = data.draw(streams(env))
    drawn = generator.draw(given_streams, first, rows)
    parts = action_parts(drawn, first_step=first, env_start=env, **_PLACE)
    block = generated_action(parts, given_streams, env)
    again = read_generator(describe_generator(*generator))
    header, array = decode_action(block, again)
    assert array.tobytes() == drawn.tobytes()
    assert (header.first_step, header.steps, header.env_start, header.envs) == (first, rows, env, drawn.shape[1])
    raw = b"".join(bytes(part.data) for part in parts)
    assert b"".join(map(bytes, raw_action(block, again)[1])) == raw
    assert raw_action(raw, again)[1] == (raw,)
    row, place, joint = (data.draw(st.integers(0, size - 1)) for size in drawn.shape)
    step, begun = first + row, int(given_streams.begun[place])
    counted = step - begun if step >= begun else step
    assert float(drawn[row, place, joint]) == _target(again, int(given_streams.env[place]), counted, joint)


@given(generators(), st.integers(0, 2**32 - 9), st.integers(0, 6), st.data())
def test_compiled_code_draws_the_same(generator: Generator, first: int, rows: int, data: Any) -> None:
    """Give the same bits by machine code, as drawn in captures of many actions."""
    pytest.importorskip("numba")
    from gpusimbench.schemas.compiled import action_loop

    given_streams = data.draw(streams(3))
    drawn = generator.draw(given_streams, first, rows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(action_generator, "_fill", action_loop())
        assert generator.draw(given_streams, first, rows).tobytes() == drawn.tobytes()


def test_where_actions_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile for many actions, and for fewer where the library that compiles is loaded already."""
    pytest.importorskip("numba")
    monkeypatch.setattr(action_generator, "_fill", None)
    monkeypatch.delitem(sys.modules, "numba")
    action_generator.expect(action_generator.COMPILED_BYTES - 1)
    assert action_generator._fill is None
    monkeypatch.undo()
    monkeypatch.setattr(action_generator, "_fill", None)
    action_generator.expect(action_generator.COMPILED_BYTES // 10 - 1)
    assert action_generator._fill is None
    action_generator.expect(action_generator.COMPILED_BYTES // 10)
    assert action_generator._fill is not None


def _block(**changes: Any) -> bytes:
    given_streams = Streams.usual(4, 8)
    drawn = Generator(_ARM, 7).draw(given_streams, 20, 5)
    parts = action_parts(drawn, first_step=20, env_start=8, **_PLACE)
    message = message_class("gsb.v1.ActionBlock").FromString(generated_action(parts, given_streams, 8))
    for name, value in changes.items():
        field = getattr(message, name)
        if isinstance(value, list):
            field.extend(value)
        else:
            setattr(message, name, value)
    return message.SerializeToString()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"first_step": 21}, "fails its CRC"),
        ({"env_start": 9}, "fails its CRC"),
        ({"steps": 6}, "fails its CRC"),
        ({"crc32": 0}, "fails its CRC"),
        ({"stream_env": [8, 9, 10, 12]}, "fails its CRC"),
        ({"stream_begun": [0, 0, 0, 1]}, "fails its CRC"),
        ({"steps": 2**32 - 1}, "more than may be drawn"),
        ({"envs": 2**32 - 1}, "more than may be drawn"),
        ({"steps": 0, "envs": 2**32 - 1}, "more than may be drawn"),
        ({"width": 2}, "times 2 numbers"),
        ({"first_step": 2**63}, "does not count"),
        ({"stride": 2}, "does not count"),
        ({"stream_env": [1, 2]}, "streams of other environments"),
        ({"data": [1.0]}, "an array besides"),
        ({"encoding": 1}, "uses encoding 1"),
        ({"encoding": 3}, "uses encoding 3, which this version does not read; update gpusimbench"),
    ],
)
def test_a_changed_block_is_refused(changes: dict[str, Any], said: str) -> None:
    """Refuse what was changed, and counts of which nothing is allocated."""
    assert decode_action(_block(), Generator(_ARM, 7))[1].shape == (5, 4, 3)
    with pytest.raises(DamagedRecording, match=said):
        decode_action(_block(**changes), Generator(_ARM, 7))


def test_another_generator_is_noticed() -> None:
    """Refuse a block whose channel has another seed or no generator, more rows than may be drawn, and states of it."""
    with pytest.raises(DamagedRecording, match="fails its CRC"):
        decode_action(_block(), Generator(_ARM, 8))
    with pytest.raises(DamagedRecording, match="names no generator"):
        decode_action(_block())
    with pytest.raises(DamagedRecording, match="more than may be drawn"):
        decode_action(_block(), Generator(_ARM, 7), most=19)
    assert decode_action(_block(), Generator(_ARM, 7), most=20)[0].crc32 == zlib.crc32(
        Generator(_ARM, 7).draw(Streams.usual(4, 8), 20, 5).tobytes()
    )
    state = message_class("gsb.v1.StateBlock")(steps=1, envs=1, items=1, width=1, encoding=2).SerializeToString()
    with pytest.raises(DamagedRecording, match="uses encoding 2"):
        decode_state(state)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"generator": "philox"}, "'philox', not known here; update gpusimbench"),
        ({"generator": 3}, "not a text"),
        ({"seed": -1}, "seed is not"),
        ({"seed": 2**64}, "seed is not"),
        ({"joints": []}, "makes 0 numbers"),
        ({"joints": ["j"] * (MAX_WIDTH + 1)}, f"not 1 to {MAX_WIDTH}"),
        ({"lower": [0.0]}, "lower of a generator"),
        ({"upper": [-1.5, 3.0, 2.5]}, "range -1 to -1.5"),
        ({"upper": [8.0, 3.0, 2.5]}, "range -1 to 8"),
        ({"upper": [1e300, 3.0, 2.5]}, "range -1 to 1e"),
        ({"generator": "murmur3-fmix32", "grids": [0.0, 1.0, 1.0]}, "in steps of 0"),
        ({"generator": "murmur3-fmix32", "grids": [2.0**128, 1.0, 1.0]}, "in steps of 3.4"),
        ({"generator": "murmur3-fmix32"}, "grids of a generator"),
    ],
)
def test_descriptions_that_are_none(changes: dict[str, Any], said: str) -> None:
    """Refuse a description that no recorder writes, and a generator that is not known, by name."""
    text = json.dumps({**json.loads(describe_generator(_ARM, 7)), **changes})
    with pytest.raises(DamagedRecording, match=said):
        read_generator(text)


def test_actions_that_no_description_gives() -> None:
    """Describe no generator of actions whose own class draws them otherwise, nor of ranges that words do not hold."""

    class Other(JointTargets):
        """Of a third party."""

    assert describe_generator(_ARM, 7)
    assert not describe_generator(Other(_ARM.name, _ARM.joints, _ARM.lower, _ARM.upper), 7)
    assert not describe_generator(JointTargets("wide", ("a",), (-9.0,), (9.0,)), 7)
