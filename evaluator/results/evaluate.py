"""From recordings to an Evaluation: which metric is computed from what, and why one cannot be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.protocol import RULE_SET, Protocol, Unmet, unmet_by_file
from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results import cost_metrics as costs
from gpusimbench.evaluator.results import group_metrics as gm
from gpusimbench.evaluator.results import identity_metrics as identity
from gpusimbench.evaluator.results.accumulation import accumulations
from gpusimbench.evaluator.results.clamped_metrics import clamped_metrics
from gpusimbench.evaluator.results.density_maps import reference_density, shared_map, with_cloud
from gpusimbench.evaluator.results.determinism_cost import price_list
from gpusimbench.evaluator.results.fidelity import fidelity
from gpusimbench.evaluator.results.ranking import compare
from gpusimbench.evaluator.results.result import Evaluation, GroupResult, Metric, Reference, RunSpread
from gpusimbench.evaluator.results.sampled import ends_early, left_out, positions, sampled
from gpusimbench.evaluator.results.sweeps import find_sweeps
from gpusimbench.evaluator.results.timed_work import timed_work
from gpusimbench.evaluator.results.validity import validity_of
from gpusimbench.evaluator.runs import cotenancy
from gpusimbench.evaluator.runs.groups import Group, group, labels, options_given, status_notes
from gpusimbench.evaluator.runs.reader import Reader, Unreadable
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import REAL


@dataclass(frozen=True)
class _Found:
    """One group's result with what it was computed from."""

    result: GroupResult
    runs: tuple[Run, ...]
    planar: NDArray[np.float64] | None


def evaluate_files(paths: Iterable[Place], *, sample_time: float = 5.0) -> Evaluation:
    """Every metric of every group of some recordings, whose digests are taken on trust; see `evaluate`."""
    return evaluate(map(Reader(sample_time, unmet_by_file, verify=False), paths), sample_time=sample_time)


def evaluate(
    files: Iterable[Run | Unreadable],
    *,
    reference: Run | None = None,
    sample_time: float = 5.0,
    work: Work = HERE,
) -> Evaluation:
    """Every metric of every group.

    A file that could not be read is set aside and named; the others are evaluated without it.

    files        in any order; copies of one run count once
    reference    real trials, or a simulation to compare with; where None, the real trials among the files
    sample_time  simulated time that the files were read for [s]
    work         where distances are computed
    """
    files = list(files)
    failures = [f for f in files if isinstance(f, Unreadable)]
    distinct, notes = without_copies([f for f in files if isinstance(f, Run)], failures)
    distinct = cotenancy.with_peers(distinct)

    measured = [r for r in distinct if r.configuration.simulator == REAL]
    chosen, reference_note = _choose_reference(reference, measured)
    target, why_not = _use_reference(chosen) if chosen else (None, reference_note)
    if target:
        if chosen and chosen.doubt:
            notes.append(f"the reference {target.path.name}: {chosen.doubt.text}")
        reference_note = reference_note or f"compared with {target.label} in {target.path.name}"

    groups = [g for g in group(distinct) if not g.measured]
    if len({g.key.dt for g in groups}) > 1:
        notes.append("the recordings differ in dt, which changes the outcome: each dt is a group of its own")
    names = labels([g.key for g in groups], options_given(distinct))
    protocol = Protocol(distinct)
    if protocol.whole.count:
        notes.append(
            f"the recordings break rules of {RULE_SET} {_times(protocol.whole.count)}: gsb-check --protocol names them"
        )
    found = [
        _evaluate_group(g, label, protocol.of(g.recordings), target, why_not, sample_time, work)
        for g, label in zip(groups, names, strict=True)
    ]
    notes += _identical_groups(found)
    maps = {
        scene: shared
        for scene in dict.fromkeys(g.key.scene for g in groups)
        if (shared := shared_map([f.planar for f in found if f.result.group.key.scene == scene], target, scene))
    }
    results = tuple(with_cloud(f.result, f.planar, maps.get(f.result.group.key.scene)) for f in found)
    sweeps = find_sweeps(results)
    comparison = compare(results, sweeps, target)
    return Evaluation(
        sample_time=sample_time,
        results=results,
        unreadable=tuple(failures),
        reference=reference_density(target, maps.get(target.scene)) if target else None,
        reference_note=reference_note or why_not,
        sweeps=sweeps,
        accumulation=accumulations(sweeps, {f.result.label: f.planar for f in found}, work),
        comparison=comparison,
        maps=maps,
        notes=(*notes, *comparison.notes),
        price_list=price_list(results),
        unmet=protocol.whole,
    )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def without_copies(files: Sequence[Run], failures: list[Unreadable]) -> tuple[list[Run], list[str]]:
    """Each run once, with notes on its copies; a file that is no copy but says so is added to the failures."""
    seen: dict[str, Run] = {}
    notes: list[str] = []
    # of a whole file and one that was cut short, the whole one stays
    for run in sorted(files, key=lambda r: r.status == "incomplete"):
        first = seen.setdefault(run.provenance.run_id, run)
        if first is run:
            continue
        if run.content_hash in (first.content_hash, ""):
            notes.append(f"{run.path.name} is a copy of {first.path.name}; it counts once")
        else:
            why = f"{run.path} has the run id of {first.path.name} and another content: one of them was changed"
            failures.append(Unreadable(run.path, DamagedRecording(why)))
    return list(seen.values()), notes


