"""Laws in closed form, for a group of runs: the difference from the prediction, and the smallest change that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtrit

from gpusimbench.evaluator.runs.physics.facts import LawValues, PhysicsFacts

POWER = 0.95
"""With which the smallest change is detected, by a two-sided test of 5 %."""

_Z = float(ndtri(0.975) + ndtri(POWER))
_ROUNDING = 1e-12  # share of a value below which environments do not spread


@dataclass(frozen=True)
class Sensitivity:
    """Of a law to one parameter.

    parameter  "mass", "friction" (shares), "damping" (N m s/rad)
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
    exact = not error > _ROUNDING * scale
    ci95 = None
    if count > 1:
        half = float(stdtrit(count - 1, 0.975)) * error
        ci95 = (mean - half, mean + half)
    low, high = ci95 or (mean, mean)
    tolerance = max(run.tolerance for run in alike)
    return Law(
        label, scene, first.key, first.title, first.unit, count, len(first.measured),
        float(measured[there].mean()), float(predicted[there].mean()), mean, ci95, tolerance, first.of,
        low <= tolerance and high >= -tolerance,
        tuple(
            Sensitivity(name, least_change(slope, tolerance if exact else error, exact=exact), exact)
            for name, slope in first.slopes
        ),
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
