"""W1 between two point sets: exact, by POT's network simplex for weighted points and SciPy's assignment for others; or
between certified bounds where exact solvers would need too much memory."""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.points import (
    NetMass,
    distance_matrix,
    net_mass,
    point_array,
    scale_of,
    scaled_back,
    squares_vanish,
)

_POT_BACKENDS = ("PYTORCH", "JAX", "CUPY", "TENSORFLOW")
# From here on the preparation below costs less than it saves.
_CENTRED_FROM = 200

# A dense assignment solver is the faster one for small or like clouds; for clouds that are shifted
# against each other it takes longer (1000 points, CPU time: 0.11 s alike, 0.55 s shifted), where the
# network simplex does not mind (0.12 to 0.17 s). Loading it costs a second.
ASSIGNMENT_LIMIT = 600

# Compiled, assignment between like clouds takes less than half of the time from here on (432 points, CPU time: 3.2
# against 7.1 ms), and loading it 0.2 s: permutation tests solve a hundred.
COMPILED_FROM = 200

# Compiled, assignment between like clouds stays ahead of the network simplex up to here (2000 points,
# CPU time: 0.33 against 0.72 s; 4000: 2.0 against 3.2 s, but 10 s if the clouds are slightly shifted).
ALIKE_LIMIT = 2000

# Both exact solvers hold the whole distance matrix, and take some n^2.5: 5000 points a side are 0.2 GB and five seconds
# of a core, 14,000 are 8 GB and a minute, where bounds to a thousandth take two seconds.
MATRIX_LIMIT = 25_000_000

# How far apart bounds may be, of the value, by the number of points.
_TOLERANCES = ((50_000, 1e-3), (None, 1e-2))

# Sets of unequal counts are certified as points repeated to a common count, if it is no larger.
REPEATED_LIMIT = 200_000

# Bids of the certified solver for each point; like clouds of 110,592 points take 65. What needs more ends with bounds
# that are further apart.
_BIDS = 1000

UNEQUAL_COUNTS = "unequal counts: weighted transport, not in the published definition"


def mean_transport_distance(
    distance: npt.NDArray[np.float64], supply: npt.NDArray[np.int64], demand: npt.NDArray[np.int64]
) -> float:
    """Smallest mean distance of a unit over all ways to meet the demand from the supply.

    Bonneel et al. (2011). Whole numbers are kept, since fractions of one would not add up exactly.

    Args:
        distance: any length unit, shape [n, m]; scaled in place.
        supply: units at each row, shape [n].
        demand: units at each column, shape [m], with the sum of supply.

    Raises:
        ValueError: the solver did not converge.
    """
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
        cost, log = ot.emd2(
            supply.astype(np.float64), demand.astype(np.float64), distance, numItermax=1_000_000_000, log=True
        )
    if log["warning"] is not None:
        raise ValueError(f"transport of {n} x {m} points did not converge: {log['warning']}")
    return max(float(cost), 0.0) / int(supply.sum()) * largest


def _pot() -> Any:
    """POT, without the array frameworks that it would otherwise import wherever installed."""
    if "ot" not in sys.modules:
        # Evaluation needs none of them, and importing one may claim a GPU. A value already set by
        # the user stands.
        for backend in _POT_BACKENDS:
            os.environ.setdefault(f"POT_BACKEND_DISABLE_{backend}", "1")
    import ot

    return ot


def mean_assignment_distance(distance: npt.NDArray[np.float64], *, compiled: bool = False) -> float:
    """Smallest mean entry over one-to-one assignments of a square matrix, shape [n, n].

    SciPy's solver is that of Crouse (2016), which grows shortest augmenting paths. It takes the
    longer the more the rows compete for the same columns, as they do between shifted clouds; a
    constant off every row and column changes no solution, and takes most of a shift away.

    compiled  solve with the kernel of this project: of a matrix with one best assignment, the mean has the same bits
    """
    if compiled:
        from gpusimbench.evaluator.transport.kernel import assigned_columns

        return float(distance[np.arange(len(distance)), assigned_columns(distance)].mean())
    from scipy.optimize import linear_sum_assignment

    costs = _centred(distance) if len(distance) >= _CENTRED_FROM else distance
    rows, columns = linear_sum_assignment(costs)
    return float(distance[rows, columns].mean())


