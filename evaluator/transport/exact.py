"""Exact transport on one distance matrix: POT's network simplex for weighted points, SciPy's assignment for others."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

_POT_BACKENDS = ("PYTORCH", "JAX", "CUPY", "TENSORFLOW")
# From here on the preparation below costs less than it saves.
_CENTRED_FROM = 200


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
