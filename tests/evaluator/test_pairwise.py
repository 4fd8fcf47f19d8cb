"""W1 of all pairs of small sets: SciPy and compiled code, blocks, threads, summaries."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import shutil
import subprocess
import sys
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from gpusimbench.evaluator.transport import kernel, small
from gpusimbench.evaluator.transport.pair import wasserstein1
from gpusimbench.evaluator.transport.points import in_canonical_order
from gpusimbench.evaluator.transport.small import SUMMARY_ROWS, distinct_sets, pairwise_summary, pairwise_wasserstein1

FEW = settings(max_examples=60, deadline=None)
# Few distinct values: ties and duplicates are the rule.
COARSE = st.integers(-1, 1).map(float) | st.just(-0.0)
SPREAD = st.floats(-10.0, 10.0, width=32)
SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 9), st.integers(1, 3))
SETS = SHAPES.flatmap(
    lambda shape: arrays(np.float64, shape, elements=COARSE) | arrays(np.float64, shape, elements=SPREAD)
)

NEVER, ALWAYS = 10**9, 0


def clouds(n_set: int, n_item: int = 27, seed: int = 0, shift: float = 0.0) -> np.ndarray:
    """Random planar sets, each shifted by its own way, shape [n_set, n_item, 2]."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n_set, n_item, 2)) + shift * rng.normal(size=(n_set, 1, 2))


def solved(points: np.ndarray, kernel_pairs: int) -> np.ndarray:
    """All distances by one of the two solvers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(small, "KERNEL_PAIRS", kernel_pairs)
        return pairwise_wasserstein1(points)


@FEW
@given(SETS)
def test_canonical_order(points: np.ndarray) -> None:
    """Sort the points of each set by their first coordinate, then by the next."""
    assert in_canonical_order(points).tolist() == [sorted(one) for one in points.tolist()]


@FEW
@given(SETS)
def test_equals_each_pair(points: np.ndarray) -> None:
    """Fill a symmetric matrix with the W1 of every pair, by either solver, ties and duplicates included."""
    for matrix in (solved(points, NEVER), solved(points, ALWAYS)):
        assert matrix.shape == (len(points), len(points))
        assert np.array_equal(matrix, matrix.T)
        for i, j in itertools.product(range(len(points)), repeat=2):
            distance = cdist(points[i], points[j])
            expected = distance[linear_sum_assignment(distance)].mean()
            assert matrix[i, j] == pytest.approx(expected, rel=1e-12, abs=1e-14)
            assert wasserstein1(points[i], points[j]).value > 0.0 or matrix[i, j] == 0.0


@pytest.mark.parametrize("shift", [0.0, 1.0, 50.0])
@pytest.mark.parametrize("n_item", [1, 2, 4, 27, 28, 65])
def test_solvers_agree(n_item: int, shift: float) -> None:
    """Agree to rounding, for counts around whole vectors, like and shifted clouds."""
    points = clouds(12, n_item, shift=shift)
    np.testing.assert_allclose(solved(points, ALWAYS), solved(points, NEVER), rtol=1e-12, atol=0.0)


def test_copies_perturbed_in_the_last_bits() -> None:
    """Agree where envs differ by rounding alone, so that costs and distance are 1e15 apart."""
    points = clouds(1) + np.random.default_rng(1).normal(size=(10, 27, 2)) * 1e-15
    np.testing.assert_allclose(solved(points, ALWAYS), solved(points, NEVER), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("scale", [1e-310, 1e-200, 1e-6, 1e6, 1e200, 1e307])
def test_any_scale(scale: float) -> None:
    """Scale with the unit of the points, far beyond where squares are numbers."""
    points = clouds(8, 6)
    for kernel_pairs in (ALWAYS, NEVER):
        expected = solved(points, kernel_pairs)
        found = solved(points * scale, kernel_pairs)
        np.testing.assert_allclose(found / scale, expected, rtol=1e-12)


def test_small_beside_large() -> None:
    """Measure sets 1e-200 apart beside sets 1 apart, compiled code asked for or not."""
    points = np.array([0.0, 1e-200, 1.0])[:, None, None] * np.ones((3, 2, 2))
    for kernel_pairs in (ALWAYS, NEVER):
        assert solved(points, kernel_pairs)[0] == pytest.approx([0.0, 2**0.5 * 1e-200, 2**0.5])


def test_refuses() -> None:
    """Refuse points without an env axis, and distances beyond float64."""
    with pytest.raises(ValueError, match="3 axes"):
        pairwise_wasserstein1(np.zeros((3, 2)))
    for kernel_pairs in (ALWAYS, NEVER):
        with pytest.raises(ValueError, match="overflow"):
            solved(np.array([[[1.5e308, 0.0]], [[-1.5e308, 0.0]]]), kernel_pairs)
    with pytest.raises(ValueError, match="two envs"):
        pairwise_summary(clouds(1))


COSTS = st.integers(1, 40).flatmap(
    lambda n: (
        arrays(np.float64, (2, 2, n), elements=COARSE)
        | arrays(np.float64, (2, 2, n), elements=st.floats(-2.0, 2.0, width=16))
    )
)


@FEW
@given(COSTS)
def test_certificate(clouds: np.ndarray) -> None:
    """Assign one to one, every row to a column that no price makes dearer than another: the optimum."""
    n = clouds.shape[2]
    padded = -(-n // kernel._LANES) * kernel._LANES
    cost, price = np.full((n, padded), kernel._HUGE), np.empty(padded)
    column_of = np.empty(n, np.int64)
    kernel._mean_cost(*clouds, cost, price, column_of, np.empty(padded, np.int64))
    cost, price = cost[:, :n], price[:n]
    np.testing.assert_allclose(cost, cdist(clouds[0].T, clouds[1].T), rtol=1e-15, atol=0.0)
    assert sorted(column_of) == list(range(n))
    reduced = cost - price
    assert (reduced[np.arange(n), column_of] <= reduced.min(axis=1) + 1e-14).all()


@FEW
@given(SETS.filter(lambda points: len(points) >= 3))
def test_triangle_inequality(points: np.ndarray) -> None:
    """Be no farther apart than by way of a third set."""
    ab, bc, ac = solved(points, ALWAYS)[[0, 1, 0], [1, 2, 2]]
    assert ac <= ab + bc + 1e-12


def test_solves_each_distinct_pair_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve one pair for many envs that hold two point sets, swapped items among them."""
    calls = []
    solve = small.mean_assignment_distance
    monkeypatch.setattr(small, "mean_assignment_distance", lambda d: calls.append(d.shape) or solve(d))
    a = clouds(1, seed=6)[0]
    matrix = pairwise_wasserstein1(np.stack([a, a + 1.0, a[::-1], a, a[::-1] + 1.0]))
    assert calls == [(27, 27)]
    assert np.count_nonzero(matrix) == 12
    assert matrix[0, 2] == 0.0


