"""From the recordings of one group to its result: estimates, validity, mechanics, and notes on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.protocol import Unmet
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.read import known_errors
from gpusimbench.evaluator.results import growth
from gpusimbench.evaluator.results.canonical import laws
from gpusimbench.evaluator.results.details import SunkCubes, Throughput
from gpusimbench.evaluator.results.fidelity import fidelity
from gpusimbench.evaluator.results.group_runs import GroupRuns, ends_early, left_out
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.reference import Reference, toss_errors
from gpusimbench.evaluator.results.result import GroupResult, RunSpread
from gpusimbench.evaluator.results.timed_work import timed_work
from gpusimbench.evaluator.results.validity import validity_of
from gpusimbench.evaluator.runs import memory
from gpusimbench.evaluator.runs.groups import Group, status_notes
from gpusimbench.evaluator.runs.physics.facts import Check
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.toss_motion import set_every
from gpusimbench.schemas.text import plural


def evaluate_group(
    group: Group[Run], label: str, unmet: Unmet, reference: Reference | Missing, sample_time: float, work: Work
) -> tuple[GroupResult, NDArray[np.float64] | None]:
    """The result of a group, without its place on a map; and its planar positions [m], shape [run, env, item, 2].

    unmet        rules of the protocol that its recordings do not meet
    sample_time  simulated time that its recordings were read for [s]
    """
    runs = group.complete
    errors = toss_errors(runs, reference)
    if any(set_every(run.configuration) for run in runs):
        reference = Missing("the environments are set to the reference's states on the way")
    group_runs = GroupRuns(runs, reference, work, *errors)
    doubts = (*growth.notes(runs), *known_errors.notes(group.recordings))
    result = GroupResult(
        group=group,
        label=label,
        metrics={name: metric.estimate(group_runs) for name, metric in METRICS.items()},
        cloud=None,
        validity=validity_of(group),
        fidelity=fidelity(label, [run.physics for run in runs]),
        laws=laws(label, [run.physics for run in runs]),
        notes=(*_notes(group, runs, reference, sample_time), *doubts, *memory.notes(runs)),
        doubts=doubts,
        spreads=tuple(RunSpread(r.configuration.run_index, r.spread) for r in runs),
        timed=timed_work(group.key, runs, unmet),
    )
    result = replace(result, notes=(*result.notes, *_warnings(result)))
    return result, known(group_runs.planar)


def _notes(group: Group[Run], runs: Sequence[Run], reference: Reference | Missing, sample_time: float) -> list[str]:
    notes = [*status_notes(group), *left_out(runs), *ends_early(runs)]
    sampled = next((r.positions.time for r in runs if r.positions), sample_time)
    if not math.isclose(sampled, sample_time, rel_tol=1e-9):
        notes.append(f"positions are those at {sampled:g} s, the step nearest to {sample_time:g} s")
    if isinstance(reference, Reference) and reference.run_id in {r.provenance.run_id for r in runs}:
        notes.append("the reference is one of this group's own runs, whose distance of zero is part of the mean")
    return notes


def _warnings(result: GroupResult) -> list[str]:
    """What the numbers themselves warn of."""
    notes = []
    sank = result.metrics["sank"]
    if not isinstance(sank.value, Missing) and sank.value:
        details = sank.of(SunkCubes)
        mean = f"{sank.value:.3g} of {details.cubes}"
        notes.append(
            f"bodies through the floor: {mean} per env by step {details.last_step}, the first at step "
            f"{details.first_step}"
        )
    fps = result.metrics["fps"]
    if not isinstance(fps.value, Missing) and (speeds := fps.of(Throughput).speeds):
        notes.append(speeds.note(fps.value))
    changed = result.metrics["capture_changes_states"]
    if not isinstance(changed.value, Missing) and changed.value:
        notes.append(
            f"timed and captured states differ at the same step in {changed.value:.0f} of {plural(changed.n, 'run')}, "
            "although the runs are bit-identical: either the timed steps did other work than the captured steps (then "
            "the throughput is not valid), or capturing changes the states; see how the adapter makes both"
        )
    notes += next((row.notes for row in result.fidelity.rows if row.check is Check.FINITE), ())
    if any(len(applied.sha256) > 1 for applied in result.validity.actions):
        notes.append("the runs were given different actions, so they differ by design")
    return notes
