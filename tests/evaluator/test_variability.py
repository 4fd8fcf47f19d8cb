"""Parallel and run-to-run variability, and the sim-to-real gap."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import stats

from gpusimbench.evaluator.compute.mapping import serial
from gpusimbench.evaluator.metrics import variability
from gpusimbench.evaluator.metrics.variability import (
    parallel_variability,
    run_to_run_variability,
    sampling_step,
    sim_to_real_gap,
)
from gpusimbench.evaluator.transport import small
from gpusimbench.evaluator.transport.pair import Transport, wasserstein1
from gpusimbench.evaluator.transport.small import pairwise_summary


@pytest.fixture
def env() -> np.ndarray:
    """Positions of 27 items [m], shape [27, 2]."""
    return np.random.default_rng(0).uniform(-0.3, 0.3, size=(27, 2))


@pytest.mark.parametrize(("t_s", "dt", "step"), [(5.0, 0.01, 500), (5.0, 0.003, 1667), (0.0, 1, 0)])
def test_sampling_step(t_s: float, dt: float, step: int) -> None:
    """Round the sampling time to the nearest step."""
    assert sampling_step(t_s, dt) == step


@pytest.mark.parametrize(("t_s", "dt"), [(5.0, 0.0), (-1.0, 0.1), (np.nan, 0.1), (1.0, np.inf)])
def test_sampling_step_refuses(t_s: float, dt: float) -> None:
    """Refuse times that no step has."""
    with pytest.raises(ValueError):
        sampling_step(t_s, dt)


def test_shifted_envs(env: np.ndarray) -> None:
    """Average the shifts over env pairs, in centimetres."""
    result = parallel_variability(np.stack([env, env + [0.01, 0.0], env + [0.03, 0.0]]))
    assert result.matrix_cm[0] == pytest.approx([0.0, 1.0, 3.0])
    assert result.mean_cm == pytest.approx((1.0 + 3.0 + 2.0) / 3)


def test_distinct_envs_are_counted_as_recorded(env: np.ndarray) -> None:
    """Count float32 positions by their own bytes."""
    env = env.astype(np.float32)
    env[0, 0] = 0.0
    neighbour, negated = env.copy(), env.copy()
    neighbour[0, 0] = np.nextafter(np.float32(0.0), np.float32(1.0))
    negated[0, 0] = -0.0
    assert parallel_variability(np.stack([env, neighbour, negated])).n_distinct == 3
    assert parallel_variability(np.stack([env, negated])).mean_cm == 0.0


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        (np.zeros((1, 27, 2)), "needs at least two envs"),
        (np.zeros((2, 27, 3)), "planar"),
        (np.full((2, 27, 2), np.nan), "non-finite"),
    ],
)
def test_envs_that_cannot_be_compared(positions: np.ndarray, said: str) -> None:
    """Refuse a single env, spatial positions, and positions that blew up."""
    with pytest.raises(ValueError, match=said):
        parallel_variability(positions)


def test_shifted_runs(env: np.ndarray) -> None:
    """Give mean and sample deviation over run pairs, each run pooled over its envs."""
    run = np.stack([env, env + 0.001])
    result = run_to_run_variability(np.stack([run, run + [0.01, 0.0], run + [0.03, 0.0]]))
    assert result.mean_cm == pytest.approx(2.0)
    assert result.sd_cm == pytest.approx(1.0)
    assert result.n_distinct == 3


def test_runs_are_pooled_over_envs(env: np.ndarray) -> None:
    """See no difference between runs whose envs swapped places."""
    run = np.stack([env, env + 0.1])
    result = run_to_run_variability(np.stack([run, run[::-1]]))
    assert (result.mean_cm, result.n_distinct) == (0.0, 2)


def test_one_pair_has_no_deviation(env: np.ndarray) -> None:
    """Leave the deviation out for a single pair."""
    result = run_to_run_variability(np.stack([env[None], env[None] + [0.0, 0.02]]))
    assert result.mean_cm == pytest.approx(2.0)
    assert result.sd_cm is None


def test_identical_runs_are_not_solved_twice(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve one pair for ten runs that hold two outcomes, none for one outcome."""
    solved = []
    solve = variability.wasserstein1
    monkeypatch.setattr(variability, "wasserstein1", lambda a, b: solved.append(len(a)) or solve(a, b))
    run = np.stack([env] * 4)
    same = run_to_run_variability(np.stack([run] * 10))
    assert (same.mean_cm, same.sd_cm, same.n_distinct, solved) == (0.0, 0.0, 1, [])
    two = run_to_run_variability(np.stack([run] * 9 + [run + [0.01, 0.0]]))
    assert solved == [4 * 27]
    assert two.mean_cm == pytest.approx(9 / 45)
    assert two.n_distinct == 2


