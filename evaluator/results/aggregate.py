"""Values of the runs of a group to one metric: mean, SD and interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.results.result import Metric
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.jackknife import Interval, jackknife_mean

NO_RUN = "no run of this group is complete"
"""Why a group has no value."""

_MIN_RUNS = 3  # for an interval
_ROUNDING = 1e-12  # of a value

Runs = Sequence[Run]


def mean_over_runs(
    name: str, unit: str, direction: str, values: list[float], *, method: str, extra: dict[str, Any]
) -> Metric:
    """A metric that is a mean of one value per run."""
    runs, spread = len(values), differ(np.array(values))
    interval = jackknife_mean(np.array(values), nonnegative=True) if runs >= _MIN_RUNS else None
    bounds, no_interval = ends_of(interval, runs, spread=spread)
    # equal values have their very value for a mean, and no deviation: sums of them round
    return Metric(
        name,
        float(np.mean(values)) if spread else values[0],
        unit,
        direction,
        n=runs,
        sd=(float(np.std(values, ddof=1)) if spread else 0.0) if runs > 1 else None,
        ci95=bounds,
        method=method + (f"; interval: {interval.method}" if bounds and interval else ""),
        extra={"per_run": values, "interval_why_not": no_interval, **extra},
    )


def differ(values: NDArray[np.float64]) -> bool:
    """Whether values are apart by more than the rounding of what they are computed from."""
    return bool(np.ptp(values) > _ROUNDING * np.abs(values).max()) if values.size else False


def ends_of(interval: Interval | None, runs: int, *, spread: bool) -> tuple[tuple[float, float] | None, str]:
    """The interval's ends, or None and why there are none; `spread` says whether the runs differ at all."""
    if runs < _MIN_RUNS or interval is None:
        return None, f"needs at least {_MIN_RUNS} runs"
    if not spread:
        # an interval of width zero would claim that rare differences are excluded
        return None, f"no spread in {runs} runs"
    if interval.low is None or interval.high is None:
        return None, interval.reason or "no interval"
    return (interval.low, interval.high), ""
