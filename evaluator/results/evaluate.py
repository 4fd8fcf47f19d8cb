"""From recordings to an Evaluation: groups, their metrics, sweeps, and what compares groups."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.protocol import Protocol, Unmet
from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.inputs.reader import DEFAULT_S, Reader, Unreadable
from gpusimbench.evaluator.inputs.sample_time import notes_on, read_sampled
from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.questions import Probed, answers
from gpusimbench.evaluator.read import known_errors
from gpusimbench.evaluator.read.addresses import expand
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results import growth
from gpusimbench.evaluator.results.canonical import laws
from gpusimbench.evaluator.results.convergence import convergences
from gpusimbench.evaluator.results.density_maps import reference_density, shared_map, with_cloud
from gpusimbench.evaluator.results.details import SunkCubes, Throughput
from gpusimbench.evaluator.results.determinism_cost import price_list
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.fidelity import fidelity
from gpusimbench.evaluator.results.group_runs import GroupRuns, Reference, ends_early, left_out
from gpusimbench.evaluator.results.identity_metrics import identical_steps
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.ranking import compare
from gpusimbench.evaluator.results.result import GroupResult, Map, RunSpread
from gpusimbench.evaluator.results.sweeps import accumulations, find_sweeps
from gpusimbench.evaluator.results.timed_work import timed_work
from gpusimbench.evaluator.results.validity import validity_of
from gpusimbench.evaluator.runs import memory
from gpusimbench.evaluator.runs.groups import Group, group, status_notes
from gpusimbench.evaluator.runs.labels import footnotes, labels, options_given
from gpusimbench.evaluator.runs.physics.facts import Check
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.toss_motion import (
    errors_of,
    local_errors_of,
    measured_tosses,
    set_every,
)
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import few, plural


@dataclass(frozen=True)
class _Found:
    """One group's result with what it was computed from."""

    result: GroupResult
    runs: tuple[Run, ...]
    planar: NDArray[np.float64] | None


def evaluate_files(paths: Iterable[Place], *, sample_time: float = DEFAULT_S) -> Evaluation:
    """Every metric of every group of some recordings, whose digests are taken on trust; see `evaluate`."""
    return evaluate(map(Reader(sample_time, verify=False), paths), sample_time=sample_time)


def read_and_evaluate(
    given: Sequence[Place], reader: Reader, *, reference: Place | None = None, work: Work = HERE
) -> tuple[Evaluation, list[Run]]:
    """Every metric of every group of some recordings, and the runs that could be read, copies too; see `evaluate`.

    given      paths, folders, addresses, or patterns of them
    reference  recording to compare with; its own error is raised where it cannot be read
    """
    places = expand(given)
    sampled = read_sampled([*places, *([reference] if reference else [])], reader, work)
    compared = sampled.files[reference] if reference else None
    if isinstance(compared, Unreadable):
        raise compared.error
    files = [sampled.files[place] for place in places]
    evaluation = evaluate(files, reference=compared, sample_time=sampled.time, shorter=sampled.shorter, work=work)
    return evaluation, [file for file in files if isinstance(file, Run)]


