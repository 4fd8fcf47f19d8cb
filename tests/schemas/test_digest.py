"""The digest of states does not depend on how their environments are cut into messages."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.digest import ContentDigest, state_name
from gpusimbench.schemas.fields import StateField, array_field

BITS = np.random.default_rng(0).integers(0, 2**32, 2_000_000, dtype=np.uint32)


def field_of(width: int) -> StateField:
    """Numbers of an environment."""
    return array_field("numbers", "float32", (width,))


@given(
    st.lists(st.integers(0, 70), min_size=1, max_size=3),
    st.lists(st.integers(1, 64), min_size=1, max_size=5),
    st.sampled_from([1, 3, 200, 1500]),
)
def test_columns_are_those_of_the_whole_array(fed: list[int], envs: list[int], width: int) -> None:
    """Rows of any bits, small ones that are copied together and large ones, fed in several calls."""
    field, n_env, digest = field_of(width), sum(envs), ContentDigest()
    fed = [min(rows, len(BITS) // (n_env * width)) for rows in fed]
    expected = hashlib.sha256(f"{field.dtype} {n_env} 1 {width}\n".encode())
    for rows in fed:
        whole = BITS[: rows * n_env * width].view("<f4").reshape(rows, n_env, 1, width)
        expected.update(whole.tobytes())
        digest.state_columns(field, n_env, np.split(whole, np.cumsum(envs)[:-1], axis=1))
    assert digest.digests()[state_name(field)] == expected.hexdigest()


@given(st.integers(0, 20), st.integers(1, 9), st.integers(1, 40), st.integers(0, 30), st.sampled_from([1, 3, 900]))
def test_ranges_side_by_side_are_those_of_the_whole_array(
    rows: int, ranges: int, envs: int, rest: int, width: int
) -> None:
    """Ranges of one size in one array, and a smaller one behind them, rows of less and more than is copied at once."""
    n_env = ranges * envs + rest
    field, digest, rows = field_of(width), ContentDigest(), min(rows, len(BITS) // (n_env * width))
    whole = BITS[: rows * n_env * width].view("<f4").reshape(rows, n_env, 1, width)
    even = whole[:, : ranges * envs].reshape(rows, ranges, envs, 1, width).swapaxes(0, 1).copy()
    last = whole[np.newaxis, :, ranges * envs :].copy()
    digest.state_ranges(field, n_env, [even, last] if rest else [even])
    expected = hashlib.sha256(f"{field.dtype} {n_env} 1 {width}\n".encode() + whole.tobytes())
    assert digest.digests()[state_name(field)] == expected.hexdigest()


@given(st.integers(1, 20), st.integers(1, 300), st.integers(0, 9), st.sampled_from([1, 3, 900]), st.sampled_from("<>"))
def test_rows_with_gaps_are_those_without(rows: int, envs: int, gap: int, width: int, order: str) -> None:
    """Rows of an array that lie apart in one that holds others, too, less and more than is copied at once."""
    field, digest, rows = field_of(width), ContentDigest(), min(rows, len(BITS) // (envs * width + gap))
    around = BITS[: rows * (envs * width + gap)].view("<f4").reshape(rows, -1).astype(f"{order}f4")
    digest.state(field, envs, around[:, gap:].reshape(rows, envs, 1, width))
    whole = around[:, gap:].astype("<f4").tobytes()
    expected = hashlib.sha256(f"{field.dtype} {envs} 1 {width}\n".encode() + whole)
    assert digest.digests()[state_name(field)] == expected.hexdigest()


def test_ranges_side_by_side_take_a_call_a_megabyte(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let go of the interpreter's lock once a megabyte: a thread that launches kernels waits whenever it is taken."""
    sizes: list[int] = []

    class Counted:
        def __init__(self, data: bytes) -> None:
            self._hash = sha256(data)

        def update(self, data: memoryview) -> None:
            sizes.append(len(data))
            self._hash.update(data)

    sha256 = hashlib.sha256
    monkeypatch.setattr(hashlib, "sha256", Counted)
    ranges = BITS[: 64 * 16 * 10 * 100].view("<f4").reshape(64, 10, 16, 1, 100)
    ContentDigest().state_ranges(field_of(100), 64 * 16, [ranges])
    assert sizes == [819200] * 5


@pytest.mark.parametrize("width", [1, 3000])
def test_columns_of_other_lengths_are_refused(width: int) -> None:
    """A row that a range of environments lacks is none of the identity."""
    columns = [np.zeros((rows, 4, 1, width), np.float32) for rows in (3, 2)]
    with pytest.raises(ValueError):  # noqa: PT011  as numpy and zip say it
        ContentDigest().state_columns(field_of(width), 8, columns)
