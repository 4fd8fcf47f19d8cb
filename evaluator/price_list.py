"""What determinism costs: groups that differ in its level and switches alone, each against the one at the default."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

from evaluator.groups import GroupKey, asked
from evaluator.results import GroupResult, Metric
from evaluator.soundness import faults
from evaluator.statistics.ratio import ratio_of_means

DEFAULT = "default"
"""The level that an engine has where nobody asks for another."""


@dataclass(frozen=True)
class Cost:
    """One figure of a group over that of the default.

    ratio        None where there is none, and `why_not` says why
    ci95         95 % interval of the ratio; None where there is none, and `no_interval` says why
    """

    ratio: float | None
    ci95: tuple[float, float] | None = None
    why_not: str = ""
    no_interval: str = ""


@dataclass(frozen=True)
class Price:
    """One group of a family.

    result  of the group
    level   of determinism that was asked for
    differs what else is in force and is not so in the default: "name=value", of switches and environment variables
    speed   throughput over that of the default
    memory  memory increment over that of the default: of the device, or of the host where there is no device
    """

    result: GroupResult
    level: str
    differs: tuple[str, ...]
    speed: Cost
    memory: Cost


@dataclass(frozen=True)
class Family:
    """Groups that were asked for the same but for determinism.

    base    the group at the default level; None where there is none
    prices  of the others, in the order of their labels
    """

    base: GroupResult | None
    prices: tuple[Price, ...]


def price_list(results: Sequence[GroupResult]) -> tuple[Family, ...]:
    """The families among some groups that have more than one level or set of switches, in their order.

    A level may act through environment variables, so those may differ; machine, scene, protocol, options given, driver
    and versions of packages may not. A run that ended before its simulator was built belongs to the family that was
    asked for the same.
    """
    members: dict[GroupKey, list[GroupResult]] = {}
    for result in results:
        members.setdefault(_family_key(result), []).append(result)
    return tuple(_family(found) for found in members.values() if len(found) > 1)


def _family_key(result: GroupResult) -> GroupKey:
    variables = _environment(result)
    conditions = {n: v for n, v in json.loads(result.group.key.conditions).items() if n not in variables}
    return replace(asked(result.group.recordings[0]), determinism="", conditions=json.dumps(conditions))


def _environment(result: GroupResult) -> dict[str, object]:
    # the variables among what can change numbers
    conditions = json.loads(result.group.key.conditions)
    return {n: v for n, v in result.group.recordings[0].provenance.environment.items() if n in conditions}


def _family(found: Sequence[GroupResult]) -> Family:
    defaults = [r for r in found if r.group.key.determinism == DEFAULT]
    # of several, the one with the fewest variables that could act on determinism
    base = min(defaults, key=lambda r: len(_environment(r)), default=None)
    others = sorted((r for r in found if r is not base), key=lambda r: r.label)
    return Family(base, tuple(_price(r, base) for r in others))


def _price(result: GroupResult, base: GroupResult | None) -> Price:
    memory = "memory_peak_increment"
    if result.metrics[memory].value is None and result.metrics["host_memory_peak_increment"].value is not None:
        memory = "host_memory_peak_increment"
    return Price(
        result,
        result.group.key.determinism,
        _differs(result, base),
        _cost(result, base, "fps"),
        _cost(result, base, memory),
    )


def _differs(result: GroupResult, base: GroupResult | None) -> tuple[str, ...]:
    if base is None or not (result.group.key.version and base.group.key.version):
        return ()
    changed = _changed(_switches(result), _switches(base))
    # a switch that is set by a variable is told once
    told = set(changed.values())
    variables = {n: v for n, v in _changed(_environment(result), _environment(base)).items() if v not in told}
    return tuple(f"{name}={value}" for name, value in sorted({**variables, **changed}.items()))


def _switches(result: GroupResult) -> dict[str, object]:
    found: dict[str, object] = json.loads(result.group.key.switches or "{}")
    return found


def _changed(own: dict[str, object], others: dict[str, object]) -> dict[str, str]:
    names = [name for name in {**own, **others} if own.get(name) != others.get(name)]
    return {name: str(own.get(name, "unset")) for name in names}


def _cost(result: GroupResult, base: GroupResult | None, name: str) -> Cost:
    if base is None:
        return Cost(None, why_not="no group of the same configuration ran at the default level")
    for side, which in ((result, ""), (base, "the default: ")):
        if invalid := faults(side).invalid:
            return Cost(None, why_not=f"{which}{invalid}, so it has no price")
    ours, theirs = result.metrics[name], base.metrics[name]
    for metric, which in ((ours, ""), (theirs, "the default: ")):
        if metric.value is None:
            return Cost(None, why_not=f"{which}{_why_not(result if metric is ours else base, metric)}")
    try:
        found = ratio_of_means(ours.extra["per_run"], theirs.extra["per_run"])
    except ValueError as error:
        return Cost(None, why_not=str(error))
    if found.low is None or found.high is None:
        return Cost(found.estimate, no_interval=found.reason or "")
    return Cost(found.estimate, (found.low, found.high))


def _why_not(result: GroupResult, metric: Metric) -> str:
    endings = dict.fromkeys(f"{r.cause or r.status}: {r.reason}" for r in result.group.recordings if not r.usable)
    return "; ".join(endings) if endings and not result.group.complete else metric.why_not
