"""Published regimes, and how sure one is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.statistics.regimes import (
    REGIME_MEANING,
    Regime,
    Resampling,
    is_present,
    published_regime,
    regime_probabilities,
    upper_bound_of_none,
)

SAME = np.zeros((6, 6))
PUBLISHED = [
    ("Isaac Lab", 4.21, 0.00, 1),
    ("ManiSkill", 4.76, 0.00, 1),
    ("Genesis", 0.00, 0.00, 2),
    ("MJX", 0.00, 0.00, 2),
    ("Madrona", 32.53, 11.47, 3),
    ("MuJoCo Warp", 4.55, 2.15, 3),
    ("Playground", 0.00, 1.39, 4),
]


def clusters(*labels: int, apart: float = 1.0) -> np.ndarray:
    """Distances of runs that end in one of a few outcomes."""
    k = np.array(labels)
    return np.asarray(apart * (k[:, None] != k[None, :]))


@given(st.floats(0.0, 0.02))
def test_present_is_a_threshold(value: float) -> None:
    """Say "present" from one number on, the one that is declared, as rounding does."""
    assert is_present(value) == (value >= 0.005)


def test_threshold_is_the_very_next_number() -> None:
    """Tell the numbers on the two sides of the threshold apart."""
    assert is_present(0.005)
    assert not is_present(math.nextafter(0.005, 0.0))


@pytest.mark.parametrize("method", Resampling)
def test_runs_that_agree_leave_no_doubt_but_the_bound(method: Resampling) -> None:
    """Give probability one to what all runs show, and say what six runs cannot exclude."""
    found = regime_probabilities(np.zeros(6), SAME, np.zeros(6, int), seed=0, n_draw=200, method=method)
    assert (found.observed, found.probabilities) == (Regime.NEITHER, (0.0, 1.0, 0.0, 0.0))
    assert (found.agreement, found.decided_by) == ("bits", ())
    assert found.run_differs_below == pytest.approx(1 - 0.05 ** (1 / 5))
    assert found.parallel_below == pytest.approx(1 - 0.05 ** (1 / 6))


@pytest.mark.parametrize("method", Resampling)
def test_run_drawn_twice_is_no_evidence(method: Resampling) -> None:
    """Never find runs alike that all lie far apart, although resampling draws runs twice."""
    far = 5.0 * (1 - np.eye(6))
    found = regime_probabilities(np.zeros(6), far, np.arange(6), seed=0, n_draw=2000, method=method)
    assert found.probabilities[Regime.RUN_TO_RUN_ONLY - 1] == 1.0
    assert found.run_differs_below is None


@pytest.mark.parametrize("runs", [3, 4])
def test_runs_barely_beyond_the_rounding_stay_so(runs: int) -> None:
    """Not let distances of zero to itself pull a sample below the rounding."""
    near = 1.01 * 0.005 * (1 - np.eye(runs))
    found = regime_probabilities(np.zeros(runs), near, np.arange(runs), seed=1, n_draw=2000)
    assert found.probabilities[Regime.RUN_TO_RUN_ONLY - 1] == 1.0


def test_one_odd_run_decides() -> None:
    """Name the run without which the regime is another, and give the rest its share."""
    found = regime_probabilities(np.zeros(6), clusters(0, 0, 0, 1, 0, 0), [0, 0, 0, 1, 0, 0], seed=0)
    assert found.observed == Regime.RUN_TO_RUN_ONLY
    assert found.decided_by == (3,)
    # the odd run is in a sample with probability 1 - E(1 - w)^6 = 6/11 for w of the Dirichlet law, less what is redrawn
    assert found.probabilities[Regime.RUN_TO_RUN_ONLY - 1] == pytest.approx(6 / 11, abs=0.02)
    assert sum(found.probabilities) == pytest.approx(1.0)


def test_bootstrap_has_its_own_share() -> None:
    """Draw the odd one of six runs in 1 - (5/6)^6 of the samples."""
    found = regime_probabilities(
        np.zeros(6), clusters(0, 0, 0, 1, 0, 0), [0, 0, 0, 1, 0, 0], seed=0, method=Resampling.BOOTSTRAP
    )
    assert found.probabilities[Regime.RUN_TO_RUN_ONLY - 1] == pytest.approx(1 - (5 / 6) ** 6, abs=0.02)


def test_agreement_by_rounding_is_less_than_by_bits() -> None:
    """Say in what runs agree: bits, or distances that round to zero."""
    near = 0.001 * (1 - np.eye(6))
    assert regime_probabilities(np.zeros(6), near, np.arange(6), seed=0, n_draw=9).agreement == "rounding"


def test_runs_that_differ_in_parallel_variability() -> None:
    """Give both types where some runs have parallel variability, and no bound."""
    found = regime_probabilities([1.0, 0, 0, 0, 0, 0], SAME, np.arange(6), seed=0)
    assert found.probabilities[Regime.PARALLEL_ONLY - 1] + found.probabilities[Regime.NEITHER - 1] == pytest.approx(1.0)
    assert 0.3 < found.probabilities[Regime.NEITHER - 1] < 0.6
    assert found.parallel_below is None


def test_seeded() -> None:
    """Give the same for the same seed, another for another."""
    arguments: Any = (np.zeros(6), clusters(0, 0, 1, 1, 0, 0), [0, 0, 1, 1, 0, 0])
    a, b, c = (regime_probabilities(*arguments, seed=s, n_draw=500) for s in (3, 3, 4))
    assert a == b
    assert a.probabilities != c.probabilities


@given(st.integers(1, 200))
def test_bound_is_where_none_becomes_improbable(trials: int) -> None:
    """Be the probability at which nothing happens in 5 % of such trials, near the rule of three."""
    bound = upper_bound_of_none(trials)
    assert (1 - bound) ** trials == pytest.approx(0.05)
    assert bound <= 3 / trials


@pytest.mark.parametrize(
    ("parallel", "matrix", "classes", "message"),
    [
        ([0, 0], np.zeros((2, 2)), [0, 0], "at least 3 runs"),
        ([0, 0, 0], np.zeros((2, 2)), [0, 0, 0], "shapes"),
        ([0, 0, -1], np.zeros((3, 3)), [0, 0, 0], "not negative"),
        ([0, 0, 0], np.ones((3, 3)), [0, 0, 0], "diagonal"),
        ([0, 0, 0], np.diag([0.0, 1.0, 0.0]), [0, 0, 0], "diagonal"),
        ([0, 0, 0], np.zeros((3, 3)), [0, 0], "shapes"),
        ([0, 0, 0], np.triu(np.ones((3, 3)), 1), [0, 0, 0], "symmetric"),
    ],
)
def test_refuses(parallel: Any, matrix: Any, classes: Any, message: str) -> None:
    """Refuse what no regime can be made of."""
    with pytest.raises(ValueError, match=message):
        regime_probabilities(parallel, matrix, classes, seed=0)
    with pytest.raises(ValueError, match="n_draw"):
        regime_probabilities(np.zeros(6), SAME, np.zeros(6, int), seed=0, n_draw=0)
    with pytest.raises(ValueError, match="trials"):
        upper_bound_of_none(0)


def test_halves_are_drawn_without_repeating_a_run() -> None:
    """Find the one odd run of six in half of all halves, and call what differs between runs alone by its name."""
    matrix = np.zeros((6, 6))
    matrix[4, :] = matrix[:, 4] = 1.0
    matrix[4, 4] = 0.0
    found = regime_probabilities(np.zeros(6), matrix, [0, 0, 0, 0, 1, 0], seed=3, method=Resampling.HALF)
    assert found.probabilities[Regime.RUN_TO_RUN_ONLY - 1] == pytest.approx(0.5, abs=0.03)
    assert found.probabilities[Regime.NEITHER - 1] == pytest.approx(0.5, abs=0.03)
    assert (found.observed, found.decided_by) == (Regime.RUN_TO_RUN_ONLY, (4,))


@pytest.mark.parametrize(("simulator", "parallel", "run_to_run", "expected"), PUBLISHED)
def test_published_types(simulator: str, parallel: float, run_to_run: float, expected: int) -> None:
    """Reproduce the published type from the published figures."""
    assert published_regime(parallel, run_to_run) == expected, simulator


@pytest.mark.parametrize(("value", "present"), [(0.0, False), (0.0049, False), (0.0051, True)])
def test_rounding(value: float, present: bool) -> None:
    """Round to 0.01 cm before asking for zero."""
    assert is_present(value) is present


def test_every_regime_has_a_meaning() -> None:
    """Give each type one sentence of its own."""
    assert set(REGIME_MEANING) == set(Regime)
    assert len(set(REGIME_MEANING.values())) == 4


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_no_regime_of_what_is_no_distance(value: float) -> None:
    """Refuse what is no distance."""
    with pytest.raises(ValueError):
        published_regime(0.0, value)
