"""Runs that did not end well, and whether there are more of them."""

from __future__ import annotations

from dataclasses import replace

from gpusimbench.evaluator.compare.finding import Change, Counted, Finding, Question
from gpusimbench.evaluator.compare.matching import Pair
from gpusimbench.evaluator.report.words import trouble
from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.families import fisher


def compare_validity(pair: Pair) -> Finding | Question:
    """Complete runs of either side.

    A side without any other is told apart from one with some as a fact; two sides with some, by their shares.
    """
    counts = [(len(g.recordings) - len(g.complete), len(g.recordings)) for g in (pair.base, pair.head)]
    (bad, n1), (worse, n2) = counts
    finding = Finding(
        Axis.VALIDITY, "complete_runs", "complete runs", Change.SAME, Direction.HIGHER,
        base=float(n1 - bad), head=float(n2 - worse), n=(n1, n2), said=(_said(pair.base), _said(pair.head)),
        method="runs that ended well and lost no data",
    )  # fmt: skip
    if bad and worse:
        change = Change.REGRESSION if worse / n2 > bad / n1 else Change.IMPROVEMENT
        return Counted(replace(finding, change=change), (bad, n1), (worse, n2), of="that are not")
    if not bad and not worse:
        return finding
    chance = fisher((bad, n1), (worse, n2))
    return replace(
        finding,
        change=Change.REGRESSION if worse else Change.IMPROVEMENT,
        note=f"if both sides failed with one probability, failures would be as uneven in {chance:.2g} of all cases",
    )


def _said(group: Group[Run]) -> str:
    found = f"{len(group.complete)} of {len(group.recordings)}"
    return f"{found}; {said}" if (said := trouble(group)) else found
