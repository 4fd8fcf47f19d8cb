"""Variability at a matched number of environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.variability import parallel_variability, run_to_run_variability
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.matched import draws, matched_variability
from gpusimbench.evaluator.transport.pair import wasserstein1


def w1(a: np.ndarray, b: np.ndarray) -> float:
    return wasserstein1(a, b).value


def one_law(n_run: int, n_env: int, seed: int = 0, n_item: int = 3) -> np.ndarray:
    """Runs whose envs are all independent draws of one law."""
    return np.random.default_rng(seed).normal(size=(n_run, n_env, n_item, 2))


@given(st.integers(1, 12), st.integers(1, 12), st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_draws_go_through_all_envs(size: int, more: int, n_draw: int, seed: int) -> None:
    """Draw without repetition within a draw, and evenly over draws."""
    n_env = size + more
    drawn = draws(n_env, size, n_draw, np.random.default_rng(seed))
    assert drawn.shape == (n_draw, size)
    assert all(len(set(d)) == size for d in drawn.tolist())
    assert drawn.min() >= 0
    assert drawn.max() < n_env
    round_of = n_env // size
    for begin in range(0, n_draw, round_of):
        some = drawn[begin : begin + round_of].ravel()
        assert len(set(some.tolist())) == len(some)


def test_all_envs_are_the_published_values() -> None:
    """Give the published variabilities where all envs are drawn."""
    runs = one_law(4, 5)
    (point,) = matched_variability({5: runs}, w1, n_draw=7, seed=0)
    assert point.matched == point.raw
    assert (point.n_draw, point.run_to_run_draw_sd) == (1, None)
    assert point.matched.run_to_run.estimate * 100 == pytest.approx(run_to_run_variability(runs).mean_cm)
    expected = np.mean([parallel_variability(run).mean_cm for run in runs])
    assert point.matched.parallel.estimate * 100 == pytest.approx(expected)


def test_one_law_is_one_value_at_one_size() -> None:
    """Find the same at matched size for one law, where raw values fall with the number of envs."""
    small, large = matched_variability({4: one_law(5, 4), 32: one_law(5, 32, 1)}, w1, n_draw=16, seed=0)
    assert (small.n_env, large.n_env, large.size, large.n_draw) == (4, 32, 4, 16)
    of_small, of_large, raw = small.matched.run_to_run, large.matched.run_to_run, large.raw
    assert not isinstance(raw, Missing)
    assert of_large.estimate == pytest.approx(of_small.estimate, rel=0.2)
    assert raw.run_to_run.estimate < 0.6 * of_small.estimate
    # and the floors say why: nothing but their size is different
    assert raw.floor == pytest.approx(raw.run_to_run.estimate, rel=0.35)
    assert large.matched.floor == pytest.approx(of_large.estimate, rel=0.2)
    assert large.run_to_run_draw_sd > 0


def test_noise_that_grows_with_the_number_of_envs_is_seen() -> None:
    """Tell runs that move as a whole when there are many envs from runs that do not."""
    shaken = one_law(5, 16, 1) + 3 * np.random.default_rng(2).normal(size=(5, 1, 1, 2))
    small, large = matched_variability({4: one_law(5, 4), 16: shaken}, w1, n_draw=8, seed=0)
    assert large.matched.run_to_run.ci95
    assert small.matched.run_to_run.ci95
    assert large.matched.run_to_run.estimate > 2 * small.matched.run_to_run.estimate
    assert large.matched.run_to_run.estimate > 1.2 * large.matched.floor


def test_identical_runs_have_none_at_any_size() -> None:
    """Keep the same envs in all runs, so that identical runs stay identical."""
    same = np.repeat(one_law(1, 12), 3, axis=0)
    (_, point) = matched_variability({3: same[:, :3], 12: same}, w1, n_draw=5, seed=0)
    assert (point.matched.run_to_run.estimate, point.run_to_run_draw_sd) == (0.0, 0.0)
    assert point.matched.parallel.estimate > 0
    for found in (point.matched.run_to_run, point.matched.parallel):
        assert found.ci95 == Missing("the runs do not differ")


def test_what_is_not_computed() -> None:
    """Say why there is no raw value; leave out what one run or one env has not."""
    (point,) = matched_variability({8: one_law(1, 8)}, w1, n_draw=2, seed=0, size=1, max_points=20)
    assert point.raw == Missing("24 points a run are more than 20")
    assert point.matched.run_to_run is None
    assert point.matched.parallel is None
    assert point.matched.floor is None


def test_how_many_points_are_not_too_many() -> None:
    """Compute raw values of 2,000 points a run, and of no more where nobody asks for more."""
    for n_env, n_item, there in ((2, 1000, True), (3, 667, False)):
        (point,) = matched_variability(
            {n_env: one_law(1, n_env, n_item=n_item)}, lambda a, b: 1.0, n_draw=1, seed=0, size=1
        )
        assert bool(point.raw) is there
    assert point.raw == Missing("2001 points a run are more than 2000")


def test_seeded_and_solved_once() -> None:
    """Give the same for one seed, and ask for no distance twice within a draw."""
    asked: list[tuple[bytes, bytes]] = []

    def counting(a: Any, b: Any) -> float:
        asked.append((a.tobytes(), b.tobytes()))
        return w1(a, b)

    runs = {4: np.repeat(one_law(1, 4), 6, axis=0)}
    assert matched_variability(runs, counting, n_draw=1, seed=1) == matched_variability(runs, w1, n_draw=1, seed=1)
    assert len(asked) <= 6 + 1  # pairs of the four envs, which are the same in every run, and the floor


@pytest.mark.parametrize(
    ("runs", "keywords", "message"),
    [
        ({}, {}, "at least one"),
        ({5: one_law(2, 4)}, {}, "have 4"),
        ({4: one_law(2, 4)}, {"size": 5}, "size"),
        ({4: one_law(2, 4)}, {"n_draw": 0}, "one draw"),
        ({4: np.zeros((2, 4, 3, 3))}, {}, "planar"),
    ],
)
def test_refuses(runs: Any, keywords: Any, message: str) -> None:
    """Refuse what cannot be matched."""
    with pytest.raises(ValueError, match=message):
        matched_variability(runs, w1, **{"n_draw": 2, "seed": 0, **keywords})
