"""Sim-to-real gap."""

from __future__ import annotations

import numpy as np
import pytest

from gpusimbench.evaluator.metrics.variability import sim_to_real_gap


@pytest.fixture
def real() -> np.ndarray:
    """Positions of four trials [m], shape [4, 27, 2]."""
    return np.random.default_rng(0).uniform(-0.3, 0.3, size=(4, 27, 2))


def test_equal_outcomes(real: np.ndarray) -> None:
    """Measure exactly zero where the trials are reproduced in another order."""
    gap = sim_to_real_gap(real[::-1], real)
    assert (gap.value_cm, gap.exactness, gap.extension) == (0.0, "exact", None)


def test_shift(real: np.ndarray) -> None:
    """Measure a common shift in centimetres."""
    assert sim_to_real_gap(real + [0.03, 0.04], real).value_cm == pytest.approx(5.0)


def test_one_moved_item(real: np.ndarray) -> None:
    """Spread one item's way over all points of all envs."""
    moved = real.copy()
    moved.reshape(-1, 2)[real[..., 0].argmax(), 0] += 1.08
    assert sim_to_real_gap(moved, real).value_cm == pytest.approx(1.0)


def test_points_are_pooled(real: np.ndarray) -> None:
    """Assign points across envs, not env by env."""
    mixed = np.random.default_rng(1).permutation(real.reshape(-1, 2)).reshape(real.shape)
    assert sim_to_real_gap(mixed, real).value_cm == 0.0


def test_unequal_counts_are_an_extension(real: np.ndarray) -> None:
    """Solve other counts as weighted transport and say so."""
    gap = sim_to_real_gap(np.concatenate([real, real]) + [0.01, 0.0], real)
    assert [gap.low_cm, gap.value_cm] == pytest.approx([1.0, 1.0])
    assert gap.extension is not None
    assert "unequal counts" in gap.extension


@pytest.mark.parametrize(
    ("simulated", "message"),
    [
        (np.zeros((4, 8, 2)), "different scenes"),
        (np.zeros((4, 27, 3)), "planar"),
        (np.zeros((27, 2)), "3 axes"),
        (np.full((4, 27, 2), np.inf), "non-finite"),
        (np.zeros((0, 27, 2)), "empty"),
    ],
)
def test_refuses(real: np.ndarray, simulated: np.ndarray, message: str) -> None:
    """Name what is wrong with positions that cannot be compared."""
    with pytest.raises(ValueError, match=message):
        sim_to_real_gap(simulated, real)
