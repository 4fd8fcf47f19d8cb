"""W1: hand-computed cases, metric axioms, agreement of the solvers."""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from gpusimbench.evaluator.transport import pair
from gpusimbench.evaluator.transport.compiled import compiled
from gpusimbench.evaluator.transport.pair import UNEQUAL_COUNTS, wasserstein1
from gpusimbench.evaluator.transport.points import net_mass

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


def test_swapped_items_are_exactly_zero() -> None:
    """Return exactly zero for the same points in another order."""
    a = cloud(27, 1)
    result = wasserstein1(a, a[::-1])
    assert result.value == 0.0
    assert (result.exactness, result.extension) == ("exact", None)


def test_signed_zeros_are_the_same_place() -> None:
    """Return exactly zero where only the sign of a zero differs."""
    assert wasserstein1([[0.0, 1.0]], [[-0.0, 1.0]]).value == 0.0


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
    """Refuse sets for which neither a distance matrix nor bounds fit, rather than exhaust memory."""
    monkeypatch.setattr(pair, "MATRIX_LIMIT", 80)
    monkeypatch.setattr(pair, "REPEATED_LIMIT", 9)
    with pytest.raises(ValueError, match="10 x 9 points are too many"):
        wasserstein1(cloud(10, 0), cloud(9, 1))
    with pytest.raises(ValueError, match="10 x 10 points are too many"):
        wasserstein1(*np.random.default_rng(0).normal(size=(2, 10, 3)))


def test_raises_without_convergence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise where the solver stops before the optimum."""

    class Stopped:
        @staticmethod
        def emd2(*_: object, **__: object) -> tuple[float, dict[str, str]]:
            return 1.0, {"warning": "numItermax reached"}

    monkeypatch.setattr(pair, "_pot", lambda: Stopped)
    monkeypatch.setattr(pair, "ASSIGNMENT_LIMIT", 0)
    with pytest.raises(ValueError, match="did not converge: numItermax"):
        wasserstein1(cloud(2, 0), cloud(3, 1))


def test_solvers_load_only_when_needed() -> None:
    """Import the transport modules without importing any solver."""
    code = (
        "import sys, gpusimbench.evaluator.transport.small, gpusimbench.evaluator.metrics.variability, "
        "gpusimbench.evaluator.statistics.permutation, gpusimbench.evaluator.statistics.jackknife;"
        "sys.exit(any(m in sys.modules for m in ('scipy', 'ot', 'torch', 'jax')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_few_pairs_load_little() -> None:
    """Solve like and shifted runs of one benchmark's size with SciPy alone."""
    code = (
        "import sys, numpy as np\n"
        "from gpusimbench.evaluator.metrics.variability import parallel_variability, run_to_run_variability\n"
        "runs = np.random.default_rng(0).normal(size=(3, 4, 27, 2)) + np.arange(3)[:, None, None, None]\n"
        "parallel_variability(runs[0]), run_to_run_variability(runs)\n"
        "sys.exit(any(m in sys.modules for m in ('numba', 'ot', 'torch', 'jax')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def direct(a: np.ndarray, b: np.ndarray) -> float:
    """W1 of sets of one size by one assignment of all points, nothing merged."""
    distance = cdist(a, b)
    return float(distance[linear_sum_assignment(distance)].mean())


@FEW
@given(several(2, COARSE) | several(2), several(1, COARSE), st.integers(1, 3), st.integers(0, 2))
def test_merging_and_cancelling_change_nothing(sets: np.ndarray, shared: np.ndarray, copies: int, times: int) -> None:
    """Agree with the assignment of all points where points repeat and both sides share some."""
    a, b = (np.concatenate([np.repeat(side, copies, axis=0), *[shared[0]] * times]) for side in sets)
    assert wasserstein1(a, b).value == pytest.approx(direct(a, b), abs=1e-12)


@FEW
@given(several(2, COARSE) | several(2))
def test_weights_equal_copies(sets: np.ndarray) -> None:
    """Get the same from places with weights and from points one by one."""
    a, b = np.repeat(sets[0], 3, axis=0), np.concatenate([sets[1], sets[1], sets[1][::-1] + [0.5, 0.0]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pair, "ASSIGNMENT_LIMIT", 0)
        found = wasserstein1(a, b)
    assert found.method in ("same points", "network simplex (POT emd2)")
    assert found.value == pytest.approx(direct(a, b), rel=1e-9, abs=1e-12)


def test_shared_mass_stays() -> None:
    """Leave nothing to move of equal envs but what differs, in units without a common factor."""
    env = cloud(27, 7)
    moved = np.concatenate([env[:26], env[26:] + 1.0])
    net = net_mass(np.tile(env, (16, 1)), np.tile(moved, (16, 1)))
    assert (net.total, net.single, net.share) == (1, True, 1 / 27)
    assert np.array_equal(net.sources, env[26:])


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e-160, 1.0, 1e160, 1e300])
def test_any_scale(scale: float) -> None:
    """Measure sets whose squares would overflow or vanish."""
    assert wasserstein1([[0.0, 0.0]], [[3.0 * scale, 4.0 * scale]]).value == pytest.approx(5.0 * scale, rel=1e-15)


