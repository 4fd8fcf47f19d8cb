"""Sweeps: groups that differ in the number of environments alone: how far they go, memory, and how noise grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.mapping import Mapper
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.memory import MIN_POINTS, MemoryModel, fit_memory
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.results.cost_metrics import common_memory
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey, asked, beside_cause
from gpusimbench.evaluator.runs.labels import Given, labels, options_given
from gpusimbench.evaluator.runs.positions import joint_fields
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.matched import MatchedPoint, matched_variability
from gpusimbench.evaluator.transport.pair import wasserstein1

LONG = 3
"""From so many points on, a sweep is shown as one, and its points no more as groups of their own."""

SOURCES = {
    "memory_peak_increment": "device, NVML: peak minus baseline",
    "process_memory_peak": "device, NVML: the process's own, at its peak",
    "allocator_peak": "device, the engine's own allocator, without what CUDA graphs hold: peak",
    "host_memory_peak_increment": "host, resident set: peak minus baseline",
}
"""Metrics that a memory model is fitted to, and what they are."""

_DRAWS = 5
_SEED = 0
_MIN_ENVS = 4  # fewer say next to nothing, and all others would be reduced to them
_MAX_POINTS = 500  # of a side that runs are reduced to: a distance takes 10 ms, and there are hundreds
_MAX_RAW_POINTS = 1000  # of a side as it is


class Failure(NamedTuple):
    """How a run did not complete: INVALID, failed, incomplete or lost data; what kind of thing it was; why."""

    status: str
    cause: str
    reason: str

    @property
    def short(self) -> str:
        """Without the reason."""
        return f"{self.status} ({self.cause})" if self.cause else self.status

    def at(self, n_env: int) -> str:
        """As the end of a sweep."""
        why = beside_cause(self.cause, self.reason).rstrip(".")
        return ": ".join(part for part in (f"{self.status} at {n_env:,}", self.cause, why) if part)


@dataclass(frozen=True)
class SweepPoint:
    """One number of environments.

    result   of its group
    others   groups of the same number that cannot be told apart by what was asked; only their failures are shown
    """

    n_env: int
    result: GroupResult
    others: tuple[GroupResult, ...] = ()

    @property
    def recordings(self) -> tuple[Run, ...]:
        """All runs at this number of environments."""
        return tuple(r for result in (self.result, *self.others) for r in result.group.recordings)

    @property
    def complete(self) -> int:
        """Complete runs."""
        return len(self.result.group.complete)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Different ways in which runs did not complete."""
        return tuple(dict.fromkeys(_failure(r) for r in self.recordings if not r.usable))

    @property
    def causes(self) -> tuple[str, ...]:
        """The same in short: "failed (device memory)", "INVALID (buffer)"."""
        return tuple(dict.fromkeys(failure.short for failure in self.failures))


@dataclass(frozen=True)
class Sweep:
    """Points of one simulator with one set of settings on one device and scene, in order of n_env.

    key       of its groups; n_env is 0
    label     unique within the sweeps of its scene
    n_max     N_env^max: the largest number of environments with a complete run; None where no run is complete
    ends      why it goes no further
    memory    the metric that stands for its memory, the same at all points: of the device; of the process on it, where
              more points have that one, for other processes were on the device; of the host where it ran on the CPU
    models    by metric of SOURCES, or why there is none
    """

    key: GroupKey
    label: str
    points: tuple[SweepPoint, ...]
    n_max: int | None
    ends: str
    memory: str
    models: Mapping[str, MemoryModel | Missing] = field(default_factory=dict)

    @property
    def long(self) -> bool:
        """Whether it is shown as one."""
        return len(self.points) >= LONG

    @property
    def measured(self) -> bool:
        """Whether it says how far an engine goes or what that costs: a run was timed, or a larger number failed."""
        return self.limited or any("timed" in r.configuration.phases for p in self.points for r in p.recordings)

    @property
    def limited(self) -> bool:
        """Whether a larger number of environments failed, so that N_env^max is the engine's and not the user's."""
        return self.n_max is not None and self.points[-1].n_env > self.n_max

    @property
    def articulated(self) -> bool:
        """Whether its scene has a robot: joints were recorded."""
        return any(joint_fields(r.fields) for p in self.points for r in p.recordings)

    @property
    def at_max(self) -> GroupResult | None:
        """The result at N_env^max."""
        return next((p.result for p in self.points if p.n_env == self.n_max), None)


def find_sweeps(results: Sequence[GroupResult]) -> tuple[Sweep, ...]:
    """The sweeps among some groups, in their order; a single number of environments is none.

    A group whose runs all ended before their simulator was built belongs to the sweep that was asked for the same.
    """
    built = {
        replace(asked(r), n_env=0): sweep_key(result.group.key)
        for result in results
        for r in result.group.recordings
        if r.simulation
    }
    members: dict[GroupKey, dict[int, list[GroupResult]]] = {}
    for result in results:
        key = sweep_key(result.group.key)
        if not any(r.simulation for r in result.group.recordings):
            key = built.get(replace(asked(result.group.recordings[0]), n_env=0), key)
        members.setdefault(key, {}).setdefault(result.group.key.n_env, []).append(result)
    swept = {key: points for key, points in members.items() if len(points) > 1}
    given = options_given(r for result in results for r in result.group.recordings)
    return tuple(_sweep(key, _label(key, swept, given), _points(points)) for key, points in swept.items())


