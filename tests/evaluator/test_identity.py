"""Bitwise classes."""

from __future__ import annotations

import numpy as np
import pytest

from evaluator.metrics.identity import bitwise_classes, count_distinct


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
