"""What a fit was worth: errors of the start and of the fitted options, on tosses that were fitted and on the others."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.fit.search import Evaluation
from gpusimbench.evaluator.metrics.tosses import TossErrors
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses, errors_of
from gpusimbench.evaluator.statistics.cases import Paired, mean_interval, paired
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.tosses import EVEN, ODD

LEVEL = 0.05
"""A p value below this tells the fitted options from the start."""

_UNITS = {"position": ("cm", 100.0), "rotation": ("deg", 180.0 / math.pi)}


@dataclass(frozen=True)
class Compared:
    """An error before and after, mean over tosses.

    of, unit       "position" [cm] or "rotation" [deg]
    tosses         EVEN or ODD
    before, after  with their 95 % intervals, by resampling tosses
    change         after less before, toss by toss
    """

    of: str
    unit: str
    tosses: str
    before: float
    before_ci95: tuple[float, float] | None
    after: float
    after_ci95: tuple[float, float] | None
    change: Paired


@dataclass(frozen=True)
class Fit:
    """A fit and what it is worth.

    simulator      with the options that stay as they are, and its version
    source, sha256 of the tosses
    command        that records with the fitted options; empty where the start was the best
    evaluations    in order, the first with the start
    compared       errors of position and rotation, on even and on odd tosses
    before, after  content hashes of the two recordings; the same where the start was the best
    """

    simulator: str
    source: str
    sha256: str
    start: dict[str, str]
    fitted: dict[str, str]
    budget: int
    command: str
    evaluations: tuple[Evaluation, ...]
    compared: tuple[Compared, ...]
    before: str
    after: str

    @property
    def held_out(self) -> Compared:
        """The comparison that judges: the error of position on odd tosses."""
        return next(one for one in self.compared if (one.of, one.tosses) == ("position", ODD))

    @property
    def verdict(self) -> str:
        """Whether fitting helps, in a sentence."""
        if not self.command:
            return "No better options were found than those of the start."
        one = self.held_out
        turned = next(other for other in self.compared if (other.of, other.tosses) == ("rotation", ODD))
        errors = f"{_said(one)} on the {one.change.cases} odd tosses; {_said(turned)}"
        if one.change.p_value >= LEVEL:
            return f"The fit cannot be told apart from the start: {errors}."
        return f"Fitting {'helps' if one.change.mean < 0 else 'harms'}: {errors}."


def _said(one: Compared) -> str:
    p = one.change.p_value
    return f"error of {one.of} {one.before:.3g} {one.unit} to {one.after:.3g} {one.unit} (p = {p:.2g})"


def compared(before: Recording, after: Recording, measured: MeasuredTosses) -> tuple[Compared, ...]:
    """Errors of two recordings, on even and on odd tosses. GsbError where one has none."""
    found = []
    for of in _UNITS:
        for tosses in (EVEN, ODD):
            one, other = (_errors(recording, measured, tosses) for recording in (before, after))
            found.append(_compared(of, tosses, one, other))
    return tuple(found)


def _errors(recording: Recording, measured: MeasuredTosses, tosses: str) -> TossErrors:
    errors = errors_of(recording, measured, tosses)
    if isinstance(errors, Missing):
        raise GsbError(f"{recording.path}: {errors.reason}")
    return errors


def _compared(of: str, tosses: str, before: TossErrors, after: TossErrors) -> Compared:
    unit, factor = _UNITS[of]
    one, other = (np.asarray(getattr(errors, of)) * factor for errors in (before, after))
    return Compared(of, unit, tosses, *_mean(one), *_mean(other), paired(other, one))


def _mean(values: NDArray[np.float64]) -> tuple[float, tuple[float, float] | None]:
    return float(values.mean()), mean_interval(values)