def sweep_key(key: GroupKey) -> GroupKey:
    """A group's key without what differs within a sweep."""
    return replace(key, n_env=0, origins="")


def swept_only(results: Sequence[GroupResult], sweeps: Sequence[Sweep]) -> set[str]:
    """Labels of groups that say nothing beyond what a long sweep shows: no complete run of theirs captured states."""
    members = {
        result.label
        for sweep in sweeps
        if sweep.long
        for point in sweep.points
        for result in (point.result, *point.others)
    }
    return {r.label for r in results if r.label in members and not r.group.captured}


def _label(key: GroupKey, swept: Mapping[GroupKey, object], given: Given) -> str:
    same_scene = [k for k in swept if k.scene == key.scene]
    return dict(zip(same_scene, labels(same_scene, given), strict=True))[key]


def _points(found: Mapping[int, list[GroupResult]]) -> tuple[SweepPoint, ...]:
    points = []
    for n_env in sorted(found):
        best, *others = sorted(found[n_env], key=lambda r: -len(r.group.complete))
        points.append(SweepPoint(n_env, best, tuple(others)))
    return tuple(points)


def _sweep(key: GroupKey, label: str, points: tuple[SweepPoint, ...]) -> Sweep:
    n_max = max((p.n_env for p in points if p.complete), default=None)
    above = [p for p in points if n_max is None or p.n_env > n_max]
    if above:
        ends = "; ".join(failure.at(above[0].n_env) for failure in above[0].failures)
    else:
        ends = "largest N in these recordings"
    memory = common_memory([p.result.metrics for p in points])
    told = any(known(p.result.metrics["allocator_peak"].value) is not None for p in points)
    models = {
        source: _model([(p.n_env, p.result.metrics[source]) for p in points])
        for source in ((memory, "allocator_peak") if told else (memory,))
    }
    return Sweep(key, label, points, n_max, ends, memory, models)


def _model(found: Sequence[tuple[int, Estimate]]) -> MemoryModel | Missing:
    measured = [(n, m.value * m.metric.per_unit) for n, m in found if not isinstance(m.value, Missing)]
    if not measured:
        return Missing(next((why_missing(m.value) for _, m in found), "it was not measured"))
    if len(measured) < MIN_POINTS:
        return Missing(f"needs at least {MIN_POINTS} numbers of environments with a complete run, got {len(measured)}")
    if any(memory <= 0 for _, memory in measured):
        return Missing("a point took no memory, of which no relative error can be said")
    return fit_memory([n for n, _ in measured], [memory for _, memory in measured])


def _failure(recording: Run) -> Failure:
    if recording.status == "complete":
        return Failure("lost data", "", recording.dropouts[0])
    status = "INVALID" if recording.status == "invalid" else recording.status
    return Failure(status, recording.cause, recording.reason)


@dataclass(frozen=True)
class Accumulation:
    """Variability against N_env of one sweep, in cm.

    label  of the sweep
    scene  its name
    size   envs that every run was reduced to
    draws  of those envs, at each N_env that is larger
    seed   of the draws
    points in order of N_env
    """

    label: str
    scene: str
    size: int
    draws: int
    seed: int
    points: tuple[MatchedPoint, ...]


def accumulations(
    sweeps: Sequence[Sweep], planar: Mapping[str, NDArray[np.float64] | None], work: Work
) -> tuple[Accumulation, ...]:
    """Of the sweeps that have positions of several runs at two numbers of envs or more, not counting those below 4.

    planar  positions at the sample step [m] by label of the group, shape [run, env, item, 2]
    """
    found = []
    for sweep in sweeps:
        found_at = {p.n_env: planar.get(p.result.label) for p in sweep.points if p.n_env >= _MIN_ENVS}
        at = {n_env: runs for n_env, runs in found_at.items() if runs is not None and len(runs) > 1}
        if len(at) < 2:
            continue
        items = next(iter(at.values())).shape[2]
        size = max(1, min(*at, _MAX_POINTS // items))
        points = work.once(_matched, [[n, runs * CM_PER_M] for n, runs in sorted(at.items())], size)
        found.append(Accumulation(sweep.label, sweep.key.scene, size, _DRAWS, _SEED, tuple(points)))
    return tuple(found)


def _matched(runs: list[tuple[int, NDArray[np.float64]]], size: int, _: Mapper) -> list[MatchedPoint]:
    by_number = dict(runs)
    return list(
        matched_variability(by_number, _distance, n_draw=_DRAWS, seed=_SEED, size=size, max_points=_MAX_RAW_POINTS)
    )


def _distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return wasserstein1(a, b, alike=True).value
