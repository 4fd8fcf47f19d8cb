"""The benchmark's two published tables, made again from recordings: capability at N_env^max, and variability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import Failure, Sweep
from gpusimbench.evaluator.results.timed_work import TimedWork
from gpusimbench.evaluator.runs.groups import GroupKey, is_instrument, settings_asked
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.run import Run

CAPABILITY_SCENES = ("free-fall", "franka")
VARIABILITY_SCENE = "inclined-collision"

_MEMORY_CAUSES = ("device memory", "host memory")


class Limit(StrEnum):
    """What N_env^max is a limit of; the paper's table does not tell these apart."""

    TRIED = "none was met: this is the largest N in these recordings"
    MEMORY = "memory"
    INVALID = "validity, not memory"
    OTHER = "the engine, not memory"
    NONE = "no N has a complete run"


@dataclass(frozen=True)
class AtMax:
    """One simulator at its N_env^max in one scene.

    sweep     that it is taken from
    n_max     None where no run is complete
    fps       throughput there; None likewise
    memory    memory increment there: of the device, or of the host where it ran on the CPU; None likewise
    limit     what ended the sweep
    ends      the same in the words of the runs that did not complete
    faults    of the runs at N_env^max
    contacts  mean per environment and step there; None where nothing was counted
    timed     what the throughput there was measured over; None where no run is complete
    """

    sweep: Sweep
    n_max: int | None
    fps: Estimate | None
    memory: Estimate | None
    limit: Limit
    ends: str
    faults: Faults
    contacts: float | None
    timed: TimedWork | None = None


@dataclass(frozen=True)
class Capability:
    """One row of the first table.

    label      of the simulator with its settings, unique within the table
    key        what the row's sweeps have in common
    at         by scene, where there is a sweep
    elsewhere  what its other groups show against it, each with the scene: sweeps capture no states that would
    """

    label: str
    key: GroupKey
    at: Mapping[str, AtMax] = field(default_factory=dict)
    elsewhere: tuple[str, ...] = ()


def capability(sweeps: Sequence[Sweep], results: Sequence[GroupResult]) -> tuple[Capability, ...]:
    """A row for each simulator with each set of settings that was asked for, in order of their labels.

    results  all groups of the evaluation
    """
    found: dict[GroupKey, dict[str, Sweep]] = {}
    for sweep in sweeps:
        if sweep.key.scene in CAPABILITY_SCENES:
            found.setdefault(settings_asked(_recordings(sweep)), {}).setdefault(sweep.key.scene, sweep)
    given = options_given(r for by_scene in found.values() for s in by_scene.values() for r in _recordings(s))
    rows = [
        Capability(
            label, key, {scene: _at_max(sweep) for scene, sweep in by_scene.items()}, _elsewhere(key, by_scene, results)
        )
        for label, (key, by_scene) in zip(labels(list(found), given), found.items(), strict=True)
    ]
    return tuple(sorted(rows, key=lambda row: row.label))


def variability(results: Sequence[GroupResult]) -> tuple[GroupResult, ...]:
    """Rows of the second table: groups of its scene by published type, those without one last."""
    rows = [r for r in results if r.group.key.scene == VARIABILITY_SCENE and not is_instrument(r.group.key)]
    return tuple(sorted(rows, key=lambda r: (known(r.metrics["regime_published"].value) or float("inf"), r.label)))


def _elsewhere(key: GroupKey, by_scene: Mapping[str, Sweep], results: Sequence[GroupResult]) -> tuple[str, ...]:
    swept = {p.result.label for sweep in by_scene.values() for p in sweep.points}
    others = [r for r in results if r.label not in swept and r.group.asked == key]
    return tuple(f"{r.group.key.scene}: {wrong}" for r in others if (wrong := faults(r)))


def _recordings(sweep: Sweep) -> list[Run]:
    return [r for point in sweep.points for r in point.recordings]


def _at_max(sweep: Sweep) -> AtMax:
    result = sweep.at_max
    limit = _limit(sweep)
    if result is None:
        return AtMax(sweep, None, None, None, limit, sweep.ends, Faults(), None)
    counted = result.validity.of("contacts", "timed", "capture")
    return AtMax(
        sweep,
        sweep.n_max,
        result.metrics["fps"],
        result.metrics[sweep.memory],
        limit,
        sweep.ends,
        faults(result),
        counted.mean if counted else None,
        result.timed,
    )


def _limit(sweep: Sweep) -> Limit:
    if sweep.n_max is None:
        return Limit.NONE
    if not sweep.limited:
        return Limit.TRIED
    failures: tuple[Failure, ...] = next(p.failures for p in sweep.points if p.n_env > (sweep.n_max or 0))
    if any(failure.status == "INVALID" for failure in failures):
        return Limit.INVALID
    return Limit.MEMORY if all(failure.cause in _MEMORY_CAUSES for failure in failures) else Limit.OTHER
