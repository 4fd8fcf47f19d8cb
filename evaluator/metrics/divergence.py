"""Divergence: which bits differ, by how much, and how the difference grows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing

_WORDS = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}

FIT_LIMIT_M = 1e-3
"""Beyond a millimetre, bodies have met others that they would not have met."""

MIN_FIT_POINTS = 5
"""A line through fewer points says nothing of whether it is one."""


def as_words(values: npt.NDArray[Any]) -> npt.NDArray[np.unsignedinteger]:
    """The bits of real numbers, or of truth values, as unsigned integers of their size, shape as given.

    Raises:
        ValueError: they are something else, or not of 1, 2, 4 or 8 bytes.
    """
    word = _WORDS.get(values.dtype.itemsize)
    if values.dtype.kind not in "fiub" or word is None:
        raise ValueError(f"numbers must be real, of 1, 2, 4 or 8 bytes, not {values.dtype}")
    return np.ascontiguousarray(values).view(word).reshape(values.shape)


def differs(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Where two arrays of one dtype have other bits, shape as broadcast.

    Bits, not values: -0.0 differs from 0.0, and NaNs are equal only with the same payload.

    Raises:
        ValueError: the dtypes are not the same.
    """
    _same_dtype(a, b)
    return np.asarray(as_words(a) != as_words(b))


