"""Bits: whether environments and runs are as identical as they were, and whether head's states are base's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gpusimbench.evaluator.compare.finding import Change, Finding, judged, not_compared
from gpusimbench.evaluator.missing import Missing, every, known
from gpusimbench.evaluator.results.group_runs import GroupRuns, Runs
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_ENVS, DISTINCT_RUNS, comparable, identical
from gpusimbench.evaluator.results.metric import Axis, Direction, Estimate
from gpusimbench.evaluator.runs.state_hashes import ArrayHistory, Histories
from gpusimbench.evaluator.statistics.regimes import upper_bound_of_none
from gpusimbench.schemas.text import bound, plural

_ENVS, _RUNS = "bits of environments", "bits of runs"
_STATES = "states of head and base"
_ARRAYS = "arrays of the program"


def compare_determinism(base: GroupRuns, head: GroupRuns) -> Sequence[Finding]:
    """Whether environments, and runs, are bit-identical on either side; empty where no states were captured."""
    if not any(r.histories for r in (*base.runs, *head.runs)):
        return ()
    n = len(base.runs), len(head.runs)
    return [
        _level(title, metric.estimate(base), metric.estimate(head), n)
        for metric, title in ((DISTINCT_ENVS, _ENVS), (DISTINCT_RUNS, _RUNS))
    ]


def all_alike(side: GroupRuns) -> bool:
    """Whether at least two runs were compared, and all have the same bits at every captured step."""
    return identical(DISTINCT_RUNS.estimate(side)).yes


def compare_bits(base: Runs, head: Runs) -> Finding | None:
    """Whether head's states are base's, bit for bit, and if not, from which step on; None where none were captured."""
    if not any(r.histories for r in (*base, *head)):
        return None
    n = (len(base), len(head))
    method = "64-bit state hashes of every environment at every captured step"
    pair = _one_of_each(base, head, complete=True)
    if isinstance(pair, Missing):
        return not_compared(Axis.BITS, "states", _STATES, pair.reason)
    since = _first_apart(*pair)
    same = since is None
    if not same and min(n) < 2:
        why = (
            f"they differ from step {since} on (gsb-diff shows in which arrays), but runs of one side may differ too: "
            "needs two runs a side"
        )
        return not_compared(Axis.BITS, "states", _STATES, why)
    rows = min(len(side.steps) for side in pair)
    said = f"bit-identical at {plural(rows, 'step')}" if same else f"differ from step {since} on"
    change = Change.SAME if same else Change.CHANGED
    return Finding(Axis.BITS, "states", _STATES, change, said=("", said), n=n, method=method)


def _one_of_each(base: Runs, head: Runs, *, complete: bool) -> tuple[Histories, Histories] | Missing:
    """The states of a run of each side, which stand for those of all of its runs; Missing where they do not, or cannot
    be compared.

    complete  all runs must have captured states, not one of each side alone
    """
    runs = [*base, *head]
    if len(set(map(comparable, runs))) > 1:
        return Missing("the scene, the seed of the actions or the layout of the states differs")
    found = [[r.histories for r in side if r.histories] for side in (base, head)]
    if not all(found) or (complete and sum(map(len, found)) < len(runs)):
        return Missing("not all runs captured states")
    for name, side in zip(("base", "head"), found, strict=True):
        if len({h.until(len(h.steps)) for h in side}) > 1:
            return Missing(f"runs of {name} differ from each other; {_shared(*found)}")
    one, other = found[0][0], found[1][0]
    rows = min(len(one.steps), len(other.steps))
    if not rows or not np.array_equal(one.steps[:rows], other.steps[:rows]):
        return Missing("different steps were captured")
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
        base=known(one.value), head=known(other.value), n=n, method="64-bit state hashes of every captured step",
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