def test_pairs_of_equal_runs_are_told_from_others_in_any_order(env: np.ndarray) -> None:
    """Give the same mean over all pairs, whether these are drawn or not, where an outcome comes back after another."""
    runs = np.stack([env[None] + [shift, 0.0] for shift in (0.0, 0.01, 0.0, 0.03, 0.01)])
    sets = runs.reshape(5, -1, 2)
    drawn = variability._of_some_pairs(sets, np.array([0, 1, 0, 2, 1]), 3, 10, serial)
    every = run_to_run_variability(runs)
    assert (drawn.mean_cm, drawn.sd_cm) == (pytest.approx(every.mean_cm), pytest.approx(every.sd_cm))
    assert (drawn.n_pair, drawn.exactness) == (10, "sampled")


def test_equal_pairs_have_no_deviation() -> None:
    """Give exactly zero deviation where all pairs are equally far apart."""
    runs = np.eye(3)[:, None, :, None] * [0.0421, 0.0]  # each run moves another one of 3 items
    far_apart = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
    result = run_to_run_variability(runs + far_apart)
    assert result.mean_cm == pytest.approx(2 * 4.21 / 3)
    assert result.sd_cm == 0.0


def test_needs_two_runs(env: np.ndarray) -> None:
    """Refuse a single run."""
    with pytest.raises(ValueError, match="needs at least two runs"):
        run_to_run_variability(env[None, None])