def ulp_distance(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> npt.NDArray[np.uint64]:
    """How many representable numbers two numbers are apart, shape as broadcast.

    Bit patterns are counted in the order that IEEE 754-2019 (5.10, totalOrder) gives them:

        -NaN < -inf < ... < -0.0 < 0.0 < ... < inf < NaN,  NaNs by payload

    So it is zero for equal bits alone, one between -0.0 and 0.0, defined between any two patterns, and a metric. Where
    neither number is NaN and both have the same sign, it is the usual distance in units in the last place.

    Raises:
        ValueError: the dtypes are not the same, or not floating-point.
    """
    _same_dtype(a, b)
    first, second = _ordered(a), _ordered(b)
    return np.asarray(np.maximum(first, second) - np.minimum(first, second), dtype=np.uint64)


def opposite_signs(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Where one number is negative and the other is not, shape as broadcast; not between zeros, and of no NaN.

    There `ulp_distance` counts all numbers down to zero and up again, which says nothing of how far the two are apart.
    """
    told = ~(np.isnan(a) | np.isnan(b) | ((a == 0) & (b == 0)))
    return np.asarray(told & (np.signbit(a) != np.signbit(b)))


def resolution(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """The spacing of representable numbers at the larger magnitude of two of one dtype, shape as broadcast.

    Two numbers that are rounded from equal ones to that precision lie no further apart: each is off by half the
    spacing at most. NaN where either is not finite.
    """
    _same_dtype(a, b)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.spacing(np.maximum(np.abs(a), np.abs(b))), dtype=np.float64)


def first_true(mask: npt.NDArray[np.bool_]) -> tuple[int, ...] | None:
    """Index of the first true element in C order; None where there is none."""
    flat = mask.reshape(-1)
    at = int(np.argmax(flat)) if flat.size else 0
    if not flat.size or not flat[at]:
        return None
    return tuple(int(i) for i in np.unravel_index(at, mask.shape))


_FEW_KEYS = 128
"""So many are numbered faster by a dictionary than by sorting."""


def by_first_appearance(keys: npt.NDArray[np.uint64]) -> npt.NDArray[np.int64]:
    """Class of every key, numbered 0, 1, ... in order of first appearance, shape [n]."""
    if keys.size <= _FEW_KEYS:
        numbered: dict[int, int] = {}
        return np.array([numbered.setdefault(key, len(numbered)) for key in keys.reshape(-1).tolist()], dtype=np.int64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[inverse.reshape(-1)])


MIN_R_SQUARED = 0.8
"""Below it the distance does not grow as an exponential does, and the line's slope is no rate of anything."""


@dataclass(frozen=True)
class GrowthFit:
    """An exponential, log(distance) = rate * t + constant, by least squares.

    rate          [1/s]
    r_squared     share of the variance of log(distance) that the line explains
    n_point       number of points that the line goes through
    begin_s, end_s  times of the first and the last of them [s]
    power_r_squared  as r_squared, of a power of the time since the last step without a distance,
                  log(distance) = k log(t - t0) + constant
    why_no_rate   why the slope is not told to people as a rate of growth; empty where it is
    """

    rate: float
    r_squared: float
    n_point: int
    begin_s: float
    end_s: float
    power_r_squared: float
    why_no_rate: str

    @property
    def doubling_time(self) -> float | None:
        """Time in which the distance doubles [s]; None where it does not grow."""
        return math.log(2) / self.rate if self.rate > 0 else None


def fit_growth(
    times: npt.NDArray[np.float64], distances: npt.NDArray[np.float64], *, limit: float
) -> GrowthFit | Missing:
    """The exponential through distances from the first that is not zero up to the last before `limit` is passed.

    The window is fixed by that rule and is not searched for: below it nothing differs, above it bodies have met other
    bodies and the distance is no longer small against the scene. Zeros within the window have no logarithm and are left
    out.

    Args:
        times: [s], shape [step], increasing.
        distances: [m], shape [step]; NaN is not finite and ends the window.
        limit: distance [m] at which the window ends.

    Returns:
        the fit, or why there is none.
    """
    begins = np.flatnonzero(distances > 0)
    if not begins.size:
        return Missing("nothing moved apart")
    ends = np.flatnonzero(~(distances < limit))
    stop = int(ends[0]) if ends.size else len(distances)
    window = np.flatnonzero(distances[:stop] > 0)
    if len(window) < MIN_FIT_POINTS:
        return Missing(
            f"{len(window)} recorded steps with a distance above zero before it passes {limit * 1000:g} mm; "
            f"a rate needs {MIN_FIT_POINTS}"
        )
    t, y = times[window], np.log(distances[window])
    t0, y0 = t - t.mean(), y - y.mean()
    total = float(y0 @ y0)
    if total == 0:
        return Missing(f"the distance is the same at all {len(window)} steps of the window: it does not grow")
    rate, left = _line(t0, y0)
    begin = int(window[0])
    since = times[begin - 1] if begin else times[0] - (times[1] - times[0])
    log_since = np.log(t - since)
    _, left_of_power = _line(log_since - log_since.mean(), y0)
    r_squared, of_power = 1 - left / total, 1 - left_of_power / total
    return GrowthFit(
        rate, r_squared, len(window), float(t[0]), float(t[-1]), of_power, why_no_rate(r_squared, of_power)
    )


def why_no_rate(r_squared: float, power_r_squared: float) -> str:
    """Why the slope of an exponential fit is no rate of growth; empty where it is. Arguments as in GrowthFit."""
    if r_squared < MIN_R_SQUARED:
        shown = math.floor(r_squared * 100) / 100
        return f"no rate: R2 {shown:.2f} of the exponential is below {MIN_R_SQUARED:g}"
    # a line through 100 points of any power of time has an R2 of 0.80
    if r_squared < power_r_squared:
        return (
            f"no rate: the distance grows as a power of time (R2 {power_r_squared:.3f}) rather than as an "
            f"exponential ({r_squared:.3f})"
        )
    return ""


def _line(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Slope of the line through centred numbers by least squares, and the sum of squares that it leaves."""
    slope = float(x @ y / (x @ x))
    return slope, float(((y - slope * x) ** 2).sum())


def first_reaching(times: npt.NDArray[np.float64], distances: npt.NDArray[np.float64], size: float) -> float | None:
    """The first time [s] at which a distance [m] is at least `size`; None where it never is."""
    at = np.flatnonzero(distances >= size)
    return float(times[at[0]]) if at.size else None


def _ordered(values: npt.NDArray[np.floating]) -> npt.NDArray[np.unsignedinteger]:
    # monotone in totalOrder: negative numbers in reverse below, the others above
    if values.dtype.kind != "f":
        raise ValueError(f"numbers must be floating-point, not {values.dtype}")
    words = as_words(values)
    sign = words.dtype.type(1) << words.dtype.type(8 * words.dtype.itemsize - 1)
    return np.asarray(np.where(words & sign, ~words, words | sign))


def _same_dtype(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> None:
    if a.dtype != b.dtype:
        raise ValueError(f"numbers must be of one dtype, not {a.dtype} and {b.dtype}")
