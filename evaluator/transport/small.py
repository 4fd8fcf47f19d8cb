"""W1 between all pairs of many small point sets, exact."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evaluator.metrics.identity import bitwise_classes
from evaluator.transport.pair import (
    distance_matrix,
    in_canonical_order,
    mean_assignment_distance,
    point_array,
)


def pairwise_wasserstein1(points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """W1 between every pair of equally sized point sets (GPUSimBench definition).

        W[e, e'] = min over one-to-one assignments s of  (1/n) * sum_i |p[e, i] - p[e', s(i)]|

    Sets that hold the same points, in whatever order, are one set: each pair of distinct sets is
    solved once, so that a simulator whose envs agree costs nothing however many they are.

    Args:
        points: positions [any length unit], shape [n_env, n_item, d].

    Returns:
        distances [same unit], shape [n_env, n_env]; symmetric, zero on the diagonal.

    Raises:
        ValueError: the points are empty, not of three axes, or not finite.
    """
    sets = in_canonical_order(point_array(points, "points", ndim=3))
    classes = bitwise_classes(sets)
    _, first = np.unique(classes, return_index=True)
    return _distinct_pairs(sets[first])[np.ix_(classes, classes)]


def _distinct_pairs(sets: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """W1 between all pairs of distinct sets, shape [n_set, n_item, d] -> [n_set, n_set]."""
    n_set, n_item, width = sets.shape
    result = np.zeros((n_set, n_set))
    for i in range(n_set - 1):
        # One call builds the distances to all later sets: per pair, building costs more than
        # solving.
        later = sets[i + 1 :].reshape(-1, width)
        blocks = distance_matrix(sets[i], later).reshape(n_item, -1, n_item)
        for j in range(i + 1, n_set):
            result[i, j] = mean_assignment_distance(blocks[:, j - i - 1])
    return result + result.T
