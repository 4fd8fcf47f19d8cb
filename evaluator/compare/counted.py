"""What is counted in runs: those that did not end well, and those that break a check of mechanics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gpusimbench.evaluator.compare.finding import Change, Counted, Finding, Question, not_compared
from gpusimbench.evaluator.compare.matching import Pair
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.report.words import trouble
from gpusimbench.evaluator.results.fidelity import CheckVerdict, Fidelity, FidelityRow, fidelity
from gpusimbench.evaluator.results.group_runs import Runs
from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Check, Measured
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.families import fisher
from gpusimbench.schemas.text import plural

_NAME, _TITLE = "mechanics", "checks of mechanics"


def compare_mechanics(base: Runs, head: Runs, *, certain: bool) -> Sequence[Finding | Question]:
    """A finding for each check that could have changed, and one for all where none could; empty without states.

    certain  all runs of a side are bit-identical, so that one speaks for all, and a check has changed where its verdict
             has; otherwise it is counted in how many runs a check is broken, and tested whether that is another share
    """
    if not any("capture" in r.configuration.phases for r in (*base, *head)):
        return ()
    one, other = (fidelity("", [r.physics for r in runs]) for runs in (base, head))
    if why := "; ".join(dict.fromkeys(f.checks_missing for f in (one, other) if f.checks_missing)):
        applies = not (base and head and one.checks_missing and other.checks_missing)
        return (not_compared(Axis.PHYSICS, _NAME, _TITLE, why, applies=applies),)
    rows = {row.check: row for row in other.rows}
    both = [(row, rows[row.check]) for row in one.rows if row.check.demanded and row.check in rows]
    none = CheckVerdict.NOT_APPLICABLE
    judged = [pair for pair in both if all(row.verdict is not none for row in pair)]
    if not judged:
        either = any(row.check.demanded and row.verdict is not none for row in (*one.rows, *other.rows))
        return (not_compared(Axis.PHYSICS, _NAME, _TITLE, "no check applies to both sides", applies=either),)
    found = [_checked(a, b, base, head, certain=certain) for a, b in judged]
    return [one for one in found if one is not None] or (_unchanged(one, other, (len(base), len(head))),)


def _unchanged(one: Fidelity, other: Fidelity, n: tuple[int, int]) -> Finding:
    held = [f"{f.held} of {f.checkable} held, {f.not_checkable} not checkable" for f in (one, other)]
    method = f"verdicts of the checks that apply to both sides, by {one.revision.value}, as gsb-eval --all prints them"
    return Finding(
        Axis.PHYSICS, _NAME, _TITLE, Change.SAME, Direction.HIGHER, said=(held[0], held[1]), n=n, method=method
    )  # fmt: skip


def _checked(
    one: FidelityRow, other: FidelityRow, base: Runs, head: Runs, *, certain: bool
) -> Finding | Question | None:
    """The finding or the question of a check; None where it could not have changed.

    Which tests are made must not depend on how broken runs fell to the sides, or their p-values mean nothing: a check
    that only some runs of all break is asked, also where both sides have such runs.
    """
    counts = (bad, n1), (worse, n2) = _broken(one.check, base), _broken(one.check, head)
    if (one.verdict is other.verdict) if certain else (bad + worse in (0, n1 + n2)):
        return None
    finding = Finding(
        Axis.PHYSICS, f"mechanics.{one.check.key}", one.check.title,
        Change.REGRESSION if worse * n1 > bad * n2 else Change.IMPROVEMENT, Direction.HIGHER,
        said=(_verdict(one), _verdict(other)), n=(n1, n2),
        method=f"verdict of gsb-eval --all over all runs, by {NEWEST.value}",
        note=f"broken in {bad} of {plural(n1, 'run')} of base, {worse} of {n2} of head",
    )  # fmt: skip
    return finding if certain else Counted(finding, *counts, of="in which it is broken")


def _verdict(row: FidelityRow) -> str:
    broken = row.found if row.verdict is CheckVerdict.BROKEN else None
    said = f"BROKEN {broken.broken} of {broken.count}" if broken else row.verdict.value
    return f"{said} ({NEWEST.value})"


def _broken(check: Check, runs: Runs) -> tuple[int, int]:
    """In how many runs a check is broken, of how many that were measured."""
    found = [run.physics.facts.get(check) for run in runs if not isinstance(run.physics.facts, Missing)]
    facts = [fact for fact in found if isinstance(fact, Measured)]
    return sum(fact.broken > 0 for fact in facts), len(facts)


def compare_validity(pair: Pair) -> Finding | Question:
    """Complete runs of either side.

    A side without any other is told apart from one with some as a fact; two sides with some, by their shares.
    """
    counts = [(len(g.recordings) - len(g.complete), len(g.recordings)) for g in (pair.base, pair.head)]
    (bad, n1), (worse, n2) = counts
    finding = Finding(
        Axis.VALIDITY, "complete_runs", "complete runs", Change.SAME, Direction.HIGHER,
        base=float(n1 - bad), head=float(n2 - worse), n=(n1, n2), said=(_ended(pair.base), _ended(pair.head)),
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


def _ended(group: Group[Run]) -> str:
    found = f"{len(group.complete)} of {len(group.recordings)}"
    return f"{found}; {said}" if (said := trouble(group)) else found
