"""What gsb-fit says: whether fitting helps, errors before and after, and how to record with the options; also as JSON
and, every evaluation in a row, as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.fit.search import METHOD, Evaluation
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.metrics.tosses import TossErrors
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Block, Code, Document, Text, facts, table
from gpusimbench.evaluator.render.numbers import bounds
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses, errors_of
from gpusimbench.evaluator.statistics.cases import Paired, mean_interval, paired
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.tosses import EVEN, ODD

LEVEL = 0.05
"""A p value below this tells the fitted options from the start."""

_UNITS = {"position": ("cm", 100.0), "rotation": ("deg", 180.0 / math.pi)}

_TITLES = ("error of", "tosses", "before", "after", "change", "p")


@dataclass(frozen=True)
class ErrorChange:
    """An error before and after, mean over tosses.

    quantity, unit "position" [cm] or "rotation" [deg]
    tosses         EVEN or ODD
    before, after  with their 95 % intervals, by resampling tosses
    change         after less before, toss by toss
    """

    quantity: str
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
    compared: tuple[ErrorChange, ...]
    before: str
    after: str

    @property
    def held_out(self) -> ErrorChange:
        """The comparison that judges: the error of position on odd tosses."""
        return next(one for one in self.compared if (one.quantity, one.tosses) == ("position", ODD))

    @property
    def verdict(self) -> str:
        """Whether fitting helps, in a sentence."""
        if not self.command:
            return "No better options were found than those of the start."
        one = self.held_out
        turned = next(other for other in self.compared if (other.quantity, other.tosses) == ("rotation", ODD))
        errors = f"{_error_change(one)} on the {one.change.cases} odd tosses; {_error_change(turned)}"
        if one.change.p_value >= LEVEL:
            return f"The fit cannot be told apart from the start: {errors}."
        return f"Fitting {'helps' if one.change.mean < 0 else 'harms'}: {errors}."


def _error_change(one: ErrorChange) -> str:
    p = one.change.p_value
    return f"error of {one.quantity} {one.before:.3g} {one.unit} to {one.after:.3g} {one.unit} (p = {p:.2g})"


def compared(before: Recording, after: Recording, measured: MeasuredTosses) -> tuple[ErrorChange, ...]:
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


def _compared(of: str, tosses: str, before: TossErrors, after: TossErrors) -> ErrorChange:
    unit, factor = _UNITS[of]
    one, other = (np.asarray(getattr(errors, of)) * factor for errors in (before, after))
    return ErrorChange(of, unit, tosses, *_mean(one), *_mean(other), paired(other, one))


def _mean(values: NDArray[np.float64]) -> tuple[float, tuple[float, float] | None]:
    return float(values.mean()), mean_interval(values)


def fit_document(found: Fit) -> Document:
    """The verdict, the errors, and the command."""
    failed = sum(isinstance(one.error, Missing) for one in found.evaluations)
    cost = f"{plural(len(found.evaluations), 'evaluation')} of at most {found.budget}"
    blocks: list[Block] = [
        Text(found.verdict),
        facts(
            ("simulator", found.simulator),
            ("tosses", f"{found.source}, SHA-256 {found.sha256[:12]}..."),
            ("start", _words(found.start)),
            ("fitted", _words(found.fitted)),
            ("search", f"{cost}{f', {failed} of them failed' if failed else ''}; {METHOD}"),
        ),
        table("errors", "", _TITLES, [_row(one) for one in found.compared]),
        Text("Options were fitted to the error of position on even tosses. Only odd tosses judge them."),
    ]
    if found.command:
        blocks += [Text("To record with these options:"), Code((found.command,))]
    return Document("", tuple(blocks))


def dump_json(found: Fit) -> str:
    """The document that ``gsb-fit --json`` writes."""
    return dump(document_of({"verdict": found.verdict, "search": METHOD, **values_of(found)}))


def dump_csv(evaluations: Sequence[Evaluation]) -> str:
    """A row for each evaluation: its number, the options, the error on even tosses, and why there is none."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    names = list(evaluations[0].options) if evaluations else []
    rows.writerow(["evaluation", *names, "error_even_cm", "error_even_cm_missing"])
    for number, one in enumerate(evaluations, 1):
        error = ("", one.error.reason) if isinstance(one.error, Missing) else (repr(one.error), "")
        rows.writerow([number, *one.options.values(), *error])
    return stream.getvalue()


def _words(options: dict[str, str]) -> str:
    return ", ".join(f"{name}={value}" for name, value in options.items())


def _row(one: ErrorChange) -> list[str]:
    return [
        f"{one.quantity} [{one.unit}]",
        f"{one.change.cases} {one.tosses.split()[0]}",
        _span(one.before, one.before_ci95),
        _span(one.after, one.after_ci95),
        _span(one.change.mean, one.change.ci95),
        f"{one.change.p_value:.2g}" if one.tosses.startswith("odd") else "-",  # fitted tosses prove nothing
    ]


def _span(value: float, ci95: tuple[float, float] | None) -> str:
    return f"{value:.4g} {bounds(ci95, '{:.4g}'.format)}" if ci95 else f"{value:.4g}"
