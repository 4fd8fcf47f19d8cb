"""What determinism costs: groups that differ in its level and what the level sets, each against one at the default."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.results.cost_metrics import common_memory
from gpusimbench.evaluator.results.details import OverRuns
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey, asked
from gpusimbench.evaluator.statistics.jackknife import ratio_of_means

DEFAULT = "default"
"""The level that an engine has where nobody asks for another."""

NO_EFFECT = "no effect here: the level sets nothing on this device"
"""Why a level has no price."""


@dataclass(frozen=True)
class Cost:
    """One figure of a group over that of the default.

    ratio  or why there is none
    ci95   95 % interval of the ratio, or why there is none; None where there is no ratio
    """

    ratio: float | Missing
    ci95: tuple[float, float] | Missing | None = None

    @property
    def undecided(self) -> bool:
        """Whether the interval contains 1: the figure cannot be told apart from that of the default."""
        return bool(self.ci95 and self.ci95[0] <= 1.0 <= self.ci95[1])


@dataclass(frozen=True)
class Price:
    """One group of a family.

    result  of the group
    level   of determinism that was asked for
    differs what the level sets that is not so in the default: "name=value", of switches and environment variables
    speed   throughput over that of the default
    memory  memory over that of the default, both by one source: see cost_metrics.common_memory
    """

    result: GroupResult
    level: str
    differs: tuple[str, ...]
    speed: Cost
    memory: Cost


@dataclass(frozen=True)
class Family:
    """Groups of one configuration that differ in the level of determinism and in what the level sets.

    base    the group at the default level; None where there is none
    prices  of the others, in the order of their labels; none of them is at the default level
    """

    base: GroupResult | None
    prices: tuple[Price, ...]


def price_list(results: Sequence[GroupResult]) -> tuple[Family, ...]:
    """The families among some groups that have more than one level, in their order.

    Groups of a family are equal in what was asked for, machine, driver, versions, scene, fields and precision of the
    states, origins, protocol and options in force. What a level sets are switches; an option or an environment variable
    belongs to the level as far as a switch repeats it, and else is somebody's own choice. A run that ended before its
    simulator was built belongs to the first family that was asked for the same.
    """
    built: dict[GroupKey, GroupKey] = {}
    for result in results:
        if result.group.key.version:
            built.setdefault(_key_but_level(result), _configuration(result))
    members: dict[GroupKey, list[GroupResult]] = {}
    for result in results:
        own = _configuration(result)
        key = own if result.group.key.version else built.get(_key_but_level(result), own)
        members.setdefault(key, []).append(result)
    return tuple(family for found in members.values() for family in _families(found))


def _families(found: Sequence[GroupResult]) -> list[Family]:
    """One for each group at the default level that others are levels of, and one of what has no default."""
    defaults = [r for r in found if r.group.key.determinism == DEFAULT]
    levels = sorted((r for r in found if r.group.key.determinism != DEFAULT), key=lambda r: r.label)
    bases = [_base_of(level, defaults) for level in levels]
    families = [
        Family(base, tuple(_price(r, base) for r, of in zip(levels, bases, strict=True) if of is base))
        for base in (*defaults, None)
    ]
    return [one for one in families if len(one.prices) + (one.base is not None) > 1]


def _base_of(level: GroupResult, defaults: Sequence[GroupResult]) -> GroupResult | None:
    """The default that differs least from a level; None where each differs in what is no part of a level."""
    if not level.group.key.version:
        return next(iter(defaults), None)
    able = [d for d in defaults if not (d.group.key.version and _foreign(level, d))]
    # a default that was never built says nothing, and comes last
    return min(able, key=lambda d: (not d.group.key.version, len(_differs(level, d))), default=None)


def _key_but_level(result: GroupResult) -> GroupKey:
    conditions = {n: v for n, v in _conditions(result).items() if n not in _environment(result)}
    return replace(asked(result.group.recordings[0]), determinism="", conditions=json.dumps(conditions))


def _configuration(result: GroupResult) -> GroupKey:
    key = result.group.key
    return replace(
        _key_but_level(result), version=key.version, device=key.device, scene_hash=key.scene_hash, layout=key.layout,
        origins=key.origins, switches=json.dumps(_precision(result), sort_keys=True),
    )  # fmt: skip


def _conditions(result: GroupResult) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(result.group.key.conditions)
    return found


def _environment(result: GroupResult) -> dict[str, Any]:
    # the variables among what can change numbers
    conditions = _conditions(result)
    return {n: v for n, v in result.group.recordings[0].provenance.environment.items() if n in conditions}


def _switches(result: GroupResult) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(result.group.key.switches or "{}")
    return found


def _precision(result: GroupResult) -> dict[str, Any]:
    # how numbers are held and multiplied is no level of determinism
    return {name: value for name, value in _switches(result).items() if "precision" in name}


def _price(result: GroupResult, base: GroupResult | None) -> Price:
    memory = common_memory([r.metrics for r in (result, base) if r])
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


def _changed(own: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, str]:
    names = [name for name in {**own, **others} if own.get(name) != others.get(name)]
    return {name: str(own.get(name, "unset")) for name in names}


def _foreign(result: GroupResult, base: GroupResult) -> list[str]:
    """Options and environment variables that differ and are no part of the level: no differing switch repeats them."""
    own, others = _switches(result), _switches(base)
    said, named = _words(own, others), _changed(own, others)
    options = _changed(result.group.key.parsed_options, base.group.key.parsed_options)
    variables = _changed(_environment(result), _environment(base))
    foreign = [n for n in variables if not _words(_environment(result), _environment(base), n) <= said]
    return [*(name for name in options if name not in named), *foreign]


def _words(own: Mapping[str, Any], others: Mapping[str, Any], *names: str) -> set[str]:
    """The words of some values, or of all, that only one of two has."""
    found: set[str] = set()
    for name in names or {**own, **others}:
        one, other = (set(str(side.get(name, "")).split()) for side in (own, others))
        found |= one ^ other
    return found


def _without_effect(result: GroupResult, base: GroupResult) -> bool:
    """Whether a level sets nothing: no switch differs, or on a CPU only flags that name a GPU."""
    if not (result.group.key.version and base.group.key.version):
        return False
    if not _differs(result, base):
        return True
    simulation = result.group.recordings[0].simulation
    if simulation is None or simulation.device != "cpu":
        return False
    changed = _words(_switches(result), _switches(base)) | _words(_environment(result), _environment(base))
    return bool(changed) and all("_gpu_" in word or "_cuda_" in word for word in changed)


def _cost(result: GroupResult, base: GroupResult | None, name: str) -> Cost:
    if base is None:
        return Cost(Missing("no group of the same configuration ran at the default level"))
    if _without_effect(result, base):
        return Cost(Missing(NO_EFFECT))
    for side, which in ((result, ""), (base, "the default: ")):
        if invalid := faults(side).invalid:
            return Cost(Missing(f"{which}{invalid}, so it has no price"))
    ours, theirs = result.metrics[name], base.metrics[name]
    for metric, which in ((ours, ""), (theirs, "the default: ")):
        if isinstance(metric.value, Missing):
            return Cost(Missing(f"{which}{_why_not(result if metric is ours else base, metric)}"))
    try:
        found = ratio_of_means(ours.of(OverRuns).per_run or (), theirs.of(OverRuns).per_run or ())
    except ValueError as error:
        return Cost(Missing(str(error)))
    return Cost(found.estimate, found.ci95)


def _why_not(result: GroupResult, metric: Estimate) -> str:
    endings = dict.fromkeys(f"{r.cause or r.status}: {r.reason}" for r in result.group.recordings if not r.usable)
    return "; ".join(endings) if endings and not result.group.complete else why_missing(metric.value)
