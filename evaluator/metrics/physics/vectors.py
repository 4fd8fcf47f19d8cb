"""Sums over the three components of many vectors; numpy's own reductions are slow along so short an axis."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def square(vector: Array) -> Array:
    """Squared length, shape [...], of vectors [..., component]."""
    return np.asarray(np.einsum("...i,...i->...", vector, vector))


def length(vector: Array) -> Array:
    """Length, shape [...], of vectors [..., component]."""
    return np.sqrt(square(vector))


def largest(vector: Array) -> Array:
    """The largest component, shape [...], of vectors [..., component]."""
    found = vector[..., 0]
    for component in range(1, vector.shape[-1]):
        found = np.maximum(found, vector[..., component])
    return np.asarray(found)
