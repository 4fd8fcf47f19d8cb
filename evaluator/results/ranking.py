"""Radar and guidelines: which simulators can be compared with each other, and from which of their groups."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

from gpusimbench.evaluator.metrics.guidelines import Guideline, guidelines
from gpusimbench.evaluator.metrics.radar import Axis, Radar, SimulatorResult, radar
from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.results.cost_metrics import GPU_MEMORY, common_memory, ranked_throughput
from gpusimbench.evaluator.results.faults import faults_anywhere
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.metrics import on_radar
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import Sweep, swept_only
from gpusimbench.evaluator.results.timed_work import largest_comparable, most_common, window_key
from gpusimbench.evaluator.runs.groups import GroupKey, is_instrument, settings_asked
from gpusimbench.evaluator.runs.labels import Given, labels, options_given
from gpusimbench.schemas.configuration import deciding
from gpusimbench.schemas.text import plural

_DISTANCES = (Axis.EMD_TO_REAL, Axis.PARALLEL, Axis.RUN_TO_RUN)
_NO_SWEEP = (
    "no comparable sweep over envs: it must share the conditions of another simulator's sweep, and end with a failure "
    "or at the largest number tried"
)


@dataclass(frozen=True)
class Contender:
    """One simulator with one set of settings, and where its figures come from.

    group    whose distances are compared; None where there is none
    sweep    whose throughput and memory at N_env^max are compared, and N_env^max itself; None: those of the group
    robot    the same of a scene with a robot
    figures  that enter radar and guidelines
    metrics  by axis, where a figure is of a metric, or why it is missing
    speed    whose throughput is compared; None where none is
    """

    group: GroupResult | None
    sweep: Sweep | None
    robot: Sweep | None
    figures: SimulatorResult
    metrics: Mapping[Axis, Estimate | Missing] = field(default_factory=dict)
    speed: GroupResult | None = None


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    contenders  in the order of radar and guidelines; fewer than two: there is neither
    radar       None with fewer than two contenders
    guidelines  empty likewise
    notes       what was left out
    """

    contenders: tuple[Contender, ...] = ()
    radar: Radar | None = None
    guidelines: tuple[Guideline, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass
class _Parts:
    group: GroupResult | None = None
    sweep: Sweep | None = None
    robot: Sweep | None = None

    @property
    def key(self) -> GroupKey:
        if self.group:
            return self.group.group.asked
        swept = self.sweep or self.robot
        assert swept is not None, "a contender has a group or a sweep"
        return _swept_settings(swept)


def compare(results: Sequence[GroupResult], sweeps: Sequence[Sweep], reference: Reference | None) -> Comparison:
    """Radar and guidelines.

    Speed and distances on another device or scene, at another number of environments or step, from other initial
    states, with varied parameters or an intervention mean something else. Of the conditions that at least two
    simulators share, runs that were left alone come first, then the condition with the most groups is compared; of
    several, the one with the most distances, then the first. The same for sweeps, of scenes without a robot and with
    one, which have to share the timed steps as well. Where sweeps are shared, throughput and memory are those at each
    simulator's own N_env^max, as the published definition has it; a sweep that ended below the largest number tried,
    though nothing failed, says nothing of its simulator's. Without sweeps, throughput is compared among the groups that
    were timed over the steps that most were timed over; distances do not depend on what was timed. Settings of one
    simulator are no choice between simulators, and what says of itself that it is an instrument is not ranked at all. A
    simulator whose runs are INVALID, or break mechanics or a law in closed form, in any scene earns no pick.
    """
    aside = dict.fromkeys(r.group.key.simulator for r in results if is_instrument(r.group.key))
    results = [r for r in results if not is_instrument(r.group.key)]
    sweeps = [s for s in sweeps if not is_instrument(s.key)]
    notes = [f"radar and guidelines leave out instruments: {', '.join(aside)}"] if aside and results else []

    ended = [s for s in sweeps if s.n_max is not None]
    simple = _went_far_enough(
        largest_comparable([s for s in ended if not s.articulated], lambda s: s.key, _timed_alike)
    )
    robots = _went_far_enough(largest_comparable([s for s in ended if s.articulated], lambda s: s.key, _timed_alike))
    swept = {p.result.label for s in (*simple, *robots) for p in s.points}
    complete = [r for r in results if r.group.complete]
    # points of a sweep that captured no states would be compared twice
    apart = [r for r in complete if r.label not in swept or r.group.captured]
    groups = largest_comparable(apart, lambda r: r.group.key, lambda r: _conditions(r.group.key), _distances)

    found = [_Parts(group=r) for r in groups]
    for sweep in simple:
        _join(found, sweep, "sweep").sweep = sweep
    for sweep in robots:
        _join(found, sweep, "robot").robot = sweep
    if len({parts.key.simulator for parts in found}) < 2:
        return Comparison(notes=tuple(notes))
    given = options_given(r for result in results for r in result.group.recordings)
    others_windows = {} if simple else _timed_otherwise(groups)
    speeds = [_speed(parts, at_max=bool(simple)) for parts in found]
    memory = common_memory([r.metrics for r in speeds if r])
    if memory == GPU_MEMORY[1]:
        notes.append(
            "radar and guidelines compare the GPU memory of the runs' own processes: other processes were on the GPU"
        )
    contenders = tuple(
        _contender(parts, name, reference, results, others_windows, memory, at_max=bool(simple))
        for parts, name in zip(found, _names(found, given), strict=True)
    )
    figures = [c.figures for c in contenders]
    used = {r.label for r in groups} | swept
    # gsb-probe makes many treated groups, whose names would fill a page
    treated = {r.label for r in results if deciding(r.group.key.settings)} - used
    others = _left_out(results, sweeps, used | treated)
    if treated:
        others.append(f"{plural(len(treated), 'group')} with --initial, --vary or --intervene")
    if others:
        notes.append(f"radar and guidelines leave out what ran under other conditions: {', '.join(others)}")
    return Comparison(contenders, radar(figures), tuple(guidelines(figures)), tuple(notes))


def _went_far_enough(sweeps: list[Sweep]) -> list[Sweep]:
    """Those that met their simulator's limit, or went as far as any; none where that leaves a single simulator."""
    tried = max((s.points[-1].n_env for s in sweeps), default=0)
    kept = [s for s in sweeps if s.limited or s.n_max == tried]
    return kept if len({s.key.simulator for s in kept}) > 1 else []


def _distances(result: GroupResult) -> int:
    return sum(known(result.metrics[_name_on(axis)].value) is not None for axis in _DISTANCES)


def _name_on(axis: Axis) -> str:
    shown = on_radar(axis)
    assert shown is not None
    return shown.name


def _left_out(results: Sequence[GroupResult], sweeps: Sequence[Sweep], used: set[str]) -> list[str]:
    # a sweep by one name, not by those of all its points
    hidden = swept_only(results, sweeps)
    named = []
    for sweep in sweeps:
        labels_of = {r.label for p in sweep.points for r in (p.result, *p.others)}
        if labels_of <= hidden and not labels_of & used:
            named.append(f"{sweep.label} (sweep of {sweep.key.scene})")
            used = used | labels_of
    return [*(r.label for r in results if r.label not in used), *named]


def _conditions(key: GroupKey) -> Hashable:
    return (key.device, key.scene, key.scene_hash, key.n_env, key.dt, deciding(key.settings))


def _timed_alike(sweep: Sweep) -> Hashable:
    return (_conditions(sweep.key), sweep.key.warmup, sweep.key.timed_steps)


def _timed_otherwise(groups: Sequence[GroupResult]) -> dict[str, str]:
    """Why the throughput of a group is not compared, by label: it was timed over other steps than most."""
    timed = {r.label: window_key(r.group.key, r.timed) for r in groups if r.timed.windows}
    if not timed:
        return {}
    usual = most_common(list(timed.values()))
    over = next(r.timed for r in groups if timed.get(r.label) == usual).said
    return {
        r.label: f"timed over {r.timed.said} of the scene, and others over {over}"
        for r in groups
        if timed.get(r.label, usual) != usual
    }


def _swept_settings(sweep: Sweep) -> GroupKey:
    return settings_asked([r for point in sweep.points for r in point.recordings])


def _join(found: list[_Parts], sweep: Sweep, part: str) -> _Parts:
    key = _swept_settings(sweep)
    for parts in found:
        if parts.key == key and getattr(parts, part) is None:
            return parts
    found.append(_Parts())
    return found[-1]


def _names(found: Sequence[_Parts], given: Given) -> list[str]:
    if all(parts.group and not parts.sweep and not parts.robot for parts in found):
        return [parts.group.label for parts in found if parts.group]
    return labels([parts.key for parts in found], given)


def _speed(parts: _Parts, *, at_max: bool) -> GroupResult | None:
    return parts.sweep.at_max if parts.sweep else None if at_max else parts.group


def _contender(
    parts: _Parts,
    name: str,
    reference: Reference | None,
    results: Sequence[GroupResult],
    timed_otherwise: Mapping[str, str],
    memory: str,
    *,
    at_max: bool,
) -> Contender:
    """What a simulator is compared by; `memory`, the metric that all are compared by, where it is one of the GPU's."""
    speed = _speed(parts, at_max=at_max)
    metrics: dict[Axis, Estimate | Missing] = {}

    def compared(axis: Axis, result: GroupResult | None) -> Estimate | Missing:
        if result is None:
            return Missing(_NO_SWEEP if axis not in _DISTANCES else "no group of it ran under the shared conditions")
        missed = timed_otherwise.get(result.label) or result.timed.unmet.of_throughput
        if axis is Axis.THROUGHPUT and missed:
            return Missing(missed)
        metric = result.metrics[memory if axis is Axis.MEMORY and memory in GPU_MEMORY else _name_on(axis)]
        if isinstance(metric.value, Missing):
            return metric.value
        if axis is Axis.EMD_TO_REAL and not (reference and reference.measured):
            return Missing("the reference is another simulation, not measured")
        return metric if math.isfinite(metric.value) else Missing("it is not finite")

    def value(axis: Axis, result: GroupResult | None) -> float | None:
        metrics[axis] = found = compared(axis, result)
        return None if isinstance(found, Missing) else known(found.value)

    robot = parts.robot.at_max if parts.robot else None
    n_max = parts.sweep.n_max if parts.sweep else None
    if n_max is None:
        metrics[Axis.PARALLELISM] = Missing(_NO_SWEEP)
    fps = value(Axis.THROUGHPUT, speed)
    if fps is not None and speed is not None:
        fps = ranked_throughput(speed.metrics["fps"])
    figures = SimulatorResult(
        name=name,
        fps=fps,
        n_max=n_max,
        memory_gb=value(Axis.MEMORY, speed),
        w1_real=value(Axis.EMD_TO_REAL, parts.group),
        parallel=value(Axis.PARALLEL, parts.group),
        run_to_run=value(Axis.RUN_TO_RUN, parts.group),
        fps_articulated=(ranked_throughput(robot.metrics["fps"]) or None) if robot else None,
        n_max_articulated=parts.robot.n_max if parts.robot else None,
        barred=_barred(results, parts.group, parts.sweep.at_max if parts.sweep else None, robot),
        barred_articulated=_barred(results, robot),
        why_no_fps=why_missing(metrics[Axis.THROUGHPUT]),
    )
    timed = speed if fps is not None else None
    return Contender(parts.group, parts.sweep, parts.robot, figures, metrics, timed)


def _barred(results: Sequence[GroupResult], *found: GroupResult | None) -> str:
    """Why what these show, or the same engine in any scene, earns no pick."""
    said = [wrong for r in found if r is not None for wrong in faults_anywhere(r, results)]
    return "; ".join(dict.fromkeys(said))