def evaluate(
    files: Iterable[Run | Unreadable],
    *,
    reference: Run | None = None,
    sample_time: float = DEFAULT_S,
    shorter: Mapping[str, float] | None = None,
    work: Work = HERE,
) -> Evaluation:
    """Every metric of every group.

    A file that could not be read is set aside and named; the others are evaluated without it.

    files        in any order; copies of one run count once
    reference    real trials, or a simulation to compare with; where None, the real trials among the files
    sample_time  simulated time that the files were read for [s]
    shorter      by scene, the time that those of this scene were read for instead: see inputs.sample_time
    work         where distances are computed
    """
    files = list(files)
    failures = [f for f in files if isinstance(f, Unreadable)]
    distinct, notes = without_copies([f for f in files if isinstance(f, Run)], failures)
    distinct = memory.with_peers(distinct)

    measured = [r for r in distinct if r.configuration.simulator == REAL]
    groups = [g for g in group(distinct) if not g.measured]
    targets, target, why_not, reference_note = _targets(reference, measured, [g.key.scene for g in groups], notes)
    times = {g.key.scene: (shorter or {}).get(g.key.scene, sample_time) for g in groups}
    notes += notes_on({scene: time for scene, time in times.items() if time != sample_time}, sample_time, distinct)
    if len({g.key.dt for g in groups}) > 1:
        notes.append("the recordings differ in dt, which changes the outcome: each dt is a group of its own")
    names = labels([g.key for g in groups], options_given(distinct))
    protocol = Protocol(distinct)
    if protocol.whole.count:
        notes.append(
            f"the recordings break rules of {PROTOCOL} {_times(protocol.whole.count)}: gsb-check --protocol names them"
        )
    if protocol.elsewhere and not all(run.of_program for run in distinct):
        named = ", ".join(protocol.elsewhere)
        notes.append(
            f"{PROTOCOL} is for the benchmark's own scenes; of {named}, only its rules on timed steps and evidence of "
            "work are asked, and only to rank throughputs"
        )
    found = [
        _evaluate_group(
            g, label, protocol.of(g.recordings), targets.get(g.key.scene) or Missing(why_not), times[g.key.scene], work
        )
        for g, label in each(list(zip(groups, names, strict=True)), "computing metrics of groups")
    ]
    if still := [f.result.label for f in found if f.runs and all(map(_is_still, f.runs))]:
        notes.insert(
            0, f"{few(still, 3)}: nothing moves, every captured state is that of the start; so these verdicts say "
            "nothing of how bodies move",
        )  # fmt: skip
    notes += _identical_groups(found)
    maps = _maps(found, target)
    results = tuple(
        replace(with_cloud(f.result, f.planar, maps.get(f.result.group.key.scene)), footnotes=notes_of)
        for f, notes_of in zip(found, footnotes([g.key for g in groups]), strict=True)
    )
    sweeps = find_sweeps(results)
    comparison = compare(results, sweeps, target)
    return Evaluation(
        sample_time=next(iter(times.values())) if len(set(times.values())) == 1 else sample_time,
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
        probed=_probed(distinct),
        convergences=convergences(results, times),
        shorter={scene: time for scene, time in times.items() if time != sample_time},
    )


def _probed(runs: Sequence[Run]) -> tuple[Probed, ...]:
    """What results depend on, of configurations of which some run was treated; states are read again."""
    treated = {_configuration(run) for run in runs if run.configuration.initial or run.configuration.intervention}
    among = arms_of([Recording(run.path) for run in runs if _configuration(run) in treated])
    probed = (Probed(arms, answers(arms)) for arms in among if arms.varied or arms.treated)
    return tuple(one for one in probed if any(found.answer is not Answer.NOT_ASKED for found in one.findings))


def _configuration(run: Run) -> tuple[str, ...]:
    c = run.configuration
    return c.simulator, c.scene, c.determinism


def _maps(found: Sequence[_Found], target: Reference | None) -> dict[str, Map]:
    """The map of each scene that has one."""
    by_scene = gathered((one.result.group.key.scene, one) for one in found)
    maps = {}
    for scene, ours in by_scene.items():
        board = next((run.board for one in ours for run in one.runs if run.board), None)
        if shared := shared_map([one.planar for one in ours], target, scene, board):
            maps[scene] = shared
    return maps


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


def _targets(
    given: Run | None, measured: Sequence[Run], scenes: Sequence[str], notes: list[str]
) -> tuple[dict[str, Reference], Reference | None, str, str]:
    """What is compared with what: the reference of each scene; that which stands for all; why there is none; in words.

    A reference that was given is that of every scene. Without one, each scene is compared with the only real trials of
    it among the files. Doubts are added to the notes.
    """
    of_scene = gathered((run.configuration.scene, run) for run in ([given] if given is not None else measured))
    found: dict[str, Reference] = {}
    reasons, said = [], []
    for scene, runs in of_scene.items():
        if len(runs) > 1:
            reasons.append(f"{len(runs)} recordings of real trials of {scene} are here: choose one with --reference")
            continue
        made, why_not = _use_reference(runs[0])
        if made is None:
            reasons.append(why_not)
            continue
        found[scene] = made
        said.append(
            f"{made.label} in {made.path.name}" if given is not None else f"the real trials in {made.path.name}"
        )
        if runs[0].doubt:
            notes.append(f"the reference {made.path.name}: {runs[0].doubt.text}")
    if not found:
        none = "no reference: give real trials or another recording with --reference"
        return {}, None, "; ".join(reasons) or none, "; ".join(reasons) or none
    main = next((found[scene] for scene in scenes if scene in found), next(iter(found.values())))
    # what a scene without trials of its own is compared with says that it is of another scene
    targets = {scene: found.get(scene, main) for scene in scenes}
    return targets, main, "", "; ".join([f"compared with {' and '.join(said)}", *reasons])


