"""Radar and guidelines: which groups can be compared with each other at all."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from evaluator.groups import GroupKey
from evaluator.metrics.guidelines import Guideline, guidelines
from evaluator.metrics.radar import Radar, SimulatorResult, radar
from evaluator.results import GroupResult, Reference


def compare(
    results: Sequence[GroupResult], reference: Reference | None
) -> tuple[Radar | None, tuple[Guideline, ...], list[str]]:
    """Radar, guidelines, and what was left out of them.

    Speed and distances on another device or scene, at another number of environments, step or protocol mean something
    else. Of the conditions that at least two simulators share, the one with the most groups is compared, the first of
    several. Settings of one simulator are no choice between simulators.
    """
    simulators: dict[object, set[str]] = {}
    for result in results:
        if result.group.complete:
            simulators.setdefault(_conditions(result.group.key), set()).add(result.group.key.simulator)
    counts = Counter(c for r in results if len(simulators.get(c := _conditions(r.group.key), ())) > 1)
    if not counts:
        return None, (), []
    condition = counts.most_common(1)[0][0]
    chosen = [r for r in results if r.group.complete and _conditions(r.group.key) == condition]
    others = [r.label for r in results if r not in chosen]
    notes = [f"radar and guidelines leave out what ran under other conditions: {', '.join(others)}"] if others else []
    compared = [_simulator_result(r, reference) for r in chosen]
    return radar(compared), tuple(guidelines(compared)), notes


def _conditions(key: GroupKey) -> tuple[str, str, str, int, float, int, int]:
    return (key.device, key.scene, key.scene_hash, key.n_env, key.dt, key.warmup, key.timed_steps)


def _simulator_result(result: GroupResult, reference: Reference | None) -> SimulatorResult:
    def value(name: str) -> float | None:
        found = result.metrics[name].value
        return found if found is not None and math.isfinite(found) else None

    return SimulatorResult(
        name=result.label,
        fps=value("fps"),
        n_max=None,  # a sweep's result; a single n_env says nothing of the largest
        memory_gb=value("memory_peak_increment"),
        w1_real=value("w1_real") if reference and reference.measured else None,
        parallel=value("w1_parallel"),
        run_to_run=value("w1_run_to_run"),
    )
