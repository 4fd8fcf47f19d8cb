"""W1: hand-computed cases, metric axioms, agreement of the solvers."""

from __future__ import annotations

import itertools
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from evaluator.transport import pair, simplex
from evaluator.transport.pair import UNEQUAL_COUNTS, wasserstein1
from evaluator.transport.small import pairwise_wasserstein1

COORDINATE = st.floats(-10.0, 10.0, width=32)
# Few distinct values: ties and duplicates are the rule.
COARSE = st.integers(-1, 1).map(float)
FEW = settings(max_examples=40, deadline=None)


def several(n_set: int, elements: st.SearchStrategy[float] = COORDINATE):
    """Strategy: `n_set` planar point sets of one size, shape [n_set, n, 2]."""
    return st.integers(1, 6).flatmap(lambda n: arrays(np.float64, (n_set, n, 2), elements=elements))


def brute_force(a: np.ndarray, b: np.ndarray) -> float:
    """W1 by trying every assignment."""
    return min(
        float(np.mean(np.linalg.norm(a - b[list(order)], axis=1))) for order in itertools.permutations(range(len(b)))
    )


def cloud(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 2))


@pytest.mark.parametrize("n", [1, 27, pair.ASSIGNMENT_LIMIT + 200])
def test_shifted_copy(n: int) -> None:
    """Measure the length of the shift between a set and its shifted copy."""
    a = cloud(n, 0)
    assert wasserstein1(a, a + [0.3, -0.4]).value == pytest.approx(0.5, rel=1e-12)


def test_swapped_items_are_exactly_zero() -> None:
    """Return exactly zero for the same points in another order."""
    a = cloud(27, 1)
    result = wasserstein1(a, a[::-1])
    assert result.value == 0.0
    assert (result.exactness, result.extension) == ("exact", None)


def test_signed_zeros_are_the_same_place() -> None:
    """Return exactly zero where only the sign of a zero differs."""
    assert wasserstein1([[0.0, 1.0]], [[-0.0, 1.0]]).value == 0.0


def test_one_moved_item() -> None:
    """Spread the way of one moved item over all items."""
    a = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    b = a.copy()
    b[24] += [2.0, 0.0]  # a corner, moved outward
    assert wasserstein1(a, b).value == pytest.approx(2.0 / 25)


def test_one_dimension_is_the_sorted_difference() -> None:
    """Agree with the closed form on a line."""
    a, b = cloud(40, 2)[:, :1], cloud(40, 3)[:, :1]
    expected = np.abs(np.sort(a, axis=0) - np.sort(b, axis=0)).mean()
    assert wasserstein1(a, b).value == pytest.approx(expected)


@FEW
@given(several(2, COARSE) | several(2))
def test_equals_brute_force(sets: np.ndarray) -> None:
    """Find the optimum over all permutations, ties and duplicates included."""
    a, b = sets
    assert wasserstein1(a, b).value == pytest.approx(brute_force(a, b), abs=1e-12)


@FEW
@given(several(3) | several(3, COARSE))
def test_metric_axioms(sets: np.ndarray) -> None:
    """Hold identity, symmetry and the triangle inequality."""
    a, b, c = sets
    ab, bc, ac = (wasserstein1(*x).value for x in ((a, b), (b, c), (a, c)))
    assert wasserstein1(a, a).value == 0.0
    assert ab >= 0.0
    assert wasserstein1(b, a).value == pytest.approx(ab, abs=1e-12)
    assert ac <= ab + bc + 1e-12


@FEW
@given(several(2), st.randoms(use_true_random=False), COORDINATE)
def test_invariance(sets: np.ndarray, random, shift: float) -> None:
    """Ignore the order of points and a translation of both sets."""
    a, b = sets
    order = list(range(len(a)))
    random.shuffle(order)
    expected = pytest.approx(wasserstein1(a, b).value, abs=1e-12)
    assert wasserstein1(a[order], b).value == expected
    assert wasserstein1(a + shift, b + shift).value == expected


