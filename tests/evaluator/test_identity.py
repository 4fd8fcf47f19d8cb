"""Bitwise classes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.identity import bitwise_classes, changes, count_distinct, distinct_over_time


def test_classes_in_order_of_appearance() -> None:
    """Number classes by the first appearance of their members."""
    samples = np.array([[3.0, 1.0], [2.0, 2.0], [3.0, 1.0], [0.0, 0.0], [2.0, 2.0]])
    assert bitwise_classes(samples).tolist() == [0, 1, 0, 2, 1]
    assert count_distinct(samples) == 3


def test_signed_zeros_differ() -> None:
    """Tell -0.0 from 0.0."""
    assert count_distinct(np.array([[0.0], [-0.0]], dtype=np.float32)) == 2


def test_nan_payloads_count() -> None:
    """Join NaNs of one payload and part those of different payloads."""
    bits = np.array([[0x7FC00000], [0x7FC00001], [0x7FC00000]], dtype=np.uint32)
    assert bitwise_classes(bits.view(np.float32)).tolist() == [0, 1, 0]


def test_one_ulp_differs() -> None:
    """Tell neighbouring floats apart."""
    one = np.float32(1.0)
    assert count_distinct(np.array([one, np.nextafter(one, np.float32(2.0))])) == 2


def test_order_of_items_counts() -> None:
    """Tell envs apart whose items swapped places."""
    env = np.arange(6.0).reshape(3, 2)
    assert count_distinct(np.stack([env, env[::-1]])) == 2


def test_memory_layout_does_not_count() -> None:
    """Ignore how an array lies in memory."""
    samples = np.random.default_rng(0).integers(0, 2, size=(20, 3, 2)).astype(np.float64)
    assert np.array_equal(bitwise_classes(np.asfortranarray(samples)), bitwise_classes(samples))


def test_no_samples() -> None:
    """Count zero classes in nothing."""
    assert count_distinct(np.zeros((0, 27, 2))) == 0


@pytest.mark.parametrize("samples", [1.0, np.array([None, "x"], dtype=object)])
def test_refuses(samples: object) -> None:
    """Refuse what has no samples or no bytes."""
    with pytest.raises(ValueError):
        bitwise_classes(samples)


def brute_force(hashes: np.ndarray) -> tuple[list[int], list[int]]:
    """Distinct samples by row and by history, by comparing bytes."""
    n_row, n = hashes.shape[:2]
    instant = [len({hashes[r, s].tobytes() for s in range(n)}) for r in range(n_row)]
    return instant, [len({hashes[: r + 1, s].tobytes() for s in range(n)}) for r in range(n_row)]


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6), st.booleans())
def test_distinct_over_time(seed: int, n_row: int, n_sample: int, of_runs: bool) -> None:
    """Count instants and histories as comparing bytes does, of envs and of runs."""
    shape = (n_row, n_sample, 2) if of_runs else (n_row, n_sample)
    hashes = np.random.default_rng(seed).integers(0, 3, shape).astype(np.uint64) * np.uint64(2**62)
    found = distinct_over_time(hashes)
    assert (found.instant.tolist(), found.histories.tolist()) == brute_force(hashes)
    assert found.classes.tolist() == bitwise_classes(np.moveaxis(hashes, 1, 0)).tolist()


def test_samples_that_meet_again() -> None:
    """Let the instant fall and never the history, and name the rows of change."""
    hashes = np.array([[1, 1, 1], [1, 2, 2], [1, 2, 2], [5, 5, 6], [7, 7, 7]], dtype=np.uint64)
    found = distinct_over_time(hashes)
    assert found.instant.tolist() == [1, 2, 2, 2, 1]
    assert found.histories.tolist() == [1, 2, 2, 3, 3]
    assert changes(found.instant, found.histories).tolist() == [0, 1, 3, 4]


def test_distinct_over_no_time() -> None:
    """Count nothing over no rows, and refuse what has no samples."""
    empty = distinct_over_time(np.zeros((0, 3), dtype=np.uint64))
    assert (len(empty.instant), changes(empty.instant, empty.histories).tolist(), empty.classes.tolist()) == (
        0,
        [],
        [0, 0, 0],
    )
    for shape in ((3,), (3, 0), (1, 1, 1, 1)):
        with pytest.raises(ValueError, match="hashes"):
            distinct_over_time(np.zeros(shape, dtype=np.uint64))