def test_joins_signed_zeros() -> None:
    """Take sets that differ in the sign of zeros alone for one."""
    zeros = np.zeros((3, 2))
    assert len(distinct_sets(np.stack([zeros, -zeros])).sets) == 1


@pytest.mark.parametrize("kernel_pairs", [NEVER, ALWAYS])
def test_threads_make_the_same_bits(kernel_pairs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the same bits on any number of threads."""
    monkeypatch.setattr(small, "KERNEL_PAIRS", kernel_pairs)
    points = clouds(23, 9)
    found = []
    for threads in (1, 3):
        monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
        found.append(pairwise_wasserstein1(points).tobytes() + pairwise_summary(points).row_means.tobytes())
    assert found[0] == found[1]


def test_another_process_makes_the_same_bits() -> None:
    """Give the same bits where workers were sent the blocks to compute."""
    points = np.concatenate([clouds(220, 3), clouds(50, 3)])
    assert small.KERNEL_PAIRS < 220 * 219 // 2
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        parts = pairwise_summary(points, pool.map)
    whole = pairwise_summary(points)
    assert parts.row_means.tobytes() == whole.row_means.tobytes()
    assert parts.mean == whole.mean


@pytest.mark.parametrize("kernel_pairs", [NEVER, ALWAYS])
def test_summary_equals_the_matrix(kernel_pairs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Count every pair of envs, those that hold the same points too, as the matrix does."""
    monkeypatch.setattr(small, "KERNEL_PAIRS", kernel_pairs)
    which = np.random.default_rng(2).integers(0, 2 * SUMMARY_ROWS + 3, size=300)
    points = clouds(2 * SUMMARY_ROWS + 3, 3)[which]
    found, matrix = pairwise_summary(points), pairwise_wasserstein1(points)
    assert found.n_distinct == len(set(which))
    np.testing.assert_allclose(found.row_means, matrix.sum(axis=1) / 299, rtol=1e-12)
    assert found.mean == pytest.approx(matrix.sum() / (300 * 299), rel=1e-12)


def test_summary_of_equal_envs() -> None:
    """Find nothing between envs that hold the same points."""
    found = pairwise_summary(np.repeat(clouds(1), 1000, axis=0))
    assert (found.mean, found.n_distinct, found.row_means.any()) == (0.0, 1, False)


@pytest.mark.slow
def test_summary_needs_no_matrix() -> None:
    """Stay far below the memory that a matrix of all envs would take."""
    points = clouds(2000, 2)
    pairwise_summary(clouds(300, 2))  # compiled, so that only arrays are counted
    tracemalloc.start()
    pairwise_summary(points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2000 * 2000 * 8 / 3


@pytest.mark.slow
def test_read_only_install_compiles_into_the_users_cache(tmp_path: Path) -> None:
    """Keep machine code in the user's cache folder where the package's own cannot be written."""
    source = Path(small.__file__).parents[1]
    package = tmp_path / "gpusimbench" / "evaluator" / "transport"
    package.mkdir(parents=True)
    for name in ("kernel.py", "compiled.py"):
        shutil.copy(source / "transport" / name, package)
    for folder in (package, package.parent, package.parent.parent):
        (folder / "__init__.py").touch()
    (package / "__pycache__").touch()  # a file: nothing can be written beneath it, by anyone
    code = (
        "import numpy as np\nfrom gpusimbench.evaluator.transport import kernel\n"
        "out = np.zeros(2)\nkernel.distances_to_later(np.array([[[0.0]], [[1.0]]]), 0, out)\nassert out[1] == 1.0"
    )
    cache = tmp_path / "cache"
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environ = {**kept, "PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(cache), "HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environ, cwd=tmp_path, check=True)
    assert list(cache.rglob("*.nbc"))
