"""The order in which a method converges with its step, from errors at several steps.

An error of order p is C h^p for small steps h. Against a finer step h0 of the same method, instead of the exact motion,
it is C (h^p - h0^p), which is fitted here, so that h0 need not be far below the others (Roache, Verification and
Validation in Computational Science and Engineering, 1998, chapter 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.cases import FEWEST, interval_over_cases

Array = npt.NDArray[np.float64]

FEWEST_STEPS = 3
"""Steps with an error: two give one local order, which nothing contradicts."""

AGREE = 0.2
"""How far the local order of two neighbouring steps may be from the fitted order in the asymptotic range."""

_ORDERS = (0.05, 8.0)  # between which an order is looked for, by golden sections
_GOLDEN = (5**0.5 - 1) / 2
_CUTS = 36  # to 3e-7


@dataclass(frozen=True)
class Order:
    """A fitted order of convergence.

    steps        h, from large to small [s]
    errors       root mean square over environments, of each step
    order        p, by least squares of log error; Missing where errors fit best at an end of the range that is searched
    ci95         by resampling environments (see ends_of of cases.py); or why there is none
    local        order of each two neighbouring steps; Missing as `order`
    """

    steps: tuple[float, ...]
    errors: tuple[float, ...]
    order: float | Missing
    ci95: tuple[float, float] | Missing
    local: tuple[float | Missing, ...]

    @property
    def asymptotic(self) -> bool:
        """Whether all local orders are within AGREE of the fitted order, so that it is that of the method."""
        if isinstance(self.order, Missing):
            return False
        return all(not isinstance(one, Missing) and abs(one - self.order) <= AGREE for one in self.local)


def fit_order(steps: npt.ArrayLike, errors: npt.ArrayLike, *, finest: float = 0.0, seed: int = 0) -> Order | Missing:
    """The order of errors at several steps.

    steps   h [s], shape [step], all different
    errors  of each step and environment, not negative, shape [step, env]
    finest  h0 [s], the step that the errors are against, smaller than all others; 0: they are against the exact motion
    seed    of the resampling

    Missing where there are fewer than FEWEST_STEPS steps, where a step has no error at all, or where an error is not
    finite. ValueError where shapes or steps are not as said.
    """
    h, found = np.asarray(steps, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if h.ndim != 1 or found.ndim != 2 or len(h) != len(found) or not found.shape[1]:
        raise ValueError(f"steps and errors have the shapes [step] and [step, env], not {h.shape} and {found.shape}")
    if len(np.unique(h)) != len(h) or not (h > finest).all() or finest < 0:
        raise ValueError(f"steps are different numbers above {finest:g}")
    if len(h) < FEWEST_STEPS:
        return Missing(f"an order needs errors at {FEWEST_STEPS} steps or more, and there are {len(h)}")
    if not np.isfinite(found).all():
        return Missing("an error is not finite")
    down = np.argsort(-h)
    h, found = h[down], found[down]
    whole = _rms(found)
    if not whole.all():
        return Missing(f"there is no error at a step of {h[int(np.argmin(whole))]:g} s")
    pairs = [slice(i, i + 2) for i in range(len(h) - 1)]
    order = _inside(float(_fitted(h, whole, finest)))
    return Order(
        tuple(h.tolist()),
        tuple(whole.tolist()),
        order,
        Missing("there is no order") if isinstance(order, Missing) else _interval(h, found, finest, seed),
        tuple(_inside(float(_fitted(h[pair], whole[pair], finest))) for pair in pairs),
    )


def _inside(order: float) -> float | Missing:
    """The order, or why it is none: at an end of the range, where the error of the method is not what is seen."""
    if order <= _ORDERS[0] + AGREE:
        return Missing(
            "the errors hardly fall with the step: rounding, or another error that does not depend on the step, hides "
            "that of the method"
        )
    if order >= _ORDERS[1] - AGREE:
        return Missing(f"the errors fall as fast as those of order {_ORDERS[1]:g}, the highest that is looked for")
    return order


def _interval(h: Array, errors: Array, finest: float, seed: int) -> tuple[float, float] | Missing:
    count = errors.shape[1]
    if count >= FEWEST and (errors == errors[:, :1]).all():
        return Missing("the environments are alike")

    def orders(drawn: npt.NDArray[np.int64]) -> Array:
        return _fitted(h, _rms(errors[:, drawn]).T, finest)

    ends = interval_over_cases(orders, count, seed=seed)
    if ends is None:
        return Missing(f"an interval needs {FEWEST} environments, and there are {count}")
    return Missing("some draws of environments have no error at all") if np.isnan(ends).any() else ends


def _rms(errors: Array) -> Array:
    return np.asarray(np.sqrt(np.square(errors).mean(axis=-1)))


def _fitted(h: Array, error: Array, finest: float) -> Array:
    """The order of each row of errors, [..., step]; NaN of a row that has a zero."""
    known = np.asarray(error.all(axis=-1))
    wanted = np.log(np.where(known[..., None], error, 1.0))
    if finest == 0.0:
        away = np.log(h) - np.log(h).mean()
        return np.asarray(np.where(known, wanted @ away / (away @ away), np.nan))

    def missed(order: Array) -> Array:
        # log(h^p - h0^p), with the common factor h0^p taken out so that small steps to a high power stay numbers
        p = order[..., None]
        rest = wanted - p * np.log(finest) - np.log(np.expm1(p * np.log(h / finest)))
        return np.asarray(np.square(rest - rest.mean(axis=-1, keepdims=True)).sum(axis=-1))

    low, high = (np.full(known.shape, end) for end in _ORDERS)
    for _ in range(_CUTS):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        nearer = missed(left) < missed(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    return np.asarray(np.where(known, (low + high) / 2, np.nan))
