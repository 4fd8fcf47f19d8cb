"""Seeds of tasks: of a policy they are repetitions, so that runs which differ in nothing else are one configuration."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain

from gpusimbench.evaluator.compare.finding import FAILING, Change, Finding, not_compared
from gpusimbench.evaluator.episodes.clusters import seed_of
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.runs.groups import Group, GroupKey
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.vector import NO_SEED, RESET_KEYS, RESET_SEEDS


def pooled(groups: Sequence[Group[Run]]) -> list[Group[Run]]:
    """Groups of a task that differ in nothing but seeds as one, in the order of the seeds; others as they are."""
    found: dict[GroupKey, list[Group[Run]]] = {}
    for group in groups:
        found.setdefault(without_seeds(group.key, group), []).append(group)
    return [_joined(alike) for alike in found.values()]


def without_seeds(key: GroupKey, group: Group[Run]) -> GroupKey:
    """A key of the group, of tasks without what seeds decide."""
    if not any(field.group == ENV for run in group.recordings for field in run.fields):
        return key
    asked = json.loads(key.options or "{}")
    options = {name: value for name, value in asked.items() if name not in (RESET_SEEDS, RESET_KEYS)}
    return replace(key, seed=0, options=json.dumps(options, sort_keys=True))


def seeds_said(base: Runs, head: Runs) -> list[str]:
    """How many seeds either side has, in a note; empty where neither has several."""
    n, m = (len(set(map(seed_of, runs))) for runs in (base, head))
    shared = len({*map(seed_of, base)} & {*map(seed_of, head)})
    said = f"{plural(n, 'seed')} of base and {m} of head, {shared} on both sides, are one sample"
    if any(run.configuration.options.get(RESET_SEEDS) == NO_SEED for run in (*base, *head)):
        said += "; each run without a seed counts as another seed"
    return [said] if max(n, m) > 1 else []


def seed_by_seed(
    base: Runs, head: Runs, compared: Callable[[Runs, Runs], Sequence[Finding]], axis: Axis
) -> Sequence[Finding]:
    """Findings that hold for runs of one seed: of the seed in which most is wrong, where there are several.

    compared  the findings of runs of base and of head with one seed, of the same names for every seed
    """
    seeds = [dict.fromkeys(map(seed_of, runs)) for runs in (base, head)]
    if max(map(len, seeds)) < 2:
        return compared(base, head)
    of_seed = [
        compared(*(tuple(run for run in runs if seed_of(run) == seed) for runs in (base, head)))
        for seed in seeds[0]
        if seed in seeds[1]
    ]
    if not of_seed:
        return [
            not_compared(axis, one.name, one.title, "base and head have no seed in common", applies=one.applies)
            for one in compared(base, head)
        ]
    by_name: dict[str, list[Finding]] = {}
    for one in chain.from_iterable(of_seed):
        by_name.setdefault(one.name, []).append(one)
    return [_worst(findings) for findings in by_name.values()]


def _worst(findings: Sequence[Finding]) -> Finding:
    worst = min(findings, key=lambda one: (one.change not in FAILING, one.change is not Change.NOT_COMPARED))
    where = f"in the worst of {len(findings)} seeds" if len(findings) > 1 else "in the only seed of both sides"
    return replace(worst, note="; ".join(filter(None, (worst.note, where))))


def _joined(groups: Sequence[Group[Run]]) -> Group[Run]:
    if len(groups) == 1:
        return groups[0]
    ordered = sorted(groups, key=lambda group: (group.key.seed, group.key.options))
    return Group(ordered[0].key, tuple(run for group in ordered for run in group.recordings))
