"""Laws in closed form, for a group of runs: the difference from the prediction, and the smallest change that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import LawCounts, LawValues, PhysicsFacts
from gpusimbench.evaluator.statistics.counts import FEWEST, uniformity

POWER = 0.95
"""With which the smallest change is detected, by a two-sided test of 5 %."""

_ALPHA = 0.05
_Z = float(ndtri(0.975) + ndtri(POWER))
_ROUNDING = 1e-12  # share of a value below which environments do not spread


@dataclass(frozen=True)
class Sensitivity:
    """Of a law to one parameter.

    parameter  as of LawValues.slopes
    least      the smallest change that two recordings of these environments show with POWER; None: the law does not
               depend on it
    exact      the environments do not spread: the change is that which moves the mean by the tolerance
    """

    parameter: str
    least: float | None
    exact: bool


@dataclass(frozen=True)
class Law:
    """One law of one group.

    label, scene  of the group
    count         environments that could be measured, of `of_envs`; each is the mean over runs
    difference    measured minus predicted, mean over environments; None where nothing is predicted
    ci95          of the same, or of the measured value, by Student's t; None with one environment
    held          whether the interval, or the mean without one, comes within the tolerance of zero; None
                  without a prediction
    spread        standard deviation of what the interval is of, over environments
    absent        why the other environments could not be measured; empty where all were
    unjudged      why there is no prediction, and so no verdict; empty where there is
    p             of the chi-squared test, where the law says that outcomes are equally likely: `count` of `of_envs`
                  throws had an outcome, `measured` is the statistic, `predicted` its degrees of freedom, and it holds
                  where the statistic is below its 95 % point
    """

    label: str
    scene: str
    key: str
    title: str
    unit: str
    count: int
    of_envs: int
    measured: float
    predicted: float | None
    difference: float | None
    ci95: tuple[float, float] | None
    tolerance: float
    of: str
    held: bool | None
    sensitivities: tuple[Sensitivity, ...]
    spread: float
    absent: str = ""
    unjudged: str = ""
    p: float | None = None


@dataclass(frozen=True)
class Unmeasured:
    """A law of one group that could not be measured, or all laws of its scene.

    label, scene  of the group
    key, title    of the law; of all laws of the scene, "" and "all laws of SCENE"
    reason        why not
    """

    label: str
    scene: str
    key: str
    title: str
    reason: str


def laws(label: str, facts: Sequence[PhysicsFacts]) -> tuple[Law | Unmeasured, ...]:
    """The laws of a group, from its usable runs: runs of one group begin alike, so environments are the sample."""
    by_key: dict[str, list[LawValues]] = {}
    counted: dict[str, LawCounts] = {}
    reasons: dict[str, None] = {}
    for one in facts:
        if isinstance(one.laws, Missing):
            reasons[one.laws.reason] = None
            continue
        for values in one.laws:
            if isinstance(values, LawCounts):
                counted.setdefault(values.key, values)  # runs that begin alike are no further throws
            else:
                by_key.setdefault(values.key, []).append(values)
    scene = facts[0].scene if facts else ""
    unread = tuple(Unmeasured(label, scene, "", f"all laws of {scene}", reason) for reason in reasons)
    measured = [_law(label, scene, found) for found in by_key.values()]
    return (*measured, *(_uniform(label, scene, found) for found in counted.values()), *unread)


def _uniform(label: str, scene: str, found: LawCounts) -> Law | Unmeasured:
    test = uniformity(found.counts, alpha=_ALPHA, power=POWER)
    if test is None:
        reason = f"{sum(found.counts)} of {found.of} throws have an outcome, and {FEWEST:g} are needed for each outcome"
        return Unmeasured(label, scene, found.key, found.title, reason)
    count = sum(found.counts)
    return Law(
        label, scene, found.key, found.title, "", count, found.of, test.statistic, float(test.degrees),
        test.statistic - test.degrees, None, test.critical - test.degrees, f"95 % of chi-squared; p = {test.p:.2g}",
        test.statistic <= test.critical, (Sensitivity("probability of a face", test.least, False),), 0.0,
        found.absent if count < found.of else "", p=test.p,
    )  # fmt: skip


def _law(label: str, scene: str, runs: Sequence[LawValues]) -> Law | Unmeasured:
    first = runs[0]
    alike = [run for run in runs if len(run.measured) == len(first.measured)]
    measured = np.mean([run.measured for run in alike], axis=0)
    told = [run.predicted for run in alike if not isinstance(run.predicted, Missing)]
    judged = len(told) == len(alike)
    # without a prediction, the interval is that of the measured value
    predicted = np.mean(told, axis=0) if judged else np.zeros_like(measured)
    there = np.isfinite(measured) & np.isfinite(predicted)
    count = int(there.sum())
    if not count:
        return Unmeasured(label, scene, first.key, first.title, first.absent)
    off = measured[there] - predicted[there]
    mean, error = float(off.mean()), standard_error(off)
    scale = float(np.abs(measured[there]).max(initial=0.0))
    exact = not error > _ROUNDING * scale
    ci95 = None
    if count > 1:
        half = float(stdtrit(count - 1, 0.975)) * error
        ci95 = (mean - half, mean + half)
    low, high = ci95 or (mean, mean)
    tolerance = max(run.tolerance for run in alike)
    return Law(
        label, scene, first.key, first.title, first.unit, count, len(first.measured),
        float(measured[there].mean()), float(predicted[there].mean()) if judged else None, mean if judged else None,
        ci95, tolerance, first.of, (low <= tolerance and high >= -tolerance) if judged else None,
        tuple(
            Sensitivity(name, least_change(slope, tolerance if exact else error, exact=exact), exact)
            for name, slope in first.slopes
        ),
        error * math.sqrt(count),
        first.absent if count < len(first.measured) else "",
        next((run.predicted.reason for run in alike if isinstance(run.predicted, Missing)), ""),
    )  # fmt: skip


def standard_error(values: npt.NDArray[np.float64]) -> float:
    """Of the mean; 0 with one value."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else 0.0


def least_change(slope: float, error: float, *, exact: bool) -> float | None:
    """The smallest change of a parameter that two recordings, before and after it, tell apart with POWER.

    slope  derivative of the mean by the parameter
    error  standard error of each mean, or the tolerance where `exact`

    (z.975 + z.95) sqrt(2) error / |slope|, the size of effect of a two-sample z test (Cohen, Statistical Power
    Analysis, chapter 2). None where the slope is 0.
    """
    if not slope:
        return None
    return (error if exact else _Z * math.sqrt(2.0) * error) / abs(slope)