def test_many_envs_need_no_matrix(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the same means beyond the number of envs that a matrix is kept for."""
    runs = env + np.random.default_rng(1).normal(size=(12, 27, 2)) * 0.01
    runs = runs[[0, 1, 2, 3, 3, 3, 6, 7, 8, 9, 10, 11]]
    whole = parallel_variability(runs)
    monkeypatch.setattr(variability, "MATRIX_ENVS", 11)
    large = parallel_variability(runs)
    assert large.matrix_cm is None
    assert large.n_distinct == whole.n_distinct == 10
    assert large.mean_cm == pytest.approx(whole.mean_cm, rel=1e-12)
    assert (large.exactness, large.interval_cm) == ("exact", None)


def test_a_sample_of_very_many_envs(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw envs where all pairs would take too long, and hold the mean of all pairs in the interval."""
    runs = env[:3, :] + np.random.default_rng(1).normal(size=(300, 3, 2)) * 0.01
    whole = parallel_variability(runs)
    monkeypatch.setattr(variability, "MAX_DISTINCT", 299)
    monkeypatch.setattr(variability, "SAMPLED_ENVS", 60)
    found, again = parallel_variability(runs), parallel_variability(runs)
    assert (found.exactness, found.n_distinct, found.mean_cm) == ("sampled", 300, again.mean_cm)
    low, high = found.interval_cm
    assert 0 < low < whole.mean_cm < high
    assert high - low < whole.mean_cm


def test_an_interval_over_drawn_envs() -> None:
    """Have the jackknife of the definition, which leaves out one env after the other."""
    points = np.random.default_rng(3).normal(size=(9, 3, 2))
    summary = pairwise_summary(points)
    without = [pairwise_summary(np.delete(points, e, axis=0)).mean for e in range(9)]
    error = np.sqrt(8 / 9 * ((np.array(without) - np.mean(without)) ** 2).sum())
    low, high = variability._interval(summary)
    assert (high - low) / 2 == pytest.approx(error * stats.t.ppf(0.975, 8))
    assert (high + low) / 2 == pytest.approx(summary.mean)


def test_an_interval_does_not_reach_below_zero() -> None:
    """End at zero where one environment of four is so far away that the jackknife would go below."""
    points = np.zeros((4, 3, 2))
    points[3] += 1.0
    low, high = variability._interval(pairwise_summary(points))
    assert low == 0.0
    assert high > 1.0


def test_a_sample_of_large_runs(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pairs of runs where each takes a certified solver, count equal runs among them, and say so."""
    runs = env + np.random.default_rng(1).normal(size=(6, 1, 27, 2)) * 0.01
    runs[1] = runs[0]
    whole = run_to_run_variability(runs)
    assert (whole.exactness, whole.n_pair) == ("exact", 15)
    monkeypatch.setattr(variability, "MATRIX_LIMIT", 27 * 27 - 1)
    monkeypatch.setattr(variability, "MAX_CERTIFIED_POINTS", 6 * 27)
    found = run_to_run_variability(runs)
    assert (found.exactness, found.n_pair, found.matrix_cm) == ("sampled", 6, None)
    assert found.mean_cm == pytest.approx(whole.mean_cm, rel=0.3)
    monkeypatch.setattr(variability, "MAX_CERTIFIED_POINTS", 15 * 27)
    assert run_to_run_variability(runs).n_pair == 15


def test_parts_may_be_made_elsewhere(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the same to the last bit where parts are made by threads, in any order."""
    monkeypatch.setattr(variability, "MATRIX_ENVS", 4)
    monkeypatch.setattr(small, "SUMMARY_ROWS", 2)
    runs = env + np.random.default_rng(1).normal(size=(4, 9, 27, 2)) * 0.01
    with ThreadPoolExecutor(3) as pool:
        assert parallel_variability(runs[0], pool.map) == parallel_variability(runs[0])
        found, expected = run_to_run_variability(runs, pool.map), run_to_run_variability(runs)
    assert (found.mean_cm, found.sd_cm) == (expected.mean_cm, expected.sd_cm)


def test_exact_runs_say_so(env: np.ndarray) -> None:
    """Call values exact that no bounds are needed for."""
    result = run_to_run_variability(np.stack([env[None], env[None] + [0.0, 0.02]]))
    assert (result.exactness, result.low_cm) == ("exact", result.mean_cm)


def test_bounds_of_pairs_are_kept(env: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give upper bounds for values, and the mean of the lower ones, where a pair is not known exactly."""

    def bounded(a: np.ndarray, b: np.ndarray) -> Transport:
        exact = wasserstein1(a, b).value
        return Transport(1.25 * exact, "certified", "", None, 0.75 * exact, 1.25 * exact)

    runs = np.stack([env[None] + [shift, 0.0] for shift in (0.0, 0.01, 0.03)])
    monkeypatch.setattr(variability, "wasserstein1", bounded)
    result = run_to_run_variability(runs)
    assert result.exactness == "certified"
    assert (result.low_cm, result.mean_cm) == (pytest.approx(1.5), pytest.approx(2.5))


def test_drawn_envs_are_different_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw no environment twice: of 21 in a row, the mean over 20 is that of all without one of them."""
    monkeypatch.setattr(variability, "MAX_DISTINCT", 20)
    monkeypatch.setattr(variability, "SAMPLED_ENVS", 20)
    row = np.stack([np.arange(21.0), np.zeros(21)], axis=-1)[:, np.newaxis]
    found = parallel_variability(row)
    apart = np.abs(np.subtract.outer(np.arange(21.0), np.arange(21.0)))
    without = [(apart.sum() - 2 * apart[one].sum()) / (20 * 19) * 100 for one in range(21)]
    assert found.exactness == "sampled"
    assert min(abs(found.mean_cm - mean) for mean in without) < 1e-9


@pytest.fixture
def real() -> np.ndarray:
    """Positions of four trials [m], shape [4, 27, 2]."""
    return np.random.default_rng(0).uniform(-0.3, 0.3, size=(4, 27, 2))


def test_points_are_pooled(real: np.ndarray) -> None:
    """Assign points across envs, not env by env."""
    mixed = np.random.default_rng(1).permutation(real.reshape(-1, 2)).reshape(real.shape)
    assert sim_to_real_gap(mixed, real).value_cm == 0.0


def test_unequal_counts_are_an_extension(real: np.ndarray) -> None:
    """Solve other counts as weighted transport and say so."""
    gap = sim_to_real_gap(np.concatenate([real, real]) + [0.01, 0.0], real)
    assert [gap.low_cm, gap.value_cm] == pytest.approx([1.0, 1.0])
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
