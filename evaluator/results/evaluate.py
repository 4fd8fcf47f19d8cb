"""From recordings to an Evaluation: groups, their metrics, sweeps, and what compares groups."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.rules.findings import Protocol, Unmet
from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.inputs.reader import DEFAULT_S, Reader, Unreadable, without_copies
from gpusimbench.evaluator.inputs.sample_time import notes_on, read_sampled
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.questions import Probed, answers
from gpusimbench.evaluator.read import known_errors
from gpusimbench.evaluator.read.addresses import expand
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results import growth
from gpusimbench.evaluator.results.canonical import laws
from gpusimbench.evaluator.results.convergence import Convergence, convergences
from gpusimbench.evaluator.results.density_maps import maps_of, reference_density, with_cloud
from gpusimbench.evaluator.results.details import SunkCubes, Throughput
from gpusimbench.evaluator.results.determinism_cost import Family, price_list
from gpusimbench.evaluator.results.fidelity import fidelity
from gpusimbench.evaluator.results.group_runs import GroupRuns, ends_early, left_out
from gpusimbench.evaluator.results.identity_metrics import identical_steps
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.ranking import Comparison, compare
from gpusimbench.evaluator.results.reference import Reference, references, toss_errors
from gpusimbench.evaluator.results.result import GroupResult, Map, RunSpread
from gpusimbench.evaluator.results.sweeps import Accumulation, Sweep, accumulations, find_sweeps
from gpusimbench.evaluator.results.timed_work import timed_work
from gpusimbench.evaluator.results.validity import Validity, validity_of
from gpusimbench.evaluator.runs import memory
from gpusimbench.evaluator.runs.groups import Group, GroupKey, group, status_notes
from gpusimbench.evaluator.runs.labels import footnotes, labels, options_given
from gpusimbench.evaluator.runs.physics.facts import Check
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.toss_motion import set_every
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.text import few, plural


@dataclass(frozen=True)
class Evaluation:
    """The result of evaluating a set of recordings.

    sample_time  simulated time at which positions are compared [s]; of most scenes, where it differs
    results      one per group
    unreadable   files that could not be read, with their errors
    reference    None where there is none; `reference_note` says why, or where it came from
    sweeps       groups that differ in the number of environments alone
    accumulation how variability of sweeps goes with the number of environments
    comparison   of simulators: radar and guidelines
    maps         by scene; none for a scene whose positions were not recorded or lie too far apart
    price_list   what levels of determinism cost
    unmet        rules of the benchmark's protocol that the recordings do not meet
    notes        about the set as a whole
    shorter      by scene, the time at which positions are compared instead of `sample_time` [s]: no recording of the
                 scene is as long
    probed       what results depend on, of configurations whose runs answer a question of gsb-probe
    convergences  of groups that differ in the time step alone: how fast states approach those of the finest step
    """

    sample_time: float
    results: tuple[GroupResult, ...]
    unreadable: tuple[Unreadable, ...]
    reference: Reference | None
    reference_note: str
    sweeps: tuple[Sweep, ...]
    accumulation: tuple[Accumulation, ...]
    comparison: Comparison
    maps: dict[str, Map]
    notes: tuple[str, ...] = ()
    price_list: tuple[Family, ...] = ()
    unmet: Unmet = Unmet()
    shorter: Mapping[str, float] = field(default_factory=dict)
    probed: tuple[Probed, ...] = ()
    convergences: tuple[Convergence, ...] = ()

    @property
    def of_programs(self) -> bool:
        """Whether programs logged all recordings: there no real trials and no protocol are to be expected."""
        return all(run.of_program for result in self.results for run in result.group.recordings)

    @property
    def placed(self) -> bool:
        """Whether states of bodies or joints were captured, and not arrays of a task alone."""
        groups = [result.group for result in self.results if result.group.captured]
        return any(field.group != ENV for group in groups for run in group.recordings for field in run.fields)

    @property
    def of_bodies(self) -> bool:
        """Whether where bodies end can be asked: not of tasks, of which programs logged arrays alone."""
        return self.placed or not self.of_programs

    @property
    def timed(self) -> bool:
        """Whether some run was timed."""
        runs = (run for result in self.results for run in result.group.recordings)
        return any("timed" in run.configuration.phases for run in runs)

    def sampled_at(self, scene: str) -> float:
        """Simulated time at which positions of a scene are compared [s]."""
        return self.shorter.get(scene, self.sample_time)

    def sampled(self) -> str:
        """When positions are compared, in words: each time of any scene, such as "t = 1 and 5 s"."""
        times = sorted({self.sampled_at(result.group.key.scene) for result in self.results} or {self.sample_time})
        return f"t = {' and '.join(f'{time:.4g}' for time in times)} s"


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
    validity = validity_of(group)
    doubts = (*growth.notes(runs), *known_errors.notes(group.recordings), *_misplaced(validity))
    result = GroupResult(
        group=group,
        label=label,
        metrics={name: metric.estimate(group_runs) for name, metric in METRICS.items()},
        cloud=None,
        validity=validity,
        fidelity=fidelity(label, [run.physics for run in runs]),
        laws=laws(label, [run.physics for run in runs]),
        notes=(*_notes(group, runs, reference, sample_time), *doubts, *memory.notes(runs)),
        doubts=doubts,
        spreads=tuple(RunSpread(r.configuration.run_index, r.spread) for r in runs),
        timed=timed_work(group, runs, unmet),
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


def _misplaced(validity: Validity) -> list[str]:
    said = validity.misplaced.said if validity.misplaced else ""
    return [f"{said}: each lies outside of one of its two bodies, so the states after it are wrong"] if said else []


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
    given = without_copies(files)
    runs = memory.with_peers(given.runs)
    groups = [g for g in group(runs) if not g.measured]
    keys = [g.key for g in groups]
    compared = references(reference, runs, [key.scene for key in keys])
    times = {key.scene: (shorter or {}).get(key.scene, sample_time) for key in keys}
    shortened = {scene: time for scene, time in times.items() if time != sample_time}
    protocol = Protocol(runs)
    labelled = list(zip(groups, labels(keys, options_given(runs)), strict=True))
    found = [
        evaluate_group(g, label, protocol.of(g.recordings), compared.of(g.key.scene), times[g.key.scene], work)
        for g, label in each(labelled, "computing metrics of groups")
    ]
    planar = {result.label: positions for result, positions in found}
    maps = maps_of([result for result, _ in found], planar, compared.main)
    results = tuple(
        replace(with_cloud(result, positions, maps.get(result.group.key.scene)), footnotes=on_label)
        for (result, positions), on_label in zip(found, footnotes(keys), strict=True)
    )
    sweeps = find_sweeps(results)
    comparison = compare(results, sweeps, compared.main)
    return Evaluation(
        sample_time=next(iter(times.values())) if len(set(times.values())) == 1 else sample_time,
        results=results,
        unreadable=given.unreadable,
        reference=reference_density(compared.main, maps.get(compared.main.scene)) if compared.main else None,
        reference_note=compared.said,
        sweeps=sweeps,
        accumulation=accumulations(sweeps, planar, work),
        comparison=comparison,
        maps=maps,
        notes=(
            *_still(results),
            *given.notes,
            *compared.doubts,
            *notes_on(shortened, sample_time, runs),
            *_several_dt(keys),
            *_protocol_notes(protocol, runs),
            *_identical_groups(results),
            *comparison.notes,
        ),
        price_list=price_list(results),
        unmet=protocol.whole,
        probed=_probed(runs),
        convergences=convergences(results, times),
        shorter=shortened,
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


def _still(results: Sequence[GroupResult]) -> Iterator[str]:
    still = [r.label for r in results if r.group.complete and all(map(_is_still, r.group.complete))]
    if still:
        yield (
            f"{few(still, 3)}: nothing moves, every captured state is that of the start; so these verdicts say "
            "nothing of how bodies move"
        )


def _is_still(run: Run) -> bool:
    return not isinstance(run.histories, Missing) and run.histories.still


def _several_dt(keys: Sequence[GroupKey]) -> Iterator[str]:
    if len({key.dt for key in keys}) > 1:
        yield "the recordings differ in dt, which changes the outcome: each dt is a group of its own"


def _protocol_notes(protocol: Protocol, runs: Sequence[Run]) -> Iterator[str]:
    if count := protocol.whole.count:
        times = "once" if count == 1 else f"{count} times"
        yield f"the recordings break rules of {PROTOCOL} {times}: gsb-check --protocol names them"
    if protocol.elsewhere and not all(run.of_program for run in runs):
        yield (
            f"{PROTOCOL} is for the benchmark's own scenes; of {', '.join(protocol.elsewhere)}, only its rules on "
            "timed steps and evidence of work are asked, and only to rank throughputs"
        )


def _identical_groups(results: Sequence[GroupResult]) -> Iterator[str]:
    # The same trajectories from other machines, versions or settings: what somebody who reproduces a result looks for.
    for one, other in combinations(results, 2):
        if count := identical_steps(one.group.complete, other.group.complete):
            yield f"{one.label} and {other.label}: all runs are bit-identical over their {count} common states"
