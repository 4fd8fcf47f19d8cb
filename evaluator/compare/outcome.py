"""Where the cubes end: whether head's runs lie apart from base's, beyond what runs of one side do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compare.finding import Axis, Change, Finding, Question, Settings, not_compared
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.variability import run_to_run_variability
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.sampled import positions
from gpusimbench.evaluator.runs.positions import GROUP
from gpusimbench.evaluator.statistics.exchange import compare_distances, least_p

_NAME, _TITLE = "outcome", "where cubes end, W1"
_METHOD = "W1 between the pooled planar positions of two runs at the sample step"


def compare_outcomes(base: Runs, head: Runs, settings: Settings, work: Work) -> Finding | Question | None:
    """W1 between runs of base and of head, beside W1 between runs of one side; None where no states were captured.

    Where all runs of each side are bit-identical, as far as positions at the sample step go, the two outcomes are
    compared as they are; otherwise whole runs are exchanged.
    """
    one, why = positions(base)
    other, why_head = positions(head)
    if one is None or other is None:
        if not any("capture" in r.configuration.phases for r in (*base, *head)):
            return None
        cubes = any(f.name == f"{GROUP}/position" for r in (*base, *head) for f in r.fields)
        return not_compared(Axis.PHYSICS, _NAME, _TITLE, why or why_head, applies=cubes or not (base and head))
    times = {r.positions.time for r in (*base, *head) if r.positions}
    if one.shape[1:] != other.shape[1:] or len(times) > 1:
        why = "other numbers of environments or cubes, or another time that is nearest to the sample time"
        return not_compared(Axis.PHYSICS, _NAME, _TITLE, why)
    try:
        found = run_to_run_variability(np.concatenate([one, other]), work.map)
    except ValueError as error:
        return not_compared(Axis.PHYSICS, _NAME, _TITLE, str(error))
    if found.matrix_cm is None:
        return not_compared(Axis.PHYSICS, _NAME, _TITLE, "so many large runs that not all distances were computed")
    n = (len(one), len(other))
    bounds = "" if found.exactness == "exact" else " (upper bounds)"
    finding = Finding(
        Axis.PHYSICS, _NAME, _TITLE, Change.SAME, unit="cm", n=n, method=f"{_METHOD}{bounds}",
        said=_apart(found.matrix_cm, n),
    )  # fmt: skip
    alike = [len({run.tobytes() for run in side}) == 1 for side in (one, other)]
    if all(alike):
        if one[0].tobytes() == other[0].tobytes():
            return replace(finding, note="the same bits in every run at the sample step")
        if min(n) > 1:
            change = Change.CHANGED if found.matrix_cm[0, -1] > settings.outcome_cm else Change.SMALL
            return replace(finding, change=change, note="all runs of a side end at the same bits")
    if min(n) < 2:
        return not_compared(Axis.PHYSICS, _NAME, _TITLE, "needs at least two complete runs on each side")
    return _Asked(found.matrix_cm, finding, settings)


@dataclass(frozen=True)
class _Asked:
    matrix_cm: NDArray[np.float64]
    finding: Finding
    settings: Settings

    @property
    def least_p(self) -> float:
        """See Question."""
        return least_p(self._head, [0] * sum(self.finding.n))

    @property
    def _head(self) -> list[bool]:
        return [False] * self.finding.n[0] + [True] * self.finding.n[1]

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question; whole runs are exchanged with any other, since no clock is in what they compute."""
        found = compare_distances(self.matrix_cm, self._head)
        how = f"all {found.n} ways" if found.exhaustive else f"{found.n - 1} ways drawn with seed {found.seed}"
        shown = replace(
            self.finding,
            change=Change.CHANGED if found.difference > self.settings.outcome_cm else Change.SMALL,
            p_value=found.p_value,
            least_p=found.least_p,
            test=f"permutation test, whole runs exchanged with any other ({how})",
            note=f"further apart than runs of one side by {found.difference:.3g} cm",
        )
        return shown, replace(shown, change=Change.UNCLEAR, left_open=() if able else (Change.CHANGED,))


def _apart(matrix: NDArray[np.float64], n: tuple[int, int]) -> tuple[str, str]:
    """Mean distance within each side, and between the two [cm]."""
    within = [_within(matrix[rows, rows]) for rows in (slice(0, n[0]), slice(n[0], None))]
    between = f"{matrix[: n[0], n[0] :].mean():.3g} apart"
    return within[0], f"{within[1]}, {between}" if within[1] else between


def _within(matrix: NDArray[np.float64]) -> str:
    runs = len(matrix)
    return f"{matrix.sum() / (runs * (runs - 1)):.3g} within" if runs > 1 else ""
