"""Values of the runs of a group to one value: mean or median, SD and interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.throughput import typical_time
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.jackknife import Interval, jackknife_mean

NO_RUN = "no run of this group is complete"
"""Why a group has no value."""

_MIN_RUNS = 3  # for an interval
_ROUNDING = 1e-12  # of a value

Runs = Sequence[Run]


@dataclass(frozen=True)
class Aggregate:
    """One value of several runs.

    value   in the unit of the runs' values
    sd      standard deviation of a sample; None for one run, and where none is meant
    ci95    95 % interval, or why there is none; None where no interval is meant
    method  how the interval was obtained
    """

    value: float
    sd: float | None = None
    ci95: tuple[float, float] | Missing | None = None
    method: str = ""


@dataclass(frozen=True)
class Aggregator:
    """Makes one value of the values of runs.

    name      "mean" or "median"
    interval  what the interval is, for the documentation; empty where there is none
    """

    name: str
    interval: str
    of: Callable[[Sequence[float]], Aggregate]


def mean_of(values: Sequence[float]) -> Aggregate:
    """The mean of nonnegative values, one a run, with SD and a jackknife interval."""
    found = np.array(values)
    spread = differ(found)
    interval = jackknife_mean(found) if len(found) >= _MIN_RUNS else None
    bounds = ends_of(interval, len(found), spread=spread)
    # equal values have their very value for a mean, and no deviation: sums of them round
    return Aggregate(
        float(np.mean(values)) if spread else values[0],
        sd=(float(np.std(values, ddof=1)) if spread else 0.0) if len(found) > 1 else None,
        ci95=bounds,
        method=interval.method if bounds and interval else "",
    )


def median_of(values: Sequence[float]) -> Aggregate:
    """The median, without SD and interval."""
    return Aggregate(typical_time(values))


MEAN = Aggregator("mean", "delete-one-run jackknife", mean_of)
MEDIAN = Aggregator("median", "", median_of)


def differ(values: NDArray[np.float64]) -> bool:
    """Whether values are apart by more than the rounding of what they are computed from."""
    return bool(np.ptp(values) > _ROUNDING * np.abs(values).max()) if values.size else False


def ends_of(interval: Interval | None, runs: int, *, spread: bool) -> tuple[float, float] | Missing:
    """The interval's ends, or why there are none; `spread` says whether the runs differ at all."""
    if runs < _MIN_RUNS or interval is None:
        return Missing(f"needs at least {_MIN_RUNS} runs")
    if not spread:
        # an interval of width zero would claim that rare differences are excluded
        return Missing(f"no spread in {runs} runs")
    return interval.ci95
