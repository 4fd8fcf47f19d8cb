"""Point sets as arrays: checks, order, scale, distances, and the mass by which two sets differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
import numpy.typing as npt

# Squares of differences of coordinates stay normal numbers above this, where the largest is about 1.
_SQUARES_VANISH = 1e-130


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


def scale_of(*points: npt.NDArray[np.float64]) -> float:
    """The power of two next below the largest coordinate: points divided by it lie in (-2, 2), without rounding.

    Squares neither overflow nor vanish then, whatever the unit. 1 where all coordinates are zero.
    """
    largest = max(float(np.abs(p).max()) for p in points)
    return math.ldexp(1.0, math.frexp(largest)[1] - 1) if largest else 1.0


def scaled_back(value: float, scale: float) -> float:
    """A distance between scaled points in the unit of the points.

    Raises:
        ValueError: it is beyond what float64 can hold.
    """
    distance = value * scale
    if not math.isfinite(distance):
        raise ValueError("coordinates are too large: their distances overflow float64")
    return distance


def squares_vanish(points: npt.NDArray[np.float64]) -> bool:
    """Whether scaled points, of any shape, may lie so close together that a square of their distance is no number."""
    sizes = np.abs(points)
    return bool(((sizes < _SQUARES_VANISH) & (sizes > 0.0)).any())


def distance_matrix(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Euclidean distances between points a [n, d] and b [m, d], shape [n, m], same unit."""
    from scipy.spatial.distance import cdist

    if squares_vanish(a) or squares_vanish(b):
        differences = (np.abs(x[:, None] - y[None, :]) for x, y in zip(a.T, b.T, strict=True))
        distance: npt.NDArray[np.float64] = reduce(np.hypot, differences)
    else:
        distance = cdist(a, b)
    if not np.isfinite(distance).all():
        raise ValueError("coordinates are too large: their distances overflow float64")
    return distance


@dataclass(frozen=True)
class NetMass:
    """What is left to move between two point sets once the mass that they share has cancelled.

    sources  places with more of a than of b, shape [p, d]
    supply   by how much, whole numbers without a common factor, shape [p]
    sinks    places with more of b than of a, shape [q, d]
    demand   by how much, shape [q]; the sum is that of supply
    share    share of all mass that one unit of supply is
    """

    sources: npt.NDArray[np.float64]
    supply: npt.NDArray[np.int64]
    sinks: npt.NDArray[np.float64]
    demand: npt.NDArray[np.int64]
    share: float

    @property
    def total(self) -> int:
        """Units that are moved."""
        return int(self.supply.sum())

    @property
    def single(self) -> bool:
        """Whether every place sends or takes one unit, so that the problem is an assignment."""
        return bool(self.total == len(self.supply) == len(self.demand))


def net_mass(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> NetMass:
    """Points that occupy one place merged, and the mass that both sets have there cancelled.

    With weight 1/n on each point of a and 1/m on each of b, W1 depends on the difference of the
    two measures alone: by Kantorovich and Rubinstein (1958) it is the supremum, over functions f
    that change by no more than the distance, of

        sum_x f(x) (mass of a at x - mass of b at x).

    So mass that is in the same place on both sides may stay where it is. (This needs the triangle
    inequality: of squared distances it would be wrong.) What is left is in whole units of 1/lcm(n, m).

    Args:
        a: points [any length unit], shape [n, d].
        b: points [same unit], shape [m, d].
    """
    n, m = len(a), len(b)
    common = math.gcd(n, m)
    places, place = np.unique(np.concatenate([a, b]), axis=0, return_inverse=True)
    place = place.reshape(-1)
    net = np.bincount(place[:n], minlength=len(places)) * (m // common)
    net -= np.bincount(place[n:], minlength=len(places)) * (n // common)
    factor = max(int(np.gcd.reduce(net)), 1)
    net //= factor
    more, less = net > 0, net < 0
    return NetMass(places[more], net[more], places[less], -net[less], factor / (n * (m // common)))