@pytest.mark.parametrize("scale", [1e-15, 1e-6, 1.0, 1e6])
def test_solvers_agree_at_any_scale(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Get the same optimum from both solvers, at distances far below a unit as well."""
    a, b = cloud(150, 4) * scale, cloud(150, 5) * scale
    assigned = wasserstein1(a, b)
    monkeypatch.setattr(pair, "ASSIGNMENT_LIMIT", 10)
    flowed = wasserstein1(a, b)
    assert assigned.method != flowed.method
    assert flowed.value == pytest.approx(assigned.value, rel=1e-12, abs=0.0)


@FEW
@given(several(1), several(1))
def test_unequal_counts(first: np.ndarray, second: np.ndarray) -> None:
    """Equal the assignment between copies repeated to a common count, and say so."""
    a, b = first[0], second[0]
    result = wasserstein1(a, b)
    common = np.lcm(len(a), len(b))
    repeated = wasserstein1(np.repeat(a, common // len(a), 0), np.repeat(b, common // len(b), 0))
    assert result.value == pytest.approx(repeated.value, abs=1e-9)
    assert result.extension == (None if len(a) == len(b) else UNEQUAL_COUNTS)


def test_unequal_counts_by_hand() -> None:
    """Split the weight of one point over two."""
    assert wasserstein1([[0.0, 0.0]], [[1.0, 0.0], [0.0, 3.0]]).value == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (np.zeros((0, 2)), np.zeros((1, 2)), "a is empty"),
        (np.zeros((1, 2)), [[0.0, np.nan]], "b holds non-finite"),
        ([[np.inf, 0.0]], np.zeros((1, 2)), "a holds non-finite"),
        (np.zeros(2), np.zeros((1, 2)), "a must have 2 axes"),
        (np.zeros((1, 3)), np.zeros((1, 2)), "different width"),
        ([[1.5e308, 0.0]], [[-1.5e308, 0.0]], "overflow"),
    ],
)
def test_refuses(a, b, message: str) -> None:
    """Name what is wrong with points that cannot be compared."""
    with pytest.raises(ValueError, match=message):
        wasserstein1(a, b)


def test_refuses_too_many_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse sets whose distance matrix would not fit rather than exhaust memory."""
    monkeypatch.setattr(pair, "MATRIX_LIMIT", 99)
    with pytest.raises(ValueError, match="10 x 10 points are too many"):
        wasserstein1(cloud(10, 0), cloud(10, 1))


def test_raises_without_convergence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise where the solver stops before the optimum."""

    class Stopped:
        @staticmethod
        def emd2(*_: object, **__: object) -> tuple[float, dict[str, str]]:
            return 1.0, {"warning": "numItermax reached"}

    monkeypatch.setattr(simplex, "_pot", lambda: Stopped)
    monkeypatch.setattr(pair, "ASSIGNMENT_LIMIT", 0)
    with pytest.raises(ValueError, match="did not converge: numItermax"):
        wasserstein1(cloud(2, 0), cloud(3, 1))


def test_solvers_load_only_when_needed() -> None:
    """Import the transport modules without importing any solver."""
    code = (
        "import sys, evaluator.transport.small, evaluator.metrics.variability, "
        "evaluator.statistics.permutation, evaluator.statistics.jackknife;"
        "sys.exit(any(m in sys.modules for m in ('scipy', 'ot', 'torch', 'jax')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@FEW
@given(st.integers(1, 5).flatmap(lambda n: several(n, COARSE)))
def test_pairwise_equals_each_pair(points: np.ndarray) -> None:
    """Fill a symmetric matrix with the W1 of every pair, identical sets included."""
    matrix = pairwise_wasserstein1(points)
    assert matrix.shape == (len(points), len(points))
    assert np.array_equal(matrix, matrix.T)
    for i, j in itertools.product(range(len(points)), repeat=2):
        expected = wasserstein1(points[i], points[j]).value
        assert matrix[i, j] == pytest.approx(expected, abs=1e-12)
        assert expected > 0.0 or matrix[i, j] == 0.0


def test_pairwise_solves_each_distinct_pair_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve one pair for many envs that hold two point sets, swapped items among them."""
    from evaluator.transport import small

    solved = []
    solve = small.mean_assignment_distance
    monkeypatch.setattr(small, "mean_assignment_distance", lambda d: solved.append(d.shape) or solve(d))
    a = cloud(27, 6)
    matrix = pairwise_wasserstein1(np.stack([a, a + 1.0, a[::-1], a, a[::-1] + 1.0]))
    assert solved == [(27, 27)]
    assert np.count_nonzero(matrix) == 12
    assert matrix[0, 2] == 0.0


def test_pairwise_joins_signed_zeros(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve nothing where sets differ in the sign of zeros alone."""
    from evaluator.transport import small

    monkeypatch.setattr(small, "mean_assignment_distance", lambda _: pytest.fail("solved"))
    zeros = np.zeros((3, 2))
    assert not pairwise_wasserstein1(np.stack([zeros, -zeros])).any()


def test_pairwise_refuses() -> None:
    """Refuse points without an env axis."""
    with pytest.raises(ValueError, match="3 axes"):
        pairwise_wasserstein1(cloud(3, 0))
