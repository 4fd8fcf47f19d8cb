"""Groups that differ in the time step alone: the order in which their states at the sample time approach those of the
finest, from errors at several steps.

An error of order p is C h^p for small steps h. Against a finer step h0 of the same method, instead of the exact motion,
it is C (h^p - h0^p), which is fitted here, so that h0 need not be far below the others (Roache, Verification and
Validation in Computational Science and Engineering, 1998, chapter 5).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.cases import FEWEST, interval_over_cases

Array = npt.NDArray[np.float64]

FEWEST_STEPS = 3
"""Steps with an error: two give one local order, which nothing contradicts."""

AGREE = 0.2
"""How far the local order of two neighbouring steps may be from the fitted order in the asymptotic range."""

_ORDERS = (0.05, 8.0)  # between which an order is looked for, by golden sections
_GOLDEN = (5**0.5 - 1) / 2
_CUTS = 36  # to 3e-7

FEWEST_GROUPS = FEWEST_STEPS + 1
"""Steps of a family: the finest is what the others are compared with."""


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


@dataclass(frozen=True)
class Convergence:
    """Steps of one simulator, with one set of settings, on one device and scene, from the same initial states.

    label    without the step
    scene    its name
    time     simulated time at which states are compared [s]
    finest   the smallest step [s], which the others are compared with
    what     is compared: "joints" or "positions"
    unit     of the errors: rad, m
    found    the fitted order, or why there is none
    left_out steps that were not compared, each with the reason
    """

    label: str
    scene: str
    time: float
    finest: float
    what: str
    unit: str
    found: Order | Missing
    left_out: tuple[str, ...] = ()


def convergences(results: Sequence[GroupResult], times: dict[str, float]) -> tuple[Convergence, ...]:
    """Every family of at least FEWEST_GROUPS steps.

    times  simulated time at which positions of each scene are compared [s]
    """
    families: dict[GroupKey, dict[float, GroupResult]] = {}
    for result in results:
        if result.group.complete:
            families.setdefault(_family(result.group.key), {}).setdefault(result.group.key.dt, result)
    chosen = {key: by_dt for key, by_dt in families.items() if len(by_dt) >= FEWEST_GROUPS}
    runs = [run for by_dt in chosen.values() for result in by_dt.values() for run in result.group.recordings]
    named = labels(list(chosen), options_given(runs))
    return tuple(
        _converges(label, [by_dt[dt] for dt in sorted(by_dt)], times[key.scene])
        for label, (key, by_dt) in zip(named, chosen.items(), strict=True)
    )


def _family(key: GroupKey) -> GroupKey:
    # how many steps are warm-up and timed follows from the step where a scene has a window in seconds
    return replace(key, dt=0.0, warmup=0, timed_steps=0)


def _converges(label: str, by_dt: Sequence[GroupResult], time: float) -> Convergence:
    left_out, states = [], dict[float, NDArray[np.float64]]()
    what, unit = "positions", "m"
    for result in by_dt:
        dt, run = result.group.key.dt, result.group.complete[0]
        found = _state(run)
        if not math.isclose(sampling_step(time, dt) * dt, time, rel_tol=1e-9):
            left_out.append(f"{dt:g} s: {time:g} s is no whole number of steps")
        elif isinstance(found, Missing):
            left_out.append(f"{dt:g} s: {found.reason}")
        else:
            what, unit, states[dt] = found
    finest = min(states, default=min(result.group.key.dt for result in by_dt))
    scene = by_dt[0].group.key.scene
    order: Order | Missing = Missing(f"an order needs {FEWEST_GROUPS} steps that can be compared")
    if len(states) >= FEWEST_GROUPS:
        steps = [dt for dt in states if dt != finest]
        errors = [np.linalg.norm(states[dt] - states[finest], axis=1) for dt in steps]
        order = fit_order(steps, np.array(errors), finest=finest)
    return Convergence(label, scene, time, finest, what, unit, order, tuple(left_out))


def _state(run: Run) -> tuple[str, str, NDArray[np.float64]] | Missing:
    """What is compared, its unit, and the numbers of each environment, [env, number]; hinges before slides before
    positions."""
    if not isinstance(run.joints, Missing):
        for unit, joints in (("rad", run.joints.turning), ("m", run.joints.sliding)):
            if not isinstance(joints, Missing) and joints.space.coordinates.shape[1]:
                return "joints", unit, joints.space.coordinates
    if isinstance(run.positions, Missing):
        return run.positions
    local = run.positions.local
    return "positions", "m", local.reshape(len(local), -1)
