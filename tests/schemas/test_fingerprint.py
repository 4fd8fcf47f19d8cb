"""The state hash: as defined, and sensitive to every bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.fingerprint import fingerprint

_MASK = 2**64 - 1


def _reference(words: list[int]) -> int:
    # the definition of the format's description, one Python number at a time
    total = 0
    for index, word in enumerate(words):
        z = (word + (index + 1) * 0x9E3779B97F4A7C15) & _MASK
        z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ z >> 27) * 0x94D049BB133111EB) & _MASK
        total += z ^ z >> 31
    return total & _MASK


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=30))
def test_as_defined_float32(words: list[int]) -> None:
    """Equal the definition for single precision."""
    array = np.array(words, dtype=np.uint32).view(np.float32).reshape(1, -1, 1)
    assert int(fingerprint([array])[0]) == _reference(words)


@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=30))
def test_as_defined_float64(words: list[int]) -> None:
    """Equal the definition for double precision."""
    array = np.array(words, dtype=np.uint64).view(np.float64).reshape(1, -1, 1)
    assert int(fingerprint([array])[0]) == _reference(words)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_bit_counts(dtype: Any) -> None:
    """Change with any single bit of any number."""
    state = np.random.default_rng(0).standard_normal((1, 4, 3)).astype(dtype)
    words = state.view({4: np.uint32, 8: np.uint64}[state.itemsize])
    seen = {int(fingerprint([state])[0])}
    for index in range(words.size):
        for bit in range(8 * state.itemsize):
            words.reshape(-1)[index] ^= words.dtype.type(1 << bit)
            seen.add(int(fingerprint([state])[0]))
            words.reshape(-1)[index] ^= words.dtype.type(1 << bit)
    assert len(seen) == 1 + words.size * 8 * state.itemsize


def test_order_counts() -> None:
    """Tell two bodies that swapped places, and fields in another order, from the original."""
    state = np.random.default_rng(1).standard_normal((1, 2, 3))
    swapped = state[:, ::-1]
    assert fingerprint([state])[0] != fingerprint([swapped])[0]
    assert fingerprint([state, swapped])[0] != fingerprint([swapped, state])[0]


def test_steps_and_environments_are_independent() -> None:
    """Give each step and environment the hash that it has alone."""
    fields = [np.random.default_rng(i).standard_normal((3, 5, 4, w)).astype(np.float32) for i, w in enumerate((3, 4))]
    whole = fingerprint(fields)
    for step in range(3):
        for env in range(5):
            assert whole[step, env] == fingerprint([f[step, env][np.newaxis] for f in fields])[0]


def test_different_leading_shapes_are_refused() -> None:
    """Raise where fields disagree on steps or environments."""
    with pytest.raises(ValueError, match="leading shapes"):
        fingerprint([np.zeros((2, 1, 1)), np.zeros((3, 1, 1))])
