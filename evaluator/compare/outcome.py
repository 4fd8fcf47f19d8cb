"""Where bodies and joints end: whether head's runs lie apart from base's, and whether they vary as much."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compare.finding import Change, Finding, Question, Settings, judged, not_compared
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.variability import run_to_run_variability
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.group_runs import Runs, positions
from gpusimbench.evaluator.results.joint_metrics import joint_spaces, run_distances
from gpusimbench.evaluator.results.metric import Axis, Metric
from gpusimbench.evaluator.runs.positions import positional
from gpusimbench.evaluator.statistics.exchange import Shift, compare_distances, compare_within, least_p


@dataclass(frozen=True)
class Distances:
    """Distances between runs, those of base first.

    matrix     shape [run, run]
    unit       of it: "cm" or "rad"
    n          runs of base and of head
    exact      whether they are no upper bounds
    alike      of each side, whether all its runs are bit-identical at the sample step
    same       whether base's first run is head's first, bit by bit
    """

    matrix: NDArray[np.float64]
    unit: str
    n: tuple[int, int]
    exact: bool
    alike: tuple[bool, bool]
    same: bool

    @property
    def head(self) -> list[bool]:
        """Whether each run is of head."""
        return [False] * self.n[0] + [True] * self.n[1]

    def within(self) -> tuple[float | None, float | None]:
        """Mean distance between runs of base, and between runs of head; None of a single run."""
        of_base, of_head = slice(0, self.n[0]), slice(self.n[0], None)
        return _mean(self.matrix[of_base, of_base]), _mean(self.matrix[of_head, of_head])


def distances(base: Runs, head: Runs, work: Work) -> Distances | Missing | None:
    """W1 between runs [cm]; None where no states were captured."""
    one, why = positions(base)
    other, why_head = positions(head)
    if one is None or other is None:
        captured = any("capture" in r.configuration.phases for r in (*base, *head))
        return Missing(why or why_head) if captured else None
    if one.shape[1:] != other.shape[1:]:
        return Missing("the runs have different numbers of environments or bodies")
    try:
        found = run_to_run_variability(np.concatenate([one, other]), work.map)
    except ValueError as error:
        return Missing(str(error))
    if found.matrix_cm is None:
        return Missing("too many large runs to compute all distances")
    alike = [len({run.tobytes() for run in side}) == 1 for side in (one, other)]
    return Distances(
        found.matrix_cm,
        "cm",
        (len(one), len(other)),
        found.exactness == "exact",
        (alike[0], alike[1]),
        one[0].tobytes() == other[0].tobytes(),
    )


def joint_distances(base: Runs, head: Runs, unit: str) -> Distances | Missing | None:
    """Distances in joint space between runs; None where neither side recorded joints of the unit.

    unit  "rad" for joints that turn, "cm" for joints that slide
    """
    spaces = [joint_spaces(runs, unit) for runs in (base, head)]
    if all(isinstance(side, Missing) for side in spaces):
        return None
    both = joint_spaces((*base, *head), unit)
    if why_not := next((side for side in (*spaces, both) if isinstance(side, Missing)), None):
        return why_not
    assert not isinstance(both, Missing)
    bits = [(s.coordinates.tobytes(), s.balls.tobytes()) for s in both]
    sides = bits[: len(base)], bits[len(base) :]
    return Distances(
        run_distances(both, unit),
        unit,
        (len(base), len(head)),
        True,
        (len(set(sides[0])) == 1, len(set(sides[1])) == 1),
        sides[0][0] == sides[1][0],
    )


def has_positions(base: Runs, head: Runs) -> bool:
    """Whether there is anything to decide: a run that recorded positions of bodies, or a side without a run."""
    return any(positional(run.fields) for run in (*base, *head)) or not (base and head)


def _mean(matrix: NDArray[np.float64]) -> float | None:
    runs = len(matrix)
    return float(matrix.sum()) / (runs * (runs - 1)) if runs > 1 else None


@dataclass(frozen=True)
class _Question:
    """What is asked of a distance between runs: its name and title, and how it is called."""

    name: str
    title: str
    method: str
    short: str


W1 = _Question(
    "outcome", "where bodies end, W1", "W1 between the pooled planar positions of two runs at the sample step", "W1"
)
_JOINTS = "root mean square over joints of the difference between two runs at the sample step, mean over environments"
JOINT_OUTCOMES = {
    "rad": _Question("outcome_joint_angles", "where joints end, angles", _JOINTS, "distance"),
    "cm": _Question("outcome_joint_slides", "where sliding joints end", _JOINTS, "distance"),
}
"""By the unit of the distance."""

_FEW = "needs at least two complete runs on each side"


def compare_outcomes(
    found: Distances | Missing | None, settings: Settings, *, applies: bool, asked: _Question = W1
) -> Finding | Question | None:
    """Distance between runs of base and of head, beside that between runs of one side.

    None where no states were captured, or neither side has what the distance is of.

    Where all runs of each side are bit-identical, as far as positions at the sample step go, the two outcomes are
    compared as they are; otherwise whole runs are exchanged.
    """
    if found is None:
        return None
    if isinstance(found, Missing):
        return not_compared(Axis.PHYSICS, asked.name, asked.title, found.reason, applies=applies)
    finding = Finding(
        Axis.PHYSICS, asked.name, asked.title, Change.SAME, unit=found.unit, n=found.n,
        method=f"{asked.method}{_bounds(found)}", said=_apart(found),
    )  # fmt: skip
    if all(found.alike):
        if found.same:
            return replace(finding, note="bit-identical in every run at the sample step")
        if min(found.n) > 1:
            change = Change.CHANGED if found.matrix[0, -1] > settings.least_outcome(found.unit) else Change.SMALL
            return replace(finding, change=change, note="the runs of each side are bit-identical at the sample step")
    if min(found.n) < 2:
        return not_compared(Axis.PHYSICS, asked.name, asked.title, _FEW)
    return _Outcome(found, finding, settings, asked)


def compare_spread(
    metric: Metric, found: Distances | Missing | None, settings: Settings, *, applies: bool
) -> Finding | Question | None:
    """W1 between runs of base beside W1 between runs of head; None where no states were captured.

    Whole runs are exchanged, with any other: no clock is in what they compute.
    """
    if found is None:
        return None
    axis, name, title = Axis.VARIABILITY, metric.name, metric.title
    if isinstance(found, Missing):
        return not_compared(axis, name, title, found.reason, applies=applies)
    base, head = found.within()
    if base is None or head is None:
        return not_compared(axis, name, title, _FEW)
    finding = Finding(
        axis, name, title, Change.SAME, metric.direction, metric.unit, base=base, head=head,
        ratio=head / base if base > 0 else None, n=found.n, method=f"{metric.method}{_bounds(found)}",
    )  # fmt: skip
    if all(found.alike):
        return replace(finding, note="the runs of each side are bit-identical at the sample step")
    return _Spread(found, finding, settings, W1)


@dataclass(frozen=True)
class _Exchanged:
    """A question that exchanges whole runs with any other, since no clock is in what they compute."""

    found: Distances
    finding: Finding
    settings: Settings
    asked: _Question

    @property
    def least_p(self) -> float:
        """See Question."""
        return least_p(self.found.head, [0] * sum(self.found.n))

    @property
    def _least(self) -> float:
        return self.settings.least_outcome(self.found.unit)


class _Outcome(_Exchanged):
    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question."""
        found = compare_distances(self.found.matrix, self.found.head)
        shown = replace(
            _tested(self.finding, found),
            change=Change.CHANGED if found.difference > self._least else Change.SMALL,
            note=f"{self.asked.short} between runs of different sides minus {self.asked.short} between runs of one "
            f"side: {found.difference:.3g} {self.found.unit}",
        )
        return shown, replace(shown, change=Change.UNCLEAR, left_open=() if able else (Change.CHANGED,))


class _Spread(_Exchanged):
    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question."""
        found = compare_within(self.found.matrix, self.found.head)
        base, head = self.finding.base or 0.0, self.finding.head or 0.0
        large = self.settings.matters(base, head) and abs(head - base) >= self._least
        change = judged(self.finding.direction, rises=head > base)
        shown = replace(_tested(self.finding, found), change=change if large else Change.SMALL)
        left = () if able else (Change.REGRESSION, Change.IMPROVEMENT)
        return shown, replace(shown, change=Change.UNCLEAR, left_open=left)


def _tested(finding: Finding, found: Shift) -> Finding:
    return replace(
        finding,
        p_value=found.p_value,
        least_p=found.least_p,
        test=f"permutation test, whole runs exchanged with any other ({found.ways})",
    )


def _bounds(found: Distances) -> str:
    return "" if found.exact else " (upper bounds)"


def _apart(found: Distances) -> tuple[str, str]:
    """Mean distance within each side, and between the two."""
    base, head = (
        "" if one is None else f"{one:.3g} within {side}"
        for one, side in zip(found.within(), ("base", "head"), strict=True)
    )
    between = f"{found.matrix[: found.n[0], found.n[0] :].mean():.3g} between them"
    return base, f"{head}, {between}" if head else between