def _use_reference(run: Run) -> tuple[Reference | None, str]:
    name = run.path.name
    if run.status != "complete":
        return None, f"the reference {name} is {run.status}: {run.reason}"
    if run.dropouts:
        return None, f"the reference {name} lost data: {run.dropouts[0]}"
    c = run.configuration
    measured = c.simulator == REAL
    try:
        tosses = measured_tosses(Recording(run.path)) if measured else None
    except DamagedRecording as error:
        return None, f"the reference {name} cannot be used: {error}"
    if not isinstance(run.positions, Missing):
        planar = run.positions.planar
    elif tosses:  # each has an end of its own, whatever the sample time is
        planar = tosses.motion.position[-1][:, np.newaxis, :2]
    elif not isinstance(run.joints, Missing) and run.joints.any:
        planar = np.zeros((c.n_env, 0, 2))
    else:
        return None, f"the reference {name} cannot be used: {run.positions.reason}"
    if run.doubt and run.doubt.wrong:
        return None, f"the reference {name} cannot be used: {run.doubt.text}: record it again with --unit"
    label = tosses.name() if tosses else plural(len(planar), "real trial") if measured else ""
    label = label or f"{c.simulator} with {plural(c.n_env, 'env')}, dt {c.dt:g} s"
    return Reference(
        label, run.path, run.provenance.run_id, measured, c.scene, planar, tosses=tosses, joints=run.joints
    ), ""


def _toss_errors(
    runs: Sequence[Run], reference: Reference | Missing
) -> tuple[list[TossErrors | Missing], list[LocalErrors | Missing]]:
    """Errors of each run against measured tosses, over all of them and locally; states are read again."""
    if isinstance(reference, Missing) or reference.tosses is None:
        none = Missing(reference.reason if isinstance(reference, Missing) else "the reference has no tosses")
        return [none] * len(runs), [none] * len(runs)
    if any(run.configuration.scene != reference.scene for run in runs):
        none = Missing(f"the reference is of scene {reference.scene}")
        return [none] * len(runs), [none] * len(runs)
    errors: list[TossErrors | Missing] = []
    local: list[LocalErrors | Missing] = []
    for run in runs:
        recording = Recording(run.path)
        errors.append(errors_of(recording, reference.tosses))
        local.append(local_errors_of(recording, reference.tosses))
    return errors, local


def _evaluate_group(
    group: Group[Run],
    label: str,
    unmet: Unmet,
    reference: Reference | Missing,
    sample_time: float,
    work: Work,
) -> _Found:
    runs = group.complete
    errors = _toss_errors(runs, reference)
    if any(set_every(run.configuration) for run in runs):
        reference = Missing("the environments are set to the reference's states on the way")
    group_runs = GroupRuns(runs, reference, work, *errors)
    planar = group_runs.planar
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
    return _Found(result, runs, known(planar))


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


def _is_still(run: Run) -> bool:
    return not isinstance(run.histories, Missing) and run.histories.still


def _identical_groups(found: Sequence[_Found]) -> list[str]:
    # The same trajectories from other machines, versions or settings: what somebody who reproduces a result looks for.
    notes = []
    for index, one in enumerate(found):
        for other in found[index + 1 :]:
            count = identical_steps(one.runs, other.runs)
            if count:
                names = f"{one.result.label} and {other.result.label}"
                notes.append(f"{names}: all runs are bit-identical over their {count} common states")
    return notes
