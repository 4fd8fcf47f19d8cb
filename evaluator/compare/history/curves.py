"""The curve of a quantity over the points of a series, and where it changed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gpusimbench.evaluator.compare.finding import Change, Settings, judged
from gpusimbench.evaluator.compare.history.series import Entry, Series
from gpusimbench.evaluator.compare.numbers import compared_by, matters
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.results.group_runs import MEDIAN
from gpusimbench.evaluator.results.metric import Axis, Metric
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.statistics.change_points import (
    MIN_POINTS,
    ChangePoint,
    change_points,
    least_visible,
    steps_of,
)

FACT = Missing("a fact: the values of all runs of a point are equal")

_MOST = 1e100
"""A file may hold any number; larger ones, and those below the inverse, are not compared."""

_MOST_LOG = 700.0
"""Of what has an exponential that is a float."""


@dataclass(frozen=True)
class Sample:
    """A quantity at a point, in its unit.

    point   index of the point
    value   aggregate over the runs, or why there is none
    ci95    95 % interval of the estimate; None where it has none
    n       runs that have a value
    center  what change points are searched in: mean or median, as the metric has it, of the runs' logarithms or values,
            in the base unit
    alike   whether at least two runs have a value, and all have this very value
    """

    point: int
    value: float | Missing
    ci95: tuple[float, float] | None = None
    n: int = 0
    center: float = math.nan
    alike: bool = False


@dataclass(frozen=True)
class Shift:
    """A change of a quantity.

    point, previous  index of the first point with the new level, and of the point before it
    change           the verdict
    before, after    levels between changes: geometric means over points where all values are positive [unit]
    ratio, ci95      after / before, with a 95 % interval; None where there is none
    p_value          of the search in this curve, or why there is none: the change is a fact, or points show no noise
    """

    point: int
    previous: int
    change: Change
    before: float
    after: float
    ratio: float | None
    ci95: tuple[float, float] | None
    p_value: float | Missing


@dataclass(frozen=True)
class Curve:
    """A quantity of a series.

    samples  a point each, in order
    logs     whether logarithms are compared: all values are positive
    exact    whether every point has at least two runs, which agree to the last bit: every change is a fact
    shifts   changes, in order
    visible  how far from the newest level one more point would have to lie to be marked, about: a factor above 1 where
             logarithms are compared, else an amount in the unit; None where that cannot be told
    sighted  the same of the newest point itself: how far it would have had to lie from those before it
    changes_missing  why no change is searched; empty where one is
    """

    metric: Metric
    axis: Axis
    samples: tuple[Sample, ...]
    logs: bool
    exact: bool
    shifts: tuple[Shift, ...] = ()
    visible: float | None = None
    sighted: float | None = None
    changes_missing: str = ""

    @property
    def known(self) -> list[Sample]:
        """The points that have a value."""
        return [sample for sample in self.samples if not isinstance(sample.value, Missing)]

    @property
    def varies(self) -> bool:
        """Whether it has two points, and not one value."""
        return len({sample.value for sample in self.known}) > 1

    @property
    def tested(self) -> bool:
        """Whether changes are searched by a test, which can raise a false alarm."""
        found = self.known
        return not self.changes_missing and not self.exact and len({sample.center for sample in found}) > 1

    def undecided(self, newest: int, settings: Settings) -> str:
        """Why it does not say whether the newest point changed by as much as matters; empty where it does."""
        if self.changes_missing:
            return self.changes_missing
        if self.known[-1].point != newest:
            return "the newest point has no value"
        if not self.tested or self.shifts and self.shifts[-1].point == newest:
            return ""
        if self.sighted is None:
            return "too few points since the last change"
        level = abs(float(known(self.known[-1].value) or 0.0)) * self.metric.per_unit
        end = level * self.sighted if self.logs else level + self.sighted * self.metric.per_unit
        hidden = matters(self.metric, level, end, settings)
        return "points differ so much that a change above the threshold could not be seen" if hidden else ""


def curves_of(series: Series) -> Iterator[Curve]:
    """A curve for each quantity that any point has, without its changes."""
    runs = [run for entry in series.entries for run in entry.runs.runs]
    for axis in Axis:
        of_runs = list(compared_by(axis, runs, ()))
        of_group = [m for m in METRICS.values() if m.axis is axis and m.values is None]
        for metric in (*of_runs, *of_group):
            if curve := _curve(metric, axis, series.entries):
                yield curve


def searched(curve: Curve, level: float, settings: Settings) -> Curve:
    """The curve with its changes.

    level  chance of a false alarm that this curve may take
    """
    if curve.changes_missing:
        return curve
    found = curve.known
    centers = [sample.center for sample in found]
    if curve.exact:
        return replace(curve, shifts=tuple(_fact(curve, index, settings) for index in steps_of(centers)))
    changes = change_points(centers, level)
    ends = [0, *(one.index for one in changes), len(centers)]
    *before, newest = (centers[low:high] for low, high in pairwise(ends))
    return replace(
        curve,
        shifts=tuple(_shift(curve, one, settings) for one in changes),
        visible=_visible(curve, newest, before, level),
        sighted=_visible(curve, newest[:-1], before, level),
    )


def _visible(curve: Curve, newest: Sequence[float], before: Sequence[Sequence[float]], level: float) -> float | None:
    """What one more point would have to be, as `Curve.visible` has it."""
    found = least_visible(newest, level, before) if curve.tested else None
    if found is None:
        return None
    return math.exp(min(found, _MOST_LOG)) if curve.logs else found / curve.metric.per_unit


def _curve(metric: Metric, axis: Axis, entries: Sequence[Entry]) -> Curve | None:
    having = [entry for entry in entries if entry.runs.runs]
    values = [_values(metric, entry) for entry in having]
    if not any(values):
        return None
    flat = [value for of_point in values for value in of_point]
    logs = all(value > 0 for value in flat)
    samples = tuple(_sample(metric, entry, found, logs=logs) for entry, found in zip(having, values, strict=True))
    exact = metric.values is not None and all(s.alike for s in samples if not isinstance(s.value, Missing))
    curve = Curve(metric, axis, samples, logs, exact)
    if not all(value == 0 or 1 / _MOST < value < _MOST for value in flat):
        return replace(curve, changes_missing="a run has a value that is negative, not finite or too large")
    count = len(curve.known)
    if count < 2 or count < MIN_POINTS and not exact:
        return replace(curve, changes_missing=f"{count} point{'s have' if count > 1 else ' has'} a value: too few")
    return curve


def _values(metric: Metric, entry: Entry) -> list[float]:
    """The values of runs, or the one of the group, in the base unit."""
    if metric.values:
        return [float(value) for value in metric.values(entry.runs) if not isinstance(value, Missing)]
    value = metric.estimate(entry.runs).value
    return [] if isinstance(value, Missing) else [float(value) * metric.per_unit]


def _sample(metric: Metric, entry: Entry, values: Sequence[float], *, logs: bool) -> Sample:
    estimate = metric.estimate(entry.runs)
    if not values or isinstance(estimate.value, Missing):
        why = estimate.value if isinstance(estimate.value, Missing) else Missing("no run has a value")
        return Sample(entry.point, why)
    array = np.array(values)
    with np.errstate(all="ignore"):
        scale = np.log(array) if logs else array
    # of equal values the very value, whose mean would round
    middle = np.median if metric.aggregate is MEDIAN else np.mean
    center = float(scale[0] + middle(scale - scale[0]))
    n = len(values) if metric.values else estimate.n
    alike = len(values) > 1 and np.ptp(array) == 0.0
    return Sample(entry.point, float(estimate.value), estimate.ci95 or None, n, center, bool(alike))


def _fact(curve: Curve, index: int, settings: Settings) -> Shift:
    before, after = (float(known(curve.known[i].value) or 0.0) * curve.metric.per_unit for i in (index - 1, index))
    return _judged(curve, index, before, after, settings)


def _shift(curve: Curve, found: ChangePoint, settings: Settings) -> Shift:
    before, after = (math.exp(level) if curve.logs else level for level in (found.before, found.after))
    shift = _judged(curve, found.index, before, after, settings)
    ends = [math.exp(min(end, _MOST_LOG)) for end in found.ci95] if found.ci95 and curve.logs else None
    return replace(shift, ci95=(ends[0], ends[1]) if ends else None, p_value=found.p_value)


def _judged(curve: Curve, index: int, before: float, after: float, settings: Settings) -> Shift:
    """The verdict on two levels, in the base unit."""
    counts = matters(curve.metric, before, after, settings)
    scale = curve.metric.per_unit
    return Shift(
        point=curve.known[index].point,
        previous=curve.known[index - 1].point,
        change=judged(curve.metric.direction, rises=after > before) if counts else Change.SMALL,
        before=before / scale,
        after=after / scale,
        ratio=after / before if before > 0 else None,
        ci95=None,
        p_value=FACT,
    )