def _choose_reference(given: Run | None, measured: Sequence[Run]) -> tuple[Run | None, str]:
    if given is not None:
        return given, ""
    if len(measured) == 1:
        return measured[0], f"compared with the real trials in {measured[0].path.name}"
    if measured:
        return None, f"{len(measured)} recordings of real trials are here: choose one with --reference"
    return None, "no reference: give real trials or another recording with --reference"


def _use_reference(run: Run) -> tuple[Reference | None, str]:
    name = run.path.name
    if run.status != "complete":
        return None, f"the reference {name} is {run.status}: {run.reason}"
    if run.dropouts:
        return None, f"the reference {name} lost data: {run.dropouts[0]}"
    if isinstance(run.positions, Missing):
        return None, f"the reference {name} cannot be used: {run.positions.reason}"
    if run.doubt and run.doubt.wrong:
        return None, f"the reference {name} cannot be used: {run.doubt.text}: record it again with --unit"
    planar = run.positions.planar
    c = run.configuration
    measured = c.simulator == REAL
    label = f"{len(planar)} real trials" if measured else f"{c.simulator} with {c.n_env} envs, dt {c.dt:g} s"
    return Reference(label, run.path, run.provenance.run_id, measured, c.scene, planar), ""


def _evaluate_group(
    group: Group[Run],
    label: str,
    unmet: Unmet,
    reference: Reference | None,
    no_reference: str,
    sample_time: float,
    work: Work,
) -> _Found:
    runs = group.complete
    at_sample = sampled(runs)
    planar, why_not = positions(at_sample)
    parallel, parallel_matrix = gm.parallel(planar, why_not, work)
    between, run_matrix = gm.run_to_run(planar, why_not, work)
    real = gm.real(planar, why_not, reference, no_reference, group.key.scene, work)
    distinct_envs, distinct_runs = identity.distinct(runs)
    classes = identity.classes_of(at_sample)
    between.extra.update(_drawn_runs(at_sample, classes) if run_matrix is not None else {})
    parallel.extra.update({"matrix_of": _place(at_sample[0], runs)} if parallel_matrix is not None else {})
    metrics: list[Metric] = [
        costs.throughput(runs),
        costs.memory_peak_increment(runs),
        costs.process_memory_peak(runs),
        costs.allocator_peak(runs),
        costs.host_memory_peak_increment(runs),
        costs.build_time(runs),
        costs.compile_time(runs),
        costs.capture_slowdown(runs),
        parallel,
        between,
        real,
        *clamped_metrics(at_sample, planar, (parallel, between, real), reference, group.key.scene, work),
        distinct_envs,
        distinct_runs,
        identity.equality_of_envs(at_sample),
        identity.equality_of_runs(at_sample),
        identity.growth(runs),
        gm.left_board(at_sample),
        gm.sank(runs),
        gm.regime(at_sample, parallel, between, run_matrix, classes),
        identity.capture_effect(runs, distinct_runs),
    ]
    result = GroupResult(
        group=group,
        label=label,
        metrics={m.name: m for m in metrics},
        cloud=None,
        parallel_matrix=parallel_matrix,
        run_matrix=run_matrix,
        validity=validity_of(group),
        fidelity=fidelity(label, [run.physics for run in runs]),
        notes=tuple(_notes(group, runs, reference, sample_time)),
        spreads=tuple(RunSpread(r.configuration.run_index, r.spread) for r in runs),
        timed=timed_work(group.key, runs, unmet),
    )
    result = replace(result, notes=(*result.notes, *_warnings(result)))
    return _Found(result, runs, planar)


def _drawn_runs(at_sample: Sequence[Run], classes: list[int]) -> dict[str, list[int]]:
    """What the rows of the matrix of runs are: their indices, and their classes by bits."""
    return {"runs": [r.configuration.run_index for r in at_sample], "classes": classes}


def _place(run: Run, runs: Sequence[Run]) -> int | None:
    """Of the run whose environments are drawn, among the runs whose environments are compared by bits."""
    return next((at for at, one in enumerate(r for r in runs if r.histories) if one is run), None)


def _notes(group: Group[Run], runs: Sequence[Run], reference: Reference | None, sample_time: float) -> list[str]:
    notes = [*status_notes(group), *left_out(runs), *ends_early(runs)]
    sampled = next((r.positions.time for r in runs if r.positions), sample_time)
    if not math.isclose(sampled, sample_time, rel_tol=1e-9):
        notes.append(f"positions are those at {sampled:g} s, the step nearest to {sample_time:g} s")
    if reference and reference.run_id in {r.provenance.run_id for r in runs}:
        notes.append("the reference is one of this group's own runs, whose distance of zero is part of the mean")
    return [*notes, *cotenancy.notes(runs)]


def _warnings(result: GroupResult) -> list[str]:
    """What the numbers themselves warn of."""
    notes = []
    sank = result.metrics["sank"]
    if sank.value:
        mean = f"{sank.value:.3g} of {sank.extra['cubes']}"
        notes.append(
            f"cubes through the floor: {mean} per env by step {sank.extra['last_step']}, the first at step "
            f"{sank.extra['first_step']}"
        )
    if any(len(applied.sha256) > 1 for applied in result.validity.actions):
        notes.append("the runs were given different actions, so they differ by design")
    return notes


def _identical_groups(found: Sequence[_Found]) -> list[str]:
    # The same trajectories from other machines, versions or settings: what somebody who reproduces a result looks for.
    notes = []
    for index, one in enumerate(found):
        for other in found[index + 1 :]:
            count = identity.identical_steps(one.runs, other.runs)
            if count:
                names = f"{one.result.label} and {other.result.label}"
                notes.append(f"{names}: all runs are bit-identical over their {count} common states")
    return notes
