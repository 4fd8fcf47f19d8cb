"""Laws in closed form, for a group of runs: the difference from the prediction, and the smallest change that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import LawCounts, LawValues, PhysicsFacts
from gpusimbench.evaluator.statistics.cases import standard_error, variation
from gpusimbench.evaluator.statistics.families import FEWEST, uniformity

Array = npt.NDArray[np.float64]

UNITS = {"damping": "N m s/rad", "angular damping": "1/s"}
"""Of parameters whose changes are no shares of them."""

POWER = 0.95
"""With which the smallest change is detected, by a two-sided test of 5 %: of two recordings, Wilcoxon's rank-sum test,
which an environment far from all others does not blind."""

_RANKS = math.sqrt(math.pi / 3.0)  # of normal values, ranks need 3 / pi of the effect squared (Pitman's efficiency)

LARGEST = 0.2
"""Share of a parameter beyond which no size is claimed: sizes follow from derivatives, and laws are not linear."""

_ALPHA = 1e-3  # of a law of counts, which bars from rankings: a right engine is to break it once in 1,000 recordings
_ROUNDING = 1e-12  # share of a value below which environments do not spread
_ALIKE = 1e-3  # share of the tolerance below which they do not either: solvers that stop early leave such differences
_UNEVEN = 0.1  # share by which the effect of a change differs between environments, or as much as predicted values do


@dataclass(frozen=True)
class Sensitivity:
    """How sensitive a law is to one parameter.

    parameter  as of LawValues.slopes; of a law of counts "probability of a face"
    slope      derivative of the predicted value by it; 0: the law does not depend on it; None: of a law of counts
    least      the smallest change that two recordings of these environments show with POWER, of a law of counts with
               which one recording breaks it; None where the law does not depend on the parameter, or where no change
               is sure to show: with too few environments, or up to LARGEST
    exact      the environments do not spread: `least` is the change that moves the mean by the tolerance
    breaks     the smallest change with which one recording of these environments breaks the law with POWER, whatever
               its sign; None likewise, and where the law is broken without a change, or predicts nothing
    """

    parameter: str
    slope: float | None
    least: float | None
    exact: bool
    breaks: float | None


@dataclass(frozen=True)
class Law:
    """One law of one group.

    label, scene  of the group
    count         environments that could be measured, of `of_envs`; each is the mean over runs
    difference    measured minus predicted, mean over environments; None where nothing is predicted
    ci95          of the same, or of the measured value, by Student's t; None with one environment
    held          whether the interval, or the mean without one, comes within the tolerance of zero; None
                  without a prediction
    sd            standard deviation of what the interval is of, over environments
    left_out      why the other environments could not be measured; empty where all were
    held_missing      why there is no prediction, and so no verdict; empty where there is
    p_value       of the chi-squared test, where the law says that outcomes are equally likely: `count` of `of_envs`
                  throws had an outcome, `measured` is the statistic, `predicted` its degrees of freedom, and it holds
                  where the statistic is below its 99.9 % point
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
    tolerance_formula: str
    held: bool | None
    sensitivities: tuple[Sensitivity, ...]
    sd: float
    left_out: tuple[str, ...] = ()
    held_missing: str = ""
    p_value: float | None = None

    @property
    def said(self) -> str:
        """The law with what was measured and, where anything is, predicted, in words."""
        unit = f" {self.unit}" if self.unit else ""
        predicted = "" if self.predicted is None else f", predicted {self.predicted:.4g}{unit}"
        return f"{self.title} {self.measured:.4g}{unit}{predicted}"


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
    load = Sensitivity("probability of a face", None, test.least, False, test.least)
    return Law(
        label=label, scene=scene, key=found.key, title=found.title, unit="", count=count, of_envs=found.of,
        measured=test.statistic, predicted=float(test.degrees), difference=test.statistic - test.degrees, ci95=None,
        tolerance=test.critical - test.degrees, tolerance_formula=f"99.9 % of chi-squared; p = {test.p:.2g}",
        held=bool(test.statistic <= test.critical), sensitivities=(load,), sd=0.0,
        left_out=(found.absent,) if count < found.of else (), p_value=test.p,
    )  # fmt: skip


