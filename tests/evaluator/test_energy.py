"""Energy distance and its permutation test."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.stats import energy_distance as of_a_line

from gpusimbench.evaluator.statistics import energy
from gpusimbench.evaluator.statistics.energy import energy_distance, env_pair_means


def envs(n_env: int, seed: int, shift: float = 0.0, n_item: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).normal(shift, 1.0, size=(n_env, n_item, 2))


def mean_distance(a: np.ndarray, b: np.ndarray, *, skip: int = 0) -> float:
    """Mean over pairs of points, one by one; `skip` leaves out pairs of the same env of so many items."""
    found = [
        float(np.hypot(*(p - q)))
        for (i, p), (j, q) in product(enumerate(a.reshape(-1, 2)), enumerate(b.reshape(-1, 2)))
        if not skip or i // skip != j // skip
    ]
    return float(np.mean(found))


@pytest.mark.parametrize("sizes", [(4, 3), (2, 2)])
def test_definition(sizes: tuple[int, int]) -> None:
    """Be 2 E|X-Y| - E|X-X'| - E|Y-Y'|, pair by pair, with unequal sides, in both statistics."""
    a, b = envs(sizes[0], 0), envs(sizes[1], 1, shift=0.5)
    found = energy_distance(a, b, n_permutation=9, seed=0)
    assert found.v_statistic == pytest.approx(2 * mean_distance(a, b) - mean_distance(a, a) - mean_distance(b, b))
    unbiased = 2 * mean_distance(a, b) - mean_distance(a, a, skip=5) - mean_distance(b, b, skip=5)
    assert found.u_statistic == pytest.approx(unbiased)


def test_agrees_with_scipy_on_a_line() -> None:
    """Give scipy's value, which is the root of this one, for points on a line."""
    a, b = envs(6, 2), envs(4, 3, shift=0.3)
    a[..., 1] = b[..., 1] = 0.0
    expected = of_a_line(a[..., 0].ravel(), b[..., 0].ravel()) ** 2
    assert energy_distance(a, b, n_permutation=9, seed=0).v_statistic == pytest.approx(expected)


def test_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the same sums however few distances are held at a time."""
    points = envs(7, 4)
    whole = env_pair_means(points)
    monkeypatch.setattr(energy, "_BLOCK_NUMBERS", 60)
    assert np.allclose(env_pair_means(points), whole, rtol=1e-14)
    assert np.array_equal(whole, whole.T)


def test_permutations_are_those_of_the_points() -> None:
    """Add sums up anew to what the points of the dealt envs give."""
    a, b = envs(3, 5), envs(4, 6)
    a[1] = b[2][::-1]  # one env on both sides, in another order
    found = energy_distance(a, b, n_permutation=40, seed=7)
    pool, rng = np.concatenate([a, b]), np.random.default_rng(7)
    values = []
    for _ in range(40):
        order = rng.permutation(7)
        values.append(energy_distance(pool[order[:3]], pool[order[3:]], n_permutation=1, seed=0).v_statistic)
    assert found.floor_mean == pytest.approx(np.mean(values))
    assert found.p_value == (1 + sum(v >= found.v_statistic - 1e-12 for v in values)) / 41


def test_same_points_have_distance_zero() -> None:
    """Give zero and p one for the same envs on both sides, and for one env throughout."""
    a = envs(6, 8)
    same = energy_distance(a, a[::-1], n_permutation=99, seed=0)
    assert (same.v_statistic, same.p_value) == (0.0, 1.0)
    one = np.repeat(envs(1, 9), 5, axis=0)
    alike = energy_distance(one, one, n_permutation=99, seed=0)
    assert (alike.v_statistic, alike.p_value, alike.floor_q95) == (0.0, 1.0, pytest.approx(0.0, abs=1e-12))


def test_shift_is_found_and_grows() -> None:
    """Give a small p for a clear shift, and a larger value for a larger one."""
    near, far = (energy_distance(envs(8, 0), envs(8, 1, shift=s), n_permutation=999, seed=0) for s in (1.0, 3.0))
    assert max(near.p_value, far.p_value) <= 0.005
    assert far.v_statistic > near.v_statistic > near.floor_q95 > near.floor_mean


def test_u_statistic_has_no_bias_and_p_is_uniform() -> None:
    """Average to zero under one law, where items of an env belong together, and reject as often as the level says."""
    u, p = [], []
    for i in range(300):
        rng = np.random.default_rng(i)
        pool = rng.normal(size=(10, 4, 2)) + 2 * rng.normal(size=(10, 1, 2))
        found = energy_distance(pool[:4], pool[4:], n_permutation=99, seed=i)
        assert found.u_statistic is not None
        u.append(found.u_statistic)
        p.append(found.p_value)
    error = np.std(u, ddof=1) / np.sqrt(len(u))
    assert abs(np.mean(u)) < 4 * error
    assert 0.05 <= np.mean(np.array(p) <= 0.1) <= 0.16


def test_single_envs_have_no_unbiased_value() -> None:
    """Give no U-statistic where a side has one env."""
    assert energy_distance(envs(1, 0), envs(3, 1), n_permutation=9, seed=0).u_statistic is None


@pytest.mark.parametrize(
    ("a", "b", "n", "message"),
    [
        (envs(2, 0), envs(2, 0), 0, "n_permutation"),
        (envs(2, 0), envs(2, 0, n_item=4), 9, "items"),
        (np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), 9, "planar"),
        (np.full((2, 3, 2), np.nan), envs(2, 0, n_item=3), 9, "non-finite"),
        (envs(2, 0) * 1e300, envs(2, 1) * 1e308, 9, "overflow|non-finite"),
    ],
)
def test_refuses(a: Any, b: Any, n: int, message: str) -> None:
    """Refuse what has no such distance."""
    with pytest.raises(ValueError, match=message):
        energy_distance(a, b, n_permutation=n, seed=0)


def test_refuses_more_than_memory_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse too many distinct envs before their matrix is made; equal ones count once."""
    monkeypatch.setattr(energy, "MAX_ENVS", 4)
    with pytest.raises(ValueError, match="6 distinct envs"):
        energy_distance(envs(3, 0), envs(3, 1), n_permutation=9, seed=0)
    energy_distance(envs(2, 0)[[0, 1, 0, 1]], envs(2, 1), n_permutation=9, seed=0)
