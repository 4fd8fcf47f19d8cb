"""Laws in closed form, for a group of runs: the difference from the prediction, and the smallest change that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri, stdtrit

from gpusimbench.evaluator.runs.physics.facts import LawValues, PhysicsFacts

Array = npt.NDArray[np.float64]

UNITS = {"damping": "N m s/rad"}
"""Of parameters whose changes are no shares of them."""

POWER = 0.95
"""With which the smallest change is detected, by a two-sided test of 5 %: of two recordings, Wilcoxon's rank-sum test,
which an environment far from all others does not blind."""

_RANKS = math.sqrt(math.pi / 3.0)  # of normal values, ranks need 3 / pi of the effect squared (Pitman's efficiency)

LARGEST = 0.2
"""Share of a parameter beyond which no size is claimed: sizes follow from derivatives, and laws are not linear."""

_ROUNDING = 1e-12  # share of a value below which environments do not spread
_ALIKE = 1e-3  # share of the tolerance below which they do not either: solvers that stop early leave such differences
_UNEVEN = 0.1  # share by which the effect of a change differs between environments, or as much as predicted values do


@dataclass(frozen=True)
class Sensitivity:
    """Of a law to one parameter.

    parameter  "mass", "friction" (shares), "damping" (N m s/rad)
    slope      derivative of the predicted value by it; 0: the law does not depend on it
    least      the smallest change that two recordings of these environments show with POWER; None where the law does
               not depend on the parameter, or where no change is sure to show: with too few environments, or up to
               LARGEST
    exact      the environments do not spread: `least` is the change that moves the mean by the tolerance
    breaks     the smallest change with which one recording of these environments breaks the law with POWER, whatever
               its sign; None likewise, and where the law is broken without a change
    """

    parameter: str
    slope: float
    least: float | None
    exact: bool
    breaks: float | None


@dataclass(frozen=True)
class Law:
    """One law of one group.

    label, scene  of the group
    count         environments that could be measured, of `of_envs`; each is the mean over runs
    difference    measured minus predicted, mean over environments
    ci95          of the same, by Student's t; None with one environment
    held          whether the interval, or the mean without one, comes within the tolerance of zero
    """

    label: str
    scene: str
    key: str
    title: str
    unit: str
    count: int
    of_envs: int
    measured: float
    predicted: float
    difference: float
    ci95: tuple[float, float] | None
    tolerance: float
    of: str
    held: bool
    sensitivities: tuple[Sensitivity, ...]

    @property
    def said(self) -> str:
        """The law with what was measured and predicted, in words."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.title} {self.measured:.4g}{unit}, predicted {self.predicted:.4g}{unit}"


def laws(label: str, facts: Sequence[PhysicsFacts]) -> tuple[Law, ...]:
    """The laws of a group, from its usable runs: runs of one group begin alike, so environments are the sample."""
    by_key: dict[str, list[LawValues]] = {}
    for values in (values for one in facts for values in one.laws):
        by_key.setdefault(values.key, []).append(values)
    scene = facts[0].scene if facts else ""
    return tuple(law for found in by_key.values() if (law := _law(label, scene, found)) is not None)


def _law(label: str, scene: str, runs: Sequence[LawValues]) -> Law | None:
    first = runs[0]
    alike = [run for run in runs if len(run.measured) == len(first.measured)]
    measured = np.mean([run.measured for run in alike], axis=0)
    predicted = np.mean([run.predicted for run in alike], axis=0)
    there = np.isfinite(measured) & np.isfinite(predicted)
    count = int(there.sum())
    if not count:
        return None
    off = measured[there] - predicted[there]
    mean, error = float(off.mean()), standard_error(off)
    scale = float(np.abs(measured[there]).max(initial=0.0))
    tolerance = max(run.tolerance for run in alike)
    exact = not error > max(_ROUNDING * scale, _ALIKE * tolerance)
    half = float(stdtrit(count - 1, 0.975)) * error if count > 1 else 0.0
    low, high = mean - half, mean + half
    held = low <= tolerance and high >= -tolerance
    shown = tolerance if exact else showing_move(off, predicted[there])
    moved = breaking_move(off, predicted[there], tolerance) if held else None
    return Law(
        label, scene, first.key, first.title, first.unit, count, len(first.measured),
        float(measured[there].mean()), float(predicted[there].mean()), mean, (low, high) if count > 1 else None,
        tolerance, first.of, held,
        tuple(
            Sensitivity(name, float(slope), _size(shown, slope, name), exact, _size(moved, slope, name))
            for name, slope in first.slopes
        ),
    )  # fmt: skip


def _size(move: float | None, slope: float, parameter: str) -> float | None:
    """The change of a parameter that moves the mean so far."""
    if move is None or not slope:
        return None
    size = float(move / abs(slope))
    return size if parameter in UNITS or size <= LARGEST else None


def standard_error(values: Array) -> float:
    """Of the mean; 0 with one value."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else 0.0


def _most_error(values: Array) -> float:
    """The upper 95 % limit of the standard error, of normal values: a claim that takes the estimate for the truth is
    too small half of the time."""
    n = len(values)
    return standard_error(values) * math.sqrt((n - 1) / float(chdtri(n - 1, POWER))) if n > 1 else 0.0


def _unevenness(predicted: Array) -> float:
    """The share by which the effect of a change differs between environments, over the root of their number."""
    middle = abs(float(predicted.mean()))
    spread = float(predicted.std(ddof=1)) / middle if len(predicted) > 1 and middle else 0.0
    return max(_UNEVEN, spread) / math.sqrt(len(predicted))


def showing_move(off: Array, predicted: Array) -> float | None:
    """How far a change has to move the mean so that recordings before and after it are told apart with POWER.

    off, predicted  by environment, without the change: measured minus predicted, and predicted

    The size of effect of a two-sample t test (Cohen, Statistical Power Analysis, chapter 2), with the standard error s
    of both, and an effect d that spreads over n environments by a share k of itself: d = q sqrt(2 s^2 + k^2 d^2 / n),
    q = (t.975 + t.95) sqrt(pi / 3) with 2n - 2 degrees of freedom, the root for ranks instead of values. s is
    its own upper 95 % limit; k is the coefficient of variation of the predicted values, and _UNEVEN at least. None
    where no d is large enough.
    """
    if len(off) < 2:
        return None
    degrees = 2 * len(off) - 2
    q = _RANKS * float(stdtrit(degrees, 0.975) + stdtrit(degrees, POWER))
    left = 1.0 - (q * _unevenness(predicted)) ** 2
    return q * math.sqrt(2.0 / left) * _most_error(off) if left > 0.0 else None


def breaking_move(off: Array, predicted: Array, tolerance: float) -> float | None:
    """How far a change has to move the mean, to either side, so that the 95 % interval leaves the tolerance with POWER.

    off, predicted  as of showing_move

    d >= tolerance + |m| + q (s + k d / sqrt(n)), with the mean m, q = t.975 + t.95 with n - 1 degrees of freedom, and s
    and k as of showing_move. None where no d is large enough.
    """
    n, mean = len(off), abs(float(off.mean()))
    if n < 2:
        return tolerance + mean
    q = float(stdtrit(n - 1, 0.975) + stdtrit(n - 1, POWER))
    left = 1.0 - q * _unevenness(predicted)
    return (tolerance + mean + q * _most_error(off)) / left if left > 0.0 else None
