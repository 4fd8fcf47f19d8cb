"""Permutation floor of W1."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.statistics import permutation
from gpusimbench.evaluator.statistics.permutation import arrangements, exhaustive_floor, permutation_floor
from gpusimbench.evaluator.transport.pair import Transport


def envs(n_env: int, seed: int, shift: float = 0.0, n_item: int = 27) -> np.ndarray:
    return np.random.default_rng(seed).normal(shift, 1.0, size=(n_env, n_item, 2))


def test_identical_envs() -> None:
    """Skip the draw where all envs are the same: floor zero, p one."""
    a = np.stack([envs(1, 0)[0]] * 16)
    result = permutation_floor(a, a, n_permutation=19, seed=0)
    assert (result.observed, result.floor_mean, result.floor_q95, result.p_value) == (0, 0, 0, 1)


def test_shifted_law_is_found() -> None:
    """Reach the smallest possible p for clouds far apart."""
    result = permutation_floor(envs(8, 0), envs(8, 1, shift=5.0), n_permutation=19, seed=0)
    assert result.p_value == 1 / 20
    assert result.observed > result.floor_q95 >= result.floor_mean > 0.0


def test_p_is_uniform_under_the_same_law() -> None:
    """Reject one and the same law about as often as the level says."""
    p = [
        permutation_floor(envs(4, 2 * i, n_item=3), envs(4, 2 * i + 1, n_item=3), n_permutation=9, seed=i).p_value
        for i in range(100)
    ]
    assert 0.02 <= np.mean(np.array(p) <= 0.1) <= 0.2


def test_equal_sides_have_p_one() -> None:
    """Give p one where both sides hold the same envs."""
    a = envs(6, 4)
    result = permutation_floor(a, a[::-1], n_permutation=19, seed=0)
    assert (result.observed, result.p_value) == (0.0, 1.0)
    assert result.floor_mean > 0.0


def test_whole_envs_are_exchanged() -> None:
    """Keep the items of an env together."""
    low, high = np.zeros((27, 2)), np.ones((27, 2))
    result = permutation_floor([low, high], [low, high], n_permutation=50, seed=0)
    # Two envs a side: either one of each kind (0) or one kind a side (sqrt 2), nothing between.
    assert result.floor_q95 == pytest.approx(np.sqrt(2.0))
    assert 0.2 < result.floor_mean / np.sqrt(2.0) < 0.5


def test_equal_arrangements_are_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve each arrangement of identical envs once."""
    solved = []
    solve = permutation.wasserstein1
    monkeypatch.setattr(permutation, "wasserstein1", lambda a, b, **k: solved.append(1) or solve(a, b, **k))
    low, high = np.zeros((27, 2)), np.ones((27, 2))
    permutation_floor([low] * 4, [low] * 3 + [high], n_permutation=99, seed=0)
    assert len(solved) == 1  # the odd one is on either side, and the sides are of one size
    permutation_floor([low] * 4, [low] * 2 + [high], n_permutation=99, seed=0)
    assert len(solved) == 3


def test_seed_decides() -> None:
    """Repeat under one seed."""
    a, b = envs(4, 5, n_item=5), envs(4, 6, n_item=5)
    first, again, other = (permutation_floor(a, b, n_permutation=9, seed=s) for s in (1, 1, 2))
    assert first == again
    assert first.floor_mean != other.floor_mean
    assert first.observed == other.observed


def test_unequal_sides() -> None:
    """Mark sides of different size as an extension."""
    result = permutation_floor(envs(3, 0), envs(5, 1), n_permutation=5, seed=0)
    assert result.extension is not None


@pytest.mark.parametrize(
    ("a", "b", "n", "message"),
    [
        (np.zeros((2, 3, 2)), np.zeros((2, 4, 2)), 9, "different shape"),
        (np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), 0, "n_permutation"),
        (np.full((2, 3, 2), np.nan), np.zeros((2, 3, 2)), 9, "non-finite"),
        (np.zeros((3, 2)), np.zeros((2, 3, 2)), 9, "3 axes"),
    ],
)
def test_refuses(a: np.ndarray, b: np.ndarray, n: int, message: str) -> None:
    """Name what is wrong with envs that cannot be exchanged."""
    with pytest.raises(ValueError, match=message):
        permutation_floor(a, b, n_permutation=n, seed=0)


@pytest.mark.parametrize(("a", "b", "count"), [(1, 19, 20), (2, 5, 21), (4, 4, 35)])
def test_all_arrangements(a: int, b: int, count: int) -> None:
    """Give the share of one arrangement for clouds far apart, also of copies, and one for sides that are equal."""
    for low, high in ((envs(a, 0, n_item=3), envs(b, 1, 50.0, 3)), (np.zeros((a, 3, 2)), np.ones((b, 3, 2)))):
        result = exhaustive_floor(low, high)
        assert (arrangements(a, b), result.n_permutation, result.p_value) == (count, count, 1 / count)
    same = exhaustive_floor(np.ones((a, 3, 2)), np.ones((b, 3, 2)))
    assert (same.observed, same.p_value) == (0.0, 1.0)


def test_the_draw_comes_near_all_arrangements() -> None:
    """Agree with a long draw in p-value and floor."""
    a, b = envs(3, 0, n_item=3), envs(4, 1, shift=0.7, n_item=3)
    every, drawn = exhaustive_floor(a, b), permutation_floor(a, b, n_permutation=2000, seed=0)
    assert every.observed == drawn.observed
    assert every.p_value == pytest.approx(drawn.p_value, abs=0.03)
    assert every.floor_mean == pytest.approx(drawn.floor_mean, rel=0.03)


def test_exhaustive_p_is_valid_under_the_same_law() -> None:
    """Reject one and the same law no more often than the level says."""
    p = [exhaustive_floor(envs(2, 2 * i, n_item=3), envs(4, 2 * i + 1, n_item=3)).p_value for i in range(100)]
    assert np.mean(np.array(p) <= 0.1) <= 0.15


def test_deals_may_be_solved_elsewhere() -> None:
    """Give the same test where others compute the distances, in any order."""
    a, b = envs(3, 0, n_item=2), envs(3, 1, n_item=2) + 0.1

    def backwards(function: Callable[[Any], Any], items: Iterable[Any], /) -> list[Any]:
        return [function(item) for item in list(items)[::-1]][::-1]

    floor = partial(permutation_floor, n_permutation=30, seed=4)
    assert floor(a, b, mapper=backwards) == floor(a, b)


def test_deals_are_drawn_before_any_is_solved() -> None:
    """Hand over all deals that differ at once, so that they can be spread."""
    batches = []

    def mapper(function: Callable[[Any], Any], items: Iterable[Any], /) -> list[Any]:
        batches.append(len(items := list(items)))
        return [function(item) for item in items]

    permutation_floor(envs(3, 0, n_item=2), envs(3, 1, n_item=2), n_permutation=50, seed=0, mapper=mapper)
    assert batches == [9]  # ways to deal 3 and 3 that W1 tells apart, but for the observed one


def test_bounds_are_not_ranked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse distances that are only known between bounds."""
    bounds = Transport(1.0, "certified", "", None, 0.9, 1.0)
    monkeypatch.setattr(permutation, "wasserstein1", lambda a, b, **_: bounds)
    with pytest.raises(ValueError, match="too many points"):
        permutation_floor(envs(2, 0), envs(2, 1), n_permutation=1, seed=0)
