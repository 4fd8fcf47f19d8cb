"""What is counted in runs: those that did not end well, those that break a check of mechanics, and environments and
runs of other bits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gpusimbench.evaluator.compare.finding import Change, Counted, Finding, Question, judged, not_compared
from gpusimbench.evaluator.compare.matching import Pair
from gpusimbench.evaluator.missing import Missing, every, known
from gpusimbench.evaluator.report.words import trouble
from gpusimbench.evaluator.results.fidelity import CheckVerdict, Fidelity, FidelityRow, fidelity
from gpusimbench.evaluator.results.group_runs import GroupRuns, Runs
from gpusimbench.evaluator.results.identity_metrics import (
    DISTINCT_ENVS,
    DISTINCT_RUNS,
    ENDS,
    HASHED,
    HASHED_ENDS,
    comparable,
    hashed_by,
    identical,
)
from gpusimbench.evaluator.results.metric import Axis, Direction, Estimate
from gpusimbench.evaluator.results.validity import misplaced_of
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Check, Measured
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.state_hashes import ArrayHistory, Histories
from gpusimbench.evaluator.statistics.families import fisher
from gpusimbench.evaluator.statistics.regimes import upper_bound_of_none
from gpusimbench.schemas.text import bound, plural

_NAME, _TITLE = "mechanics", "checks of mechanics"

_ENVS, _RUNS = "bits of environments", "bits of runs"
_STATES = "states of head and base"
_ARRAYS = "arrays of the program"


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
    return _by_shares(finding, (bad, n1), (worse, n2), "that are not") if bad or worse else finding


def compare_misplaced(base: Runs, head: Runs) -> Finding | Question | None:
    """Runs of either side with misplaced contacts, of those that count them; None where no run has any."""
    sides = [misplaced_of(runs) for runs in (base, head)]
    if not any(side and side.n_run for side in sides):
        return None
    name, title = "misplaced_contacts", "runs with misplaced contacts"
    counts = [(side.n_run, side.of) for side in sides if side]
    if len(counts) < len(sides):
        return not_compared(Axis.VALIDITY, name, title, "one side does not count them")
    (bad, n1), (worse, n2) = counts
    finding = Finding(
        Axis.VALIDITY, name, title, Change.SAME, Direction.LOWER, base=float(bad), head=float(worse), n=(n1, n2),
        said=(f"{bad} of {n1}", f"{worse} of {n2}"), method="complete runs with a contact outside of one of its shapes",
    )  # fmt: skip
    return _by_shares(finding, (bad, n1), (worse, n2), "with any")


def _by_shares(finding: Finding, base: tuple[int, int], head: tuple[int, int], of: str) -> Finding | Counted:
    """What runs that are counted against either side say, where there are any: a fact where one side has none."""
    (bad, n1), (worse, n2) = base, head
    change = Change.REGRESSION if worse * n1 > bad * n2 else Change.IMPROVEMENT
    if bad and worse:
        return Counted(replace(finding, change=change), base, head, of=of)
    chance = fisher(base, head)
    note = f"if both sides had one probability of it, the two would be as uneven in {chance:.2g} of all cases"
    return replace(finding, change=change, note=note)


def _ended(group: Group[Run]) -> str:
    found = f"{len(group.complete)} of {len(group.recordings)}"
    return f"{found}; {said}" if (said := trouble(group)) else found


def compare_determinism(base: GroupRuns, head: GroupRuns) -> Sequence[Finding]:
    """Whether environments, and runs, are bit-identical on either side; empty where no states were hashed."""
    kinds = {timed for hashed, timed in (hashed_by(side.runs) for side in (base, head)) if hashed}
    if not kinds:
        return ()
    asked = (DISTINCT_ENVS, _ENVS), (DISTINCT_RUNS, _RUNS)
    if len(kinds) > 1:
        why = "one side captured states, and of the other only steps of the timed phase are known"
        return [not_compared(Axis.DETERMINISM, metric.name, title, why) for metric, title in asked]
    n = len(base.runs), len(head.runs)
    return [_level(title, metric.estimate(base), metric.estimate(head), n) for metric, title in asked]


def all_alike(side: GroupRuns) -> bool:
    """Whether at least two runs were compared, and all have the same bits at every step that was compared."""
    return identical(DISTINCT_RUNS.estimate(side)).yes


def compare_bits(base: Runs, head: Runs) -> Finding | None:
    """Whether head's states are base's, bit for bit, and if not, from which step on; None where none were hashed."""
    hashed, timed = hashed_by([*base, *head])
    if not hashed:
        return None
    n = (len(base), len(head))
    which = f"the {ENDS} (no states were captured)" if timed else "every captured step"
    method = f"64-bit state hashes of every environment at {which}"
    pair = _one_of_each(base, head, complete=True)
    if isinstance(pair, Missing):
        return not_compared(Axis.BITS, "states", _STATES, pair.reason)
    since = _first_apart(*pair)
    same = since is None
    differ = f"differ at step {since} of the timed phase" if timed else f"differ from step {since} on"
    if not same and min(n) < 2:
        why = (
            f"they {differ} (gsb-diff shows in which arrays), but runs of one side may differ too: "
            "needs two runs a side"
        )
        return not_compared(Axis.BITS, "states", _STATES, why)
    rows = min(len(side.steps) for side in pair)
    steps = f"{plural(rows, 'step')}{' of the timed phase' if timed else ''}"
    said = f"bit-identical at {steps}" if same else differ
    change = Change.SAME if same else Change.CHANGED
    return Finding(Axis.BITS, "states", _STATES, change, said=("", said), n=n, method=method)


def _one_of_each(base: Runs, head: Runs, *, complete: bool) -> tuple[Histories, Histories] | Missing:
    """The states of a run of each side, which stand for those of all of its runs; Missing where they do not, or cannot
    be compared.

    complete  the states of all runs must have been hashed, not those of one of each side alone
    """
    runs = [*base, *head]
    if len(set(map(comparable, runs))) > 1:
        return Missing("the scene, the seed of the actions or the layout of the states differs")
    _, timed = hashed_by(runs)
    found = [[h for r in side if (h := r.timed_histories if timed else r.histories)] for side in (base, head)]
    if not all(found) or (complete and sum(map(len, found)) < len(runs)):
        return Missing("not all runs hashed states" if timed else "not all runs captured states")
    for name, side in zip(("base", "head"), found, strict=True):
        if len({h.until(len(h.steps)) for h in side}) > 1:
            return Missing(f"runs of {name} differ from each other; {_shared(*found)}")
    one, other = found[0][0], found[1][0]
    rows = min(len(one.steps), len(other.steps))
    if not rows or not np.array_equal(one.steps[:rows], other.steps[:rows]):
        return Missing(f"different steps were {'timed' if timed else 'captured'}")
    return one, other


def _first_apart(one: Histories, other: Histories) -> int | None:
    """The first step at which states differ, of two runs that captured the same steps; None where they do not."""
    rows = min(len(one.steps), len(other.steps))
    apart = np.flatnonzero((one.digests[:rows] != other.digests[:rows]).any(axis=1))
    return int(one.steps[apart[0]]) if len(apart) else None


def apart_by_chance(before: Runs, after: Runs) -> int | None:
    """The first step at which states differ that compare_bits does not judge, because a side has a single run and
    runs of one side may differ as well; None where it judges, or where they do not differ."""
    if min(len(before), len(after)) > 1:
        return None
    pair = _one_of_each(before, after, complete=False)
    return None if isinstance(pair, Missing) else _first_apart(*pair)


def compare_arrays(base: Runs, head: Runs) -> Finding | None:
    """Whether the arrays that a program hashed are the same, and if not, which differ first; None without any."""
    runs = [*base, *head]
    if not any(r.arrays for r in runs):
        return None
    n = (len(base), len(head))
    if not all(n) or len({frozenset(r.arrays) for r in runs}) > 1:
        return not_compared(Axis.BITS, "arrays", _ARRAYS, "not all runs hashed arrays of the same names")
    for name, side in zip(("base", "head"), (base, head), strict=True):
        if any(found := [_first_other(side[0].arrays, run.arrays) for run in side[1:]]):
            why = f"runs of {name} differ from each other: {next(filter(None, found))}"
            return not_compared(Axis.BITS, "arrays", _ARRAYS, why)
    first = _first_other(base[0].arrays, head[0].arrays)
    if first and min(n) < 2:
        why = f"{first}, but runs of one side may differ too: needs two runs a side"
        return not_compared(Axis.BITS, "arrays", _ARRAYS, why)
    counts = (f"{name} ({len(history.digests)})" for name, history in sorted(base[0].arrays.items()))
    said = first or f"bit-identical in all updates: {', '.join(counts)}"
    change = Change.CHANGED if first else Change.SAME
    method = "64-bit hashes of every array at every update"
    return Finding(Axis.BITS, "arrays", _ARRAYS, change, said=("", said), n=n, method=method)


def _first_other(one: Mapping[str, ArrayHistory], other: Mapping[str, ArrayHistory]) -> str:
    """The update that differs first, in words; empty where none does."""
    found = []
    for name, a in one.items():
        b = other[name]
        common = min(len(a.digests), len(b.digests))
        apart = np.flatnonzero((a.digests[:common] != b.digests[:common]).any(axis=1))
        if len(apart) or len(a.digests) != len(b.digests):
            update = int(apart[0]) if len(apart) else common
            longer = a if len(a.digests) > update else b
            found.append(
                (int(longer.states[update]), int(longer.order[update]), f"{name} differs from update {update} on")
            )
    return min(found)[2] if found else ""


def _shared(one: Sequence[Histories], other: Sequence[Histories]) -> str:
    rows = min(len(h.steps) for h in (*one, *other))
    common = {h.until(rows) for h in one} & {h.until(rows) for h in other}
    return f"{len(common)} of their histories {'is' if len(common) == 1 else 'are'} on both sides"


def _level(title: str, one: Estimate, other: Estimate, n: tuple[int, int]) -> Finding:
    axis, name = Axis.DETERMINISM, one.name
    claims = [identical(metric) for metric in (one, other)]
    if unknown := [claim for claim in claims if claim.holds is None]:
        # environments that differ by design, on either side, leave nothing to decide; too few runs do
        designed = name == "distinct_envs" and len(unknown) == len(claims) and min(n) > 0
        return not_compared(axis, name, title, every(unknown).why_not, applies=not designed)
    alike, stays = (claim.yes for claim in claims)
    change = judged(Direction.LOWER, rises=alike) if alike != stays else Change.SAME
    return Finding(
        axis, name, title, change, Direction.LOWER, said=(_distinct(one), _distinct(other)),
        base=known(one.value), head=known(other.value), n=n,
        method=HASHED_ENDS if HASHED_ENDS in one.method else HASHED,
        note=_bound(name, one if alike else other, change),
    )  # fmt: skip


def _bound(name: str, alike: Estimate, change: Change) -> str:
    if name != "distinct_runs" or change is Change.SAME:
        return ""
    below = bound(upper_bound_of_none(alike.n - 1))
    return (
        f"{alike.n} bit-identical runs: another one differs in some bit with a probability below {below} "
        "(95 % confidence)"
    )


def _distinct(metric: Estimate) -> str:
    count = int(known(metric.value) or 0)
    return f"identical, all {metric.n}" if count == 1 else f"{count} of {metric.n} distinct"
