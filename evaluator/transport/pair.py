"""W1 between two point sets, exact."""

from __future__ import annotations

import os
import sys
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

# A dense assignment solver is the faster one for small or like clouds; for clouds that are shifted
# against each other it degrades steeply (2000 points: 6.9 s against 0.43 s for the network
# simplex), and the two cross near here.
ASSIGNMENT_LIMIT = 1000

# Both exact solvers hold the whole distance matrix; 4e8 float64 entries are 3.2 GB.
MATRIX_LIMIT = 400_000_000

UNEQUAL_COUNTS = "unequal counts: weighted transport, not in the published definition"

_POT_BACKENDS = ("PYTORCH", "JAX", "CUPY", "TENSORFLOW")


@dataclass(frozen=True)
class Transport:
    """A transport distance and how it was obtained.

    value       W1, in the unit of the points
    exactness   "exact": the optimum up to float64 rounding
    method      the solver that produced it
    extension   what goes beyond the published definition; None where nothing does
    """

    value: float
    exactness: str
    method: str
    extension: str | None


def wasserstein1(a: npt.ArrayLike, b: npt.ArrayLike) -> Transport:
    """W1 between two point sets under the Euclidean distance.

    GPUSimBench definition, for equally sized sets:

        W1(a, b) = min over one-to-one assignments s of  (1/n) * sum_i |a_i - b_s(i)|

    For n != m the general form is used, with weight 1/n on each point of a and 1/m on each of b:
    the smallest mean transport distance over all couplings. Both agree where n = m (Birkhoff).

    Args:
        a: points [any length unit], shape [n, d].
        b: points [same unit], shape [m, d].

    Returns:
        W1 in the unit of the points; exactly 0.0 for the same points in any order.

    Raises:
        ValueError: a set is empty, not of shape [n, d] or not finite; widths differ; the sets are
            too large for an exact solution; the solver did not converge.
    """
    a, b = point_array(a, "a", ndim=2), point_array(b, "b", ndim=2)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"points of different width: a has {a.shape[1]}, b has {b.shape[1]}")
    n, m = len(a), len(b)
    if n == m and np.array_equal(in_canonical_order(a), in_canonical_order(b)):
        return Transport(0.0, "exact", "same points", None)
    if n * m > MATRIX_LIMIT:
        raise ValueError(f"{n} x {m} points are too many for exact transport (limit: {MATRIX_LIMIT} pairs)")
    distance = distance_matrix(a, b)
    if n != m:
        value = _network_simplex(distance)
        return Transport(value, "exact", "network simplex (POT emd2)", UNEQUAL_COUNTS)
    if n > ASSIGNMENT_LIMIT:
        return Transport(_network_simplex(distance), "exact", "network simplex (POT emd2)", None)
    return Transport(mean_assignment_distance(distance), "exact", "assignment (scipy)", None)


def point_array(values: npt.ArrayLike, name: str, *, ndim: int) -> npt.NDArray[np.float64]:
    """The values as finite float64 points, shape [..., n, d] with `ndim` axes, none of them empty.

    Raises:
        ValueError: saying which of these does not hold, under the given name.
    """
    points = np.asarray(values, dtype=np.float64)
    if points.ndim != ndim:
        raise ValueError(f"{name} must have {ndim} axes, got shape {list(points.shape)}")
    if points.size == 0:
        raise ValueError(f"{name} is empty: shape {list(points.shape)}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} holds non-finite coordinates")
    return points + 0.0  # -0.0 and 0.0 are the same place


def planar_array(values: npt.ArrayLike, name: str, *, ndim: int) -> npt.NDArray[np.float64]:
    """As point_array, of points in the plane: shape [..., n, 2]."""
    points = point_array(values, name, ndim=ndim)
    if points.shape[-1] != 2:
        raise ValueError(f"{name} must be planar, got coordinates of width {points.shape[-1]}")
    return points


def in_canonical_order(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Every set's points sorted by coordinate, shape [..., n, d]: equal for the same multiset."""
    keys = np.moveaxis(points, -1, 0)[::-1]  # lexsort takes the primary key last
    order = np.lexsort(keys, axis=-1)
    return np.take_along_axis(points, order[..., None], axis=-2)


def distance_matrix(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Euclidean distances between points a [n, d] and b [m, d], shape [n, m], same unit."""
    from scipy.spatial.distance import cdist

    distance: npt.NDArray[np.float64] = cdist(a, b)
    if not np.isfinite(distance).all():
        raise ValueError("coordinates are too large: their distances overflow float64")
    return distance


def mean_assignment_distance(distance: npt.NDArray[np.float64]) -> float:
    """Smallest mean entry over one-to-one assignments of a square matrix, shape [n, n]."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(distance)
    return float(distance[rows, columns].mean())


def _network_simplex(distance: npt.NDArray[np.float64]) -> float:
    """Optimal transport cost between uniform weights, distances of shape [n, m]; scales them."""
    ot = _pot()
    n, m = distance.shape
    largest = float(distance.max())
    if largest == 0.0:
        return 0.0
    # The solver compares costs with an absolute tolerance: distances of 1e-12 as they stand come
    # out wrong by several percent, without a warning.
    distance /= largest
    with warnings.catch_warnings():
        # Non-convergence is raised below; a warning beside the error would report it twice.
        warnings.simplefilter("ignore")
        value, log = ot.emd2(np.full(n, 1.0 / n), np.full(m, 1.0 / m), distance, numItermax=1_000_000_000, log=True)
    if log["warning"] is not None:
        raise ValueError(f"transport of {n} x {m} points did not converge: {log['warning']}")
    return max(float(value), 0.0) * largest


def _pot() -> Any:
    """POT, without the array frameworks that it would otherwise import wherever installed."""
    if "ot" not in sys.modules:
        # Evaluation needs none of them, and importing one may claim a GPU. A value already set by
        # the user stands.
        for backend in _POT_BACKENDS:
            os.environ.setdefault(f"POT_BACKEND_DISABLE_{backend}", "1")
    import ot

    return ot
