"""From recordings to an Evaluation: which metric is computed from what, and why one cannot be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evaluator import group_metrics as gm
from evaluator.groups import Group, group, labels
from evaluator.metrics.density import HexGrid, marginal
from evaluator.metrics.guidelines import Guideline, guidelines
from evaluator.metrics.radar import Radar, SimulatorResult, radar
from evaluator.positions import planar_positions
from evaluator.recording import Recording, Unreadable
from evaluator.results import Cloud, Evaluation, GroupResult, Map, Metric, Reference
from schemas.provenance import REAL

_BIN_M = 0.01  # half a cube's edge
_MARGIN_M = 0.1
_EXTENT_LIMIT_M = 1.0  # what flies further is counted as off the map, so that one outlier does not shrink all maps


def evaluate(
    recordings: Sequence[Recording],
    *,
    reference: Recording | None = None,
    sample_time: float = 5.0,
    unreadable: Sequence[Unreadable] = (),
) -> Evaluation:
    """Every metric of every group.

    recordings   in any order; copies of one run count once
    reference    real trials, or a simulation to compare with; where None, the real trials among the recordings
    sample_time  simulated time at which positions are compared [s]
    unreadable   files that could not be opened, passed on to the report
    """
    distinct, copies = _without_copies(recordings)
    notes = [f"{path.name} is a copy of a recording that is here already; it counts once" for path in copies]
    groups = [g for g in group(distinct) if not g.measured]
    measured = [r for r in distinct if r.configuration.simulator == REAL]
    chosen, reference_note = _choose_reference(reference, measured)
    target, why_not = _read_reference(chosen, sample_time) if chosen else (None, reference_note)
    if target:
        reference_note = reference_note or f"compared with {target.label}"
    if len({g.key.dt for g in groups}) > 1:
        notes.append("the recordings differ in dt, which changes the outcome: each dt is a group of its own")

    found = [
        _evaluate_group(g, label, target, why_not, sample_time) for g, label in zip(groups, labels(groups), strict=True)
    ]
    shared = _shared_map([p for _, p in found if p is not None], target)
    results = tuple(_with_cloud(result, positions, shared) for result, positions in found)
    notes += _identical_groups(results)
    compared, picks = _compare(results, target)
    return Evaluation(
        sample_time=sample_time,
        results=results,
        unreadable=tuple(unreadable),
        reference=_with_density(target, shared),
        reference_note=reference_note or why_not,
        radar=compared,
        guidelines=picks,
        map=shared,
        notes=tuple(notes),
    )


def _without_copies(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Path]]:
    seen: set[str] = set()
    distinct: list[Recording] = []
    copies: list[Path] = []
    # of a whole file and one that was cut short, the whole one stays
    for recording in sorted(recordings, key=lambda r: r.status == "incomplete"):
        identity = recording.provenance.run_id
        if identity in seen:
            copies.append(recording.path)
        else:
            seen.add(identity)
            distinct.append(recording)
    return distinct, copies


def _choose_reference(given: Recording | None, measured: Sequence[Recording]) -> tuple[Recording | None, str]:
    if given is not None:
        return given, ""
    if len(measured) == 1:
        return measured[0], f"compared with the real trials in {measured[0].path.name}"
    if measured:
        return None, f"{len(measured)} recordings of real trials are here: choose one with --reference"
    return None, "no reference: give real trials or another recording with --reference"


def _read_reference(recording: Recording, sample_time: float) -> tuple[Reference | None, str]:
    if recording.status != "complete":
        return None, f"the reference {recording.path.name} is {recording.status}: {recording.reason}"
    positions, why_not = planar_positions(recording, sample_time)
    if positions is None:
        return None, f"the reference {recording.path.name} cannot be used: {why_not}"
    c = recording.configuration
    measured = c.simulator == REAL
    label = f"{len(positions)} real trials" if measured else f"{c.simulator} with {c.n_env} envs, dt {c.dt:g} s"
    return Reference(label, recording.path, measured, c.scene, positions), ""


def _evaluate_group(
    group: Group, label: str, reference: Reference | None, no_reference: str, sample_time: float
) -> tuple[GroupResult, NDArray[np.float64] | None]:
    notes = gm.status_notes(group)
    sampled = gm.sample(group, sample_time)
    metrics: list[Metric] = [
        gm.throughput(group),
        gm.memory_peak_increment(group),
        gm.host_memory_peak_increment(group),
        *gm.distinct(group),
        gm.capture_effect(group),
    ]
    parallel, parallel_matrix = gm.parallel(sampled)
    between, run_matrix = gm.run_to_run(sampled)
    metrics += [parallel, between, gm.real(sampled, reference, no_reference, group), gm.left_board(group, sampled)]
    metrics.append(gm.regime(parallel, between))
    if reference and reference.path in {r.path for r in group.recordings}:
        notes.append("the reference is one of this group's own runs")
    result = GroupResult(
        group=group,
        label=label,
        metrics={m.name: m for m in metrics},
        cloud=None,
        parallel_matrix=parallel_matrix,
        run_matrix=run_matrix,
        notes=tuple(notes),
    )
    return result, sampled.positions


def _shared_map(clouds: Sequence[NDArray[np.float64]], reference: Reference | None) -> Map | None:
    everything = [c.reshape(-1, 2) for c in clouds] + ([reference.positions.reshape(-1, 2)] if reference else [])
    if not everything:
        return None
    points = np.concatenate(everything)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    middle = np.median(points, axis=0)
    near = points[(np.abs(points - middle) <= _EXTENT_LIMIT_M).all(axis=1)]
    low = np.floor((near.min(axis=0) - _MARGIN_M) * 10) / 10
    high = np.ceil((near.max(axis=0) + _MARGIN_M) * 10) / 10
    grid = HexGrid((float(low[0]), float(high[0]), float(low[1]), float(high[1])), _BIN_M)
    edges = tuple(np.linspace(a, b, round((b - a) / _BIN_M) + 1) for a, b in zip(low, high, strict=True))
    counts = [grid.bin(c).counts for c in everything]
    largest = max((int(c.max()) for c in counts if len(c)), default=1)
    return Map(grid, (edges[0], edges[1]), largest)


def _with_cloud(result: GroupResult, positions: NDArray[np.float64] | None, shared: Map | None) -> GroupResult:
    if positions is None or shared is None:
        return result
    sides = (marginal(positions[..., 0].ravel(), shared.edges[0]), marginal(positions[..., 1].ravel(), shared.edges[1]))
    cloud = Cloud(positions, shared.grid.bin(positions), sides)
    return GroupResult(**{**vars(result), "cloud": cloud})


def _with_density(reference: Reference | None, shared: Map | None) -> Reference | None:
    if reference is None or shared is None:
        return reference
    return Reference(**{**vars(reference), "density": shared.grid.bin(reference.positions)})


def _identical_groups(results: Sequence[GroupResult]) -> list[str]:
    # The same trajectories from other machines, versions or settings: what somebody who reproduces a result looks for.
    notes = []
    for index, one in enumerate(results):
        for other in results[index + 1 :]:
            steps = gm.identical_steps(one.group, other.group)
            if steps:
                notes.append(
                    f"{one.label} and {other.label}: all runs are bit-identical over their {steps} common states"
                )
    return notes


def _compare(results: Sequence[GroupResult], reference: Reference | None) -> tuple[Radar | None, tuple[Guideline, ...]]:
    # Only what ran the same scene can be compared; of several scenes, the first that two groups share.
    scenes = [r.group.key.scene for r in results]
    scene = next((s for s in scenes if scenes.count(s) > 1), None)
    if scene is None:
        return None, ()
    compared = [_simulator_result(r, reference) for r in results if r.group.key.scene == scene]
    return radar(compared), tuple(guidelines(compared))


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