def _law(label: str, scene: str, runs: Sequence[LawValues]) -> Law | Unmeasured:
    from scipy.special import stdtrit

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
    mean, error = float(off.mean()), standard_error(off) or 0.0
    scale = float(np.abs(measured[there]).max(initial=0.0))
    tolerance = float(max(run.tolerance for run in alike))
    exact = not error > max(_ROUNDING * scale, _ALIKE * tolerance)
    half = float(stdtrit(count - 1, 0.975)) * error if count > 1 else 0.0
    low, high = mean - half, mean + half
    held = bool(low <= tolerance and high >= -tolerance) if judged else None
    uneven = dict(first.uneven)

    def sensitivity(parameter: str, slope: float) -> Sensitivity:
        share = max(variation(predicted[there]), uneven.get(parameter, 0.0))
        shown = tolerance if exact else showing_move(off, share)
        moved = breaking_move(off, share, tolerance) if held else None
        least, breaks = _size(shown, slope, parameter), _size(moved, slope, parameter)
        return Sensitivity(parameter, float(slope), least, exact, breaks)

    return Law(
        label=label, scene=scene, key=first.key, title=first.title, unit=first.unit, count=count,
        of_envs=len(first.measured), measured=float(measured[there].mean()),
        predicted=float(predicted[there].mean()) if judged else None, difference=mean if judged else None,
        ci95=(low, high) if count > 1 else None, tolerance=tolerance, tolerance_formula=first.of, held=held,
        sensitivities=tuple(sensitivity(name, slope) for name, slope in first.slopes),
        sd=error * math.sqrt(count), left_out=(first.absent,) if count < len(first.measured) else (),
        held_missing=next((run.predicted.reason for run in alike if isinstance(run.predicted, Missing)), ""),
    )  # fmt: skip


def _size(move: float | None, slope: float, parameter: str) -> float | None:
    """The change of a parameter that moves the mean so far."""
    if move is None or not slope:
        return None
    size = float(move / abs(slope))
    return size if parameter in UNITS or size <= LARGEST else None


def _most_error(values: Array) -> float:
    """The upper 95 % limit of the standard error, of normal values: a claim that takes the estimate for the truth is
    too small half of the time."""
    from scipy.special import chdtri

    error, degrees = standard_error(values), len(values) - 1
    return 0.0 if error is None else error * math.sqrt(degrees / float(chdtri(degrees, POWER)))


def showing_move(off: Array, uneven: float) -> float | None:
    """How far a change has to move the mean so that recordings before and after it are told apart with POWER.

    off     by environment, without the change: measured minus predicted
    uneven  share by which the effect of a change differs between environments

    The size of effect of a two-sample t test (Cohen, Statistical Power Analysis, chapter 2), with the standard error s
    of both, and an effect d that spreads over n environments by a share k of itself: d = q sqrt(2 s^2 + k^2 d^2 / n),
    q = (t.975 + t.95) sqrt(pi / 3) with 2n - 2 degrees of freedom, the root for ranks instead of values. s is
    its own upper 95 % limit; k is `uneven`, and _UNEVEN at least. None where no d is large enough.
    """
    from scipy.special import stdtrit

    if len(off) < 2:
        return None
    degrees = 2 * len(off) - 2
    q = _RANKS * float(stdtrit(degrees, 0.975) + stdtrit(degrees, POWER))
    left = 1.0 - (q * max(_UNEVEN, uneven)) ** 2 / len(off)
    return q * math.sqrt(2.0 / left) * _most_error(off) if left > 0.0 else None


def breaking_move(off: Array, uneven: float, tolerance: float) -> float | None:
    """How far a change has to move the mean, to either side, so that the 95 % interval leaves the tolerance with POWER.

    off, uneven  as of showing_move

    d >= tolerance + |m| + q (s + k d / sqrt(n)), with the mean m, q = t.975 + t.95 with n - 1 degrees of freedom, and s
    and k as of showing_move. None where no d is large enough.
    """
    from scipy.special import stdtrit

    n, mean = len(off), abs(float(off.mean()))
    if n < 2:
        return tolerance + mean
    q = float(stdtrit(n - 1, 0.975) + stdtrit(n - 1, POWER))
    left = 1.0 - q * max(_UNEVEN, uneven) / math.sqrt(n)
    return (tolerance + mean + q * _most_error(off)) / left if left > 0.0 else None