def _centred(distance: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    # columns by their means, rows by what is then their smallest, and columns so again: nothing is negative
    prices = distance.mean(axis=0)
    rows = (distance - prices).min(axis=1)
    reduced: npt.NDArray[np.float64] = distance - rows[:, None]
    reduced -= reduced.min(axis=0)
    return reduced


@dataclass(frozen=True)
class Transport:
    """A transport distance and how it was obtained.

    value       W1, in the unit of the points; the upper bound where there are bounds
    exactness   "exact": the optimum up to float64 rounding; "certified": between bounds
    method      the solver that produced it
    extension   what goes beyond the published definition; None where nothing does
    low, high   W1 is between them; both the value where it is exact
    """

    value: float
    exactness: str
    method: str
    extension: str | None
    low: float
    high: float


def wasserstein1(a: npt.ArrayLike, b: npt.ArrayLike, *, alike: bool = False) -> Transport:
    """W1 between two point sets under the Euclidean distance.

    GPUSimBench definition, for equally sized sets:

        W1(a, b) = min over one-to-one assignments s of  (1/n) * sum_i |a_i - b_s(i)|

    For n != m the general form is used, with weight 1/n on each point of a and 1/m on each of b:
    the smallest mean transport distance over all couplings. Both agree where n = m (Birkhoff).
    Points in one place are merged, and what both sets have in one place is left there (see
    `net_mass`), so that envs which agree cost nothing.

    Args:
        a: points [any length unit], shape [n, d].
        b: points [same unit], shape [m, d].
        alike: the sets are two samples of one law, or nearly so. Decides which exact solver is
            the faster one, not the value.

    Returns:
        W1 in the unit of the points; exactly 0.0 for the same points in any order.

    Raises:
        ValueError: a set is empty, not of shape [n, d] or not finite; widths differ; the sets are
            too large; the solver did not converge; a distance overflows.
    """
    a, b = point_array(a, "a", ndim=2), point_array(b, "b", ndim=2)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"points of different width: a has {a.shape[1]}, b has {b.shape[1]}")
    extension = None if len(a) == len(b) else UNEQUAL_COUNTS
    scale = scale_of(a, b)
    net = net_mass(a / scale, b / scale)
    if not net.total:
        return Transport(0.0, "exact", "same points", extension, 0.0, 0.0)
    if len(net.supply) * len(net.demand) > MATRIX_LIMIT:
        return _certified(net, scale, extension, len(a), len(b))
    mean, method = _exact(net, alike=alike)
    value = scaled_back(mean * (net.total * net.share), scale)
    return Transport(value, "exact", method, extension, value, value)


def _exact(net: NetMass, *, alike: bool) -> tuple[float, str]:
    """Mean distance of what is moved, and the solver."""
    if net.total <= ASSIGNMENT_LIMIT:
        compiled = alike and net.single and net.total >= COMPILED_FROM and _can_compile(net)
        mean = mean_assignment_distance(distance_matrix(*_repeated(net)), compiled=compiled)
        return mean, "assignment (compiled)" if compiled else "assignment (scipy)"
    if alike and net.single and net.total <= ALIKE_LIMIT and _can_compile(net):
        from gpusimbench.evaluator.transport.kernel import distances_to_later

        found = np.empty(2)
        distances_to_later(np.stack([net.sources.T, net.sinks.T]), 0, found)
        return float(found[1]), "assignment (compiled)"
    distance = distance_matrix(net.sources, net.sinks)
    return mean_transport_distance(distance, net.supply, net.demand), "network simplex (POT emd2)"


def _can_compile(net: NetMass) -> bool:
    vanish = squares_vanish(net.sources) or squares_vanish(net.sinks)
    return not vanish and importlib.util.find_spec("numba") is not None


def _repeated(net: NetMass) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The places, each as often as units are moved from or to it."""
    return np.repeat(net.sources, net.supply, axis=0), np.repeat(net.sinks, net.demand, axis=0)


def _certified(net: NetMass, scale: float, extension: str | None, n: int, m: int) -> Transport:
    """Bounds, by points repeated to a common count where there are weights.

    Larger sets of unequal counts are refused. Subsamples would give an estimate, but no interval: W1
    between samples is too large on average, by an amount that depends on the laws.
    """
    too_many = f"{n} x {m} points are too many for exact transport (limit: {MATRIX_LIMIT} pairs)"
    if net.sources.shape[1] != 2 or importlib.util.find_spec("numba") is None:
        raise ValueError(too_many)
    if n != m and net.total > REPEATED_LIMIT:
        raise ValueError(f"{too_many}, and repeated to one count for bounds (limit: {REPEATED_LIMIT} points)")
    from gpusimbench.evaluator.transport.large import certified_wasserstein1

    relative = next(part for points, part in _TOLERANCES if points is None or net.total <= points)
    bounds = certified_wasserstein1(*_repeated(net), relative=relative, max_work=_BIDS * net.total)
    share = net.total * net.share
    low, high = (scaled_back(float(bound) * share, scale) for bound in (bounds.low, bounds.high))
    return Transport(high, "certified", bounds.method, extension, low, high)
