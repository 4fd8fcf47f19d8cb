"""Which group of base is compared with which of head: what was asked for the same, but for the seeds of tasks."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain
from typing import Any

from gpusimbench.evaluator.compare.finding import FAILING, Change, Finding, not_compared
from gpusimbench.evaluator.episodes.clusters import seed_of
from gpusimbench.evaluator.results.group_runs import Runs
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.runs.groups import Group, GroupKey, asked
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.configuration import TELLING
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import cut, did_you_mean, few, first, plural
from gpusimbench.schemas.vector import NO_SEED, RESET_KEYS, RESET_SEEDS

ACROSS = ("simulator", "scene", "determinism", "n_env", "dt", "warmup", "timed_steps")
"""What --across takes besides names of options."""

_SHOWN, _LENGTH, _NEAR, _HASH = 12, 48, 4, 12

Groups = Sequence[Group[Run]]


@dataclass(frozen=True)
class Pair:
    """A group of base and one of head that were asked for the same.

    label         unique among the pairs
    differs       what they differ in, each as "name: value -> value"
    same_machine  whether CPU and GPUs are the same by name
    """

    label: str
    base: Group[Run]
    head: Group[Run]
    differs: tuple[str, ...]
    same_machine: bool


@dataclass(frozen=True)
class Matching:
    """Pairs, and what has no partner: side, label, reason."""

    pairs: tuple[Pair, ...]
    alone: tuple[tuple[str, str, str], ...]


def match(base: Groups, head: Groups, across: Collection[str] = ()) -> Matching:
    """Pair the groups of two sets.

    Those of equal keys first. Then those that were asked for the same on machines of one kind: versions, packages,
    drivers, environment variables and options that nobody asked for may differ, since they are what is compared. Then
    those on other machines. A group for which several could be the partner has none. Seeds of tasks may differ.

    across  names of options, or of ACROSS, that may differ too, in pairs of what is left where they do not
    """
    left, right = list(base), list(head)
    found: list[tuple[Group[Run], Group[Run]]] = []
    rules: list[Callable[[Group[Run]], GroupKey]] = [lambda g: g.key]
    rules += [partial(of, across=names) for of in (asked_of, anywhere) for names in ((), across)]
    for rule in rules:
        found += _unique(left, right, rule, across)
    found.sort(key=lambda pair: list(base).index(pair[0]))
    given = options_given(r for g in (*base, *head) for r in g.recordings)
    names = labels([one.key for one, _ in found], given)
    pairs = tuple(
        Pair(name, one, other, _differences(one, other), machine(one) == machine(other))
        for name, (one, other) in zip(names, found, strict=True)
    )
    alone = [
        (side, f"{label}, {group.key.scene}, {plural(group.key.n_env, 'env')}", _why(group, others, across))
        for side, groups, rest, others in (("base", base, left, head), ("head", head, right, base))
        for group, label in zip(groups, labels([g.key for g in groups], given), strict=True)
        if group in rest
    ]
    return Matching(pairs, tuple(alone))


def check_across(across: Collection[str], groups: Groups) -> None:
    """UsageError where --across names nothing that any recording was asked for."""
    known = {name for g in groups for r in g.recordings for name in r.configuration.options} | set(ACROSS)
    for name in across:
        if name not in known:
            takes = f"an option that a run was given or {', '.join(ACROSS)}"
            raise UsageError(f"--across takes {takes}, not '{name}'{did_you_mean(name, known)}")


def _unique(
    left: list[Group[Run]],
    right: list[Group[Run]],
    rule: Callable[[Group[Run]], GroupKey],
    across: Collection[str],
) -> list[tuple[Group[Run], Group[Run]]]:
    """Take those out of both lists whose key no other has."""
    alike: dict[GroupKey, tuple[list[Group[Run]], list[Group[Run]]]] = {}
    for side, groups in enumerate((left, right)):
        for group in groups:
            alike.setdefault(without_seeds(rule(group), group), ([], []))[side].append(group)
    found = [(a[0], b[0]) for a, b in alike.values() if len(a) == len(b) == 1 and _one_scene(a[0], b[0], across)]
    for group, other in found:
        left.remove(group)
        right.remove(other)
    return found


def asked_of(group: Group[Run], across: Collection[str] = ()) -> GroupKey:
    """What its runs were asked for, all of them the same, and the machine; without what follows from a version."""
    key = asked(group.recordings[0])
    plain: dict[str, Any] = {"conditions": ""}
    options = {name: value for name, value in key.parsed_options.items() if name not in across}
    plain["options"] = json.dumps(options, sort_keys=True)
    for name in ACROSS:
        if name in across:
            plain[name] = type(getattr(key, name))()
    return replace(key, **plain)


def anywhere(group: Group[Run], across: Collection[str] = ()) -> GroupKey:
    """As `asked_of`, on whatever machine."""
    return replace(asked_of(group, across), device="")


def machine(group: Group[Run]) -> str:
    """CPU, its usable threads and GPUs by name, as JSON."""
    return asked(group.recordings[0]).device


def _one_scene(one: Group[Run], other: Group[Run], across: Collection[str]) -> bool:
    if "scene" in across:
        return True
    hashes = {one.key.scene_hash, other.key.scene_hash} - {""}
    return len(hashes) < 2


def _why(group: Group[Run], others: Groups, across: Collection[str]) -> str:
    wanted = without_seeds(anywhere(group, across), group)
    alike = [g for g in others if without_seeds(anywhere(g, across), g) == wanted]
    if not alike:
        said = "the other side has no group of the same configuration"
        nearest = min((_apart(wanted, without_seeds(anywhere(g, across), g)) for g in others), key=len, default={})
        if not nearest:
            return said
        keys = {*(field.name for field in fields(GroupKey)), *TELLING}
        further = [name for name in nearest if name in ACROSS or name not in keys]
        needed = " ".join(f"--across {name}" for name in [*across, *further])
        how = f"; {needed} compares the two" if len(further) == len(nearest) else ""
        return f"{said}; the most similar group differs in {few(list(nearest.values()), _NEAR)}{how}"
    if not any(_one_scene(group, g, across) for g in alike):
        return "the description of the scene differs on the other side; --across scene compares the two"
    return "several groups were asked for the same, in different versions or conditions: compare them one at a time"


def _apart(one: GroupKey, other: GroupKey) -> dict[str, str]:
    """In what two groups were asked for something else: by name, "name: value -> value"."""
    found: dict[str, str] = {}
    for field in fields(GroupKey):
        here, there = getattr(one, field.name), getattr(other, field.name)
        if field.name == "options":
            of_one, of_other = json.loads(here or "{}"), json.loads(there or "{}")
            found |= {name: _arrow(name, *values) for name, values in _unequal(of_one, of_other).items()}
        elif field.name == "settings":
            found |= {name: _arrow(name, *values) for name, values in _unequal(one.told, other.told).items()}
        elif here != there:
            found[field.name] = _arrow(field.name, here, there)
    return found


def _differences(base: Group[Run], head: Group[Run]) -> tuple[str, ...]:
    found: list[str] = []
    keys = (base.key, head.key)
    if any(len(set(map(seed_of, side.recordings))) > 1 for side in (base, head)):
        keys = (without_seeds(base.key, base), without_seeds(head.key, head))  # a key has one seed; a note counts all
    for field in fields(GroupKey):
        one, other = (getattr(key, field.name) for key in keys)
        if one == other or "" in (base.key.version, head.key.version):
            continue  # of a run that was never built, nothing is known but what was asked
        if field.name in ("options", "switches", "conditions"):
            found += _entries(json.loads(one or "{}"), json.loads(other or "{}"))
        elif field.name == "settings":
            found += _entries(*(key.told for key in keys))
        elif field.name == "layout" and base.key.precisions != head.key.precisions:
            found.append(_arrow("precision", *(" and ".join(side.key.precisions) for side in (base, head))))
        elif field.name in ("layout", "origins"):
            found.append(f"{field.name} of the states")
        elif field.name == "scene_hash":
            found.append(_arrow("description of the scene, sha256", one[:_HASH], other[:_HASH]))
        else:
            found.append(_arrow(field.name, one, other))
    one, other = _commits(base), _commits(head)
    if one != other:
        found.append(_arrow("commit of the recorder", one, other))
    return tuple(first(found, _SHOWN))


def _entries(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    return [_arrow(name, *values) for name, values in _unequal(one, other).items()]


def _unequal(one: dict[str, Any], other: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = sorted({*one, *other})
    return {n: (one.get(n, "unset"), other.get(n, "unset")) for n in names if one.get(n) != other.get(n)}


def _commits(group: Group[Run]) -> str:
    recorders = [r.provenance.software.get("recorder") for r in group.recordings]
    commits = {
        str(r.get("commit") or "")[:12] + ("+" if r.get("modified") else "") for r in recorders if isinstance(r, dict)
    }
    return ", ".join(sorted(commits)[:3]) or "unknown"


def _arrow(name: str, one: Any, other: Any) -> str:
    return f"{_short(name)}: {_short(one)} -> {_short(other)}"


def _short(value: Any) -> str:
    return cut(" ".join(str(value).split()) or "none", _LENGTH)


def pooled(groups: Sequence[Group[Run]]) -> list[Group[Run]]:
    """Groups of a task that differ in nothing but seeds as one, in the order of the seeds; others as they are."""
    found = gathered((without_seeds(group.key, group), group) for group in groups)
    return [_joined(alike) for alike in found.values()]


def without_seeds(key: GroupKey, group: Group[Run]) -> GroupKey:
    """A key of the group, of tasks without what seeds decide."""
    if not any(field.group == ENV for run in group.recordings for field in run.fields):
        return key
    options = {name: value for name, value in key.parsed_options.items() if name not in (RESET_SEEDS, RESET_KEYS)}
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
    by_name = gathered((one.name, one) for one in chain.from_iterable(of_seed))
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