def test_small_beside_large() -> None:
    """See a distance of 5e-200 beside coordinates of 1."""
    a, b = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[3e-200, 4e-200], [1.0, 1.0 + 2**-52]])
    assert wasserstein1(a[:1], b[:1]).value == pytest.approx(5e-200)
    assert wasserstein1([[0.0, 1e-160], [1.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]]).value == pytest.approx(5e-161)


@pytest.mark.parametrize("n", [300, pair.ASSIGNMENT_LIMIT + 1])
def test_alike_is_a_matter_of_speed(n: int) -> None:
    """Get the same optimum from every exact solver, for like and for shifted clouds."""
    for shift in (0.0, 3.0):
        a, b = cloud(n, 8), cloud(n, 9) + shift
        assumed, other = wasserstein1(a, b, alike=True), wasserstein1(a, b)
        assert assumed.value == pytest.approx(other.value, rel=1e-12)
        assert (assumed.low, assumed.high) == (assumed.value, assumed.value)
        assert n < pair.ASSIGNMENT_LIMIT or assumed.method != other.method


@pytest.mark.parametrize("n", [201, 432])
def test_compiled_assignment_has_the_same_bits(n: int) -> None:
    """Solved by the kernel or by SciPy, the mean over an assignment is the same number."""
    rng = np.random.default_rng(n)
    distance = cdist(rng.normal(size=(n, 2)), rng.normal(size=(n, 2)))
    assert pair.mean_assignment_distance(distance, compiled=True) == pair.mean_assignment_distance(distance)
    a, b = rng.normal(size=(2, n, 2))
    found, plain = wasserstein1(a, b, alike=True), wasserstein1(a, b)
    assert (found.value, found.method, plain.method) == (plain.value, "assignment (compiled)", "assignment (scipy)")


def test_result_can_be_sent() -> None:
    """Come back from pickling unchanged, as results do that workers send."""
    found = wasserstein1(cloud(5, 0), cloud(5, 1))
    assert pickle.loads(pickle.dumps(found)) == found


@pytest.mark.parametrize("counts", [(60, 60), (40, 60)])
def test_bounds_beyond_the_matrix(counts: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Enclose the exact value where the distance matrix would be too large, mass that is shared left out."""
    shared = cloud(12, 10)
    a, b = (np.concatenate([shared, cloud(count, seed)]) for seed, count in enumerate(counts))
    exact = wasserstein1(a, b).value
    monkeypatch.setattr(pair, "MATRIX_LIMIT", 99)
    found = wasserstein1(a, b)
    assert found.exactness == "certified"
    assert found.low * (1 - 1e-9) <= exact <= found.high * (1 + 1e-9)
    assert found.value == found.high
    assert found.high <= 1.02 * found.low


def test_only_single_units_are_an_assignment() -> None:
    """Tell mass of single points from points of which one side has several in one place."""
    rng = np.random.default_rng(5)
    single, twice = rng.normal(size=(6, 2)), np.repeat(rng.normal(size=(3, 2)), 2, axis=0)
    assert net_mass(single, rng.normal(size=(6, 2))).single
    assert net_mass(twice, twice + 1).single  # all points count twice
    assert not net_mass(single, twice).single
    assert not net_mass(twice, single).single


def test_machine_code_without_a_place_to_keep_it() -> None:
    """Compile a function whose file is in no folder, each time anew."""
    made: dict[str, Any] = {}
    exec("def twice(x):\n    return 2 * x", made)
    assert compiled(made["twice"])(21) == 42
