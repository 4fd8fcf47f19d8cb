"""The comparison of two sets: the files of both, pairs, their findings, and verdicts for all of them at once."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.check.rules.findings import Protocol
from gpusimbench.evaluator.compare.counted import (
    all_alike,
    compare_arrays,
    compare_bits,
    compare_determinism,
    compare_mechanics,
    compare_misplaced,
    compare_validity,
)
from gpusimbench.evaluator.compare.episodes import compare_episodes
from gpusimbench.evaluator.compare.finding import FAILING, Change, Finding, Question, Settings, exit_code_of
from gpusimbench.evaluator.compare.matching import Pair, check_across, match, pooled, seed_by_seed, seeds_said
from gpusimbench.evaluator.compare.numbers import Schedule, compare_numbers, compared_by, schedule
from gpusimbench.evaluator.compare.outcome import (
    JOINT_OUTCOMES,
    compare_outcomes,
    compare_spread,
    distances,
    has_positions,
    joint_distances,
)
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import FileSet, Reader, Unreadable, without_copies
from gpusimbench.evaluator.inputs.sample_time import notes_on, read_sampled
from gpusimbench.evaluator.read import known_errors
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.results import growth
from gpusimbench.evaluator.results.group_runs import GroupRuns, Runs
from gpusimbench.evaluator.results.joint_metrics import JOINT_METRICS
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.timed_work import TimedWork, timed_work
from gpusimbench.evaluator.runs.groups import group, status_notes
from gpusimbench.evaluator.runs.memory import notes as cotenant_notes
from gpusimbench.evaluator.runs.memory import with_peers
from gpusimbench.evaluator.statistics.families import able_to_reject, holm
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place

FEW_RUNS = 6
"""With fewer runs a side, a warning: five can give p = 2/252 at best, which few comparisons at once exhaust."""


@dataclass(frozen=True)
class ComparedConfiguration:
    """One configuration of both sets.

    pair      its groups
    order     of its complete runs in time
    findings  in the order of the axes
    warnings  what a reader must know of how far the findings can be relied on
    notes     of runs that are not complete, and of those with another process on their GPU
    timed     what the throughputs of base and head were measured over
    """

    pair: Pair
    order: Schedule
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    timed: tuple[TimedWork, TimedWork] = (TimedWork(), TimedWork())


@dataclass(frozen=True)
class Result:
    """What the comparison of two sets found.

    compared    one for each configuration
    alone       groups without a partner: side, label, reason
    unreadable  side and file
    settings    what counts
    tests       statistical comparisons that count and could show something, which p-values are adjusted for; those of
                variability are a family of their own, and are not among them
    lost        recordings that were cut short or lost data
    notes       about the sets as a whole
    """

    compared: tuple[ComparedConfiguration, ...]
    alone: tuple[tuple[str, str, str], ...]
    unreadable: tuple[tuple[str, Unreadable], ...]
    settings: Settings
    tests: int
    lost: int
    notes: tuple[str, ...]

    @property
    def findings(self) -> list[Finding]:
        """The findings of all configurations."""
        return [finding for one in self.compared for finding in one.findings]

    @property
    def failing(self) -> list[Finding]:
        """Those that fail a gate."""
        return [finding for finding in self.findings if finding.fails(self.settings)]

    @property
    def comparable(self) -> bool:
        """Whether every configuration, and at least one, was compared on an axis that counts, beyond how runs ended."""
        return bool(self.compared) and all(
            any(
                f.change is not Change.NOT_COMPARED and counts(f.axis, self.settings)
                for f in one.findings
                if f.name != "complete_runs" or f.change in FAILING
            )
            for one in self.compared
        )

    @property
    def open(self) -> list[Finding]:
        """Those on an axis with a gate that neither fail nor pass."""
        return [finding for finding in self.findings if finding.undecided(self.settings)]

    @property
    def undecided(self) -> list[Axis]:
        """Axes with a gate on which some configuration is neither failed nor passed."""
        found = {finding.axis for finding in self.open}
        return [axis for axis in Axis if axis in found]

    @property
    def exit_code(self) -> ExitCode:
        """The exit code of gsb-compare."""
        lost = bool(self.unreadable or self.lost)
        return exit_code_of(failing=bool(self.failing), lost=lost, decided=self.comparable and not self.open)


def counts(axis: Axis, settings: Settings) -> bool:
    """Whether an axis decides."""
    return settings.expect_same or axis in settings.gates


def read_sides(
    base: Sequence[Place], head: Sequence[Place], reader: Reader, work: Work, across: Collection[str] = ()
) -> tuple[FileSet, FileSet]:
    """Read both sets; UsageError where a run is in both.

    across  what may differ between base and head, see `compare`; states of two scenes are sampled at one time
    """
    sampled = read_sampled([*base, *head], reader, work, together="scene" in across)
    one, other = (without_copies(sampled.files[place] for place in places) for places in (base, head))
    one = replace(one, notes=(*one.notes, *notes_on(sampled.shorter, sampled.time, (*one.runs, *other.runs))))
    ours = {file.provenance.run_id: file for file in one.runs}
    for file in other.runs:
        if same := ours.get(file.provenance.run_id):
            raise UsageError(
                f"{same.path} of base and {file.path} of head are one run, which tells nothing when it "
                "is compared with itself; record a second set"
            )
    return one, other


def compare(base: FileSet, head: FileSet, settings: Settings, work: Work, across: Collection[str] = ()) -> Result:
    """Compare two sets; UsageError where `across` names nothing that was asked for.

    across  names of options, or of matching.ACROSS, that may differ between base and head
    """
    runs = with_peers([*base.runs, *head.runs])
    read = [runs[: len(base.runs)], runs[len(base.runs) :]]
    sides = [group(side) for side in read]
    measured = sum(g.measured for side in sides for g in side)
    groups = [pooled([g for g in side if not g.measured]) for side in sides]
    check_across(across, [*groups[0], *groups[1]])
    matching = match(groups[0], groups[1], across)
    protocols = [Protocol(side) for side in read]
    drafts = [_draft(pair, protocols, settings, work) for pair in each(matching.pairs, "comparing configurations")]
    findings, tests = _answered([draft.items for draft in drafts], settings)
    notes = [*base.notes, *head.notes]
    if measured:
        notes.append("real trials are left out")
    return Result(
        tuple(_compared(draft, found, settings.alpha) for draft, found in zip(drafts, findings, strict=True)),
        matching.alone,
        tuple((name, u) for name, side in (("base", base), ("head", head)) for u in side.unreadable),
        settings,
        tests,
        sum(s.status == "incomplete" or bool(s.dropouts) for s in runs),
        tuple(notes),
    )


@dataclass(frozen=True)
class _Draft:
    pair: Pair
    base: Runs
    head: Runs
    order: Schedule
    items: tuple[Finding | _Asked, ...]
    timed: tuple[TimedWork, TimedWork]


@dataclass(frozen=True)
class _Asked:
    axis: Axis
    question: Question


def _draft(pair: Pair, protocols: Sequence[Protocol], settings: Settings, work: Work) -> _Draft:
    base, head = pair.base.complete, pair.head.complete
    one, other = (GroupRuns(runs, work=work) for runs in (base, head))
    items: list[Finding | _Asked] = []

    def add(axis: Axis, *found: Finding | Question | None) -> None:
        items.extend(item if isinstance(item, Finding) else _Asked(axis, item) for item in found if item is not None)

    def numbers(axis: Axis) -> None:
        for metric in compared_by(axis, base, head):
            add(axis, compare_numbers(metric, axis, one, other, settings, same_machine=pair.same_machine))

    for axis in (Axis.THROUGHPUT, Axis.MEMORY, Axis.BUILD):
        numbers(axis)
    add(Axis.PHYSICS, *compare_mechanics(base, head, certain=all_alike(one) and all_alike(other)))
    between, applies = distances(base, head, work), has_positions(base, head)
    joints = {unit: joint_distances(base, head, unit) for unit in JOINT_OUTCOMES}
    add(Axis.PHYSICS, compare_outcomes(between, settings, applies=applies))
    for unit, asked in JOINT_OUTCOMES.items():
        add(Axis.PHYSICS, compare_outcomes(joints[unit], settings, applies=True, asked=asked))
    add(Axis.VALIDITY, compare_validity(pair), compare_misplaced(base, head))
    numbers(Axis.VALIDITY)
    numbers(Axis.VARIABILITY)
    for metric in METRICS.values():
        if metric.axis is Axis.VARIABILITY and metric.values is None:
            of_joints = metric in JOINT_METRICS
            found = joints[metric.unit] if of_joints else between
            add(Axis.VARIABILITY, compare_spread(metric, found, settings, applies=applies or of_joints))

    def repeated(one: Runs, other: Runs) -> Sequence[Finding]:
        return compare_determinism(*(GroupRuns(runs, work=work) for runs in (one, other)))

    def bits(one: Runs, other: Runs) -> Sequence[Finding]:
        return [found for found in (compare_bits(one, other), compare_arrays(one, other)) if found]

    add(Axis.DETERMINISM, *seed_by_seed(base, head, repeated, Axis.DETERMINISM))
    add(Axis.BITS, *seed_by_seed(base, head, bits, Axis.BITS))
    for axis, item in compare_episodes(base, head, settings):
        add(axis, item)
    timed_base, timed_head = (
        timed_work(group, runs, protocol.of(group.recordings))
        for group, runs, protocol in zip((pair.base, pair.head), (base, head), protocols, strict=True)
    )
    return _Draft(pair, base, head, schedule(base, head), tuple(items), (timed_base, timed_head))


def _answered(drafts: Sequence[Sequence[Finding | _Asked]], settings: Settings) -> tuple[list[list[Finding]], int]:
    """Findings for all questions, their p-values adjusted for each other; and how many there were that count.

    Those that count are one family: the chance that any of them raises a false alarm is at most alpha. Of those that do
    not count, variability is a family of its own, which makes no other p-value larger.
    """
    asked = [item for draft in drafts for item in draft if isinstance(item, _Asked)]
    families: dict[tuple[bool, bool], list[_Asked]] = {}
    for item in asked:
        counted = counts(item.axis, settings)
        families.setdefault((counted, item.axis is Axis.VARIABILITY and not counted), []).append(item)
    verdicts: dict[int, Finding] = {}
    tests = 0
    for (counted, _), family in families.items():
        able = able_to_reject([a.question.least_p for a in family], settings.alpha)
        level = settings.alpha / max(sum(able), 1)
        found = [a.question(level, able=can) for a, can in zip(family, able, strict=True)]
        adjusted = iter(
            holm([1.0 if f.p_value is None else f.p_value for (f, _), can in zip(found, able, strict=True) if can])
        )
        for one, (shown, not_shown), can in zip(family, found, able, strict=True):
            p = next(adjusted) if can else None
            significant = p is not None and p <= settings.alpha
            verdicts[id(one)] = replace(shown if significant else not_shown, p_adjusted=p)
        tests += sum(able) if counted else 0
    return [[verdicts[id(i)] if isinstance(i, _Asked) else i for i in draft] for draft in drafts], tests


def _compared(draft: _Draft, findings: list[Finding], alpha: float) -> ComparedConfiguration:
    notes = [
        f"{name}: {note}"
        for name, side, runs in (("base", draft.pair.base, draft.base), ("head", draft.pair.head, draft.head))
        for note in (
            *status_notes(side),
            *growth.notes(runs),
            *known_errors.notes(side.recordings),
            *cotenant_notes(runs),
        )
    ]
    notes += seeds_said(draft.base, draft.head)
    if not draft.order.interleaved:
        findings = [replace(f, drift=_clocked(f)) for f in findings]
    return ComparedConfiguration(
        draft.pair, draft.order, tuple(findings), tuple(_warnings(draft, findings, alpha)), tuple(notes), draft.timed
    )  # fmt: skip


def _clocked(finding: Finding) -> bool:
    return finding.axis is Axis.THROUGHPUT and finding.p_value is not None


def _warnings(draft: _Draft, findings: Sequence[Finding], alpha: float) -> list[str]:
    order, pair = draft.order, draft.pair
    lines = []
    if not pair.same_machine:
        lines.append(
            "base and head were recorded on different machines: speed and memory are not compared; gsb-eval BASE HEAD "
            "shows both machines side by side"
        )
    clocked = any(map(_clocked, findings))
    if clocked and not order.known:
        lines.append(
            "the recordings do not say in which order they were made: drift of the machine cannot be told from a change"
        )
    elif clocked and not order.interleaved:
        lines.append(
            f"base and head were not recorded in turn ({order.text}): drift of the machine cannot be told from a change"
        )
    elif clocked and order.one_first and max(order.n) > 1:
        lines.append(f"one side always came first ({order.text}): a steady drift favours one; A B B A cancels it")
    if 0 < min(order.n) < FEW_RUNS:
        lines.append(
            f"few complete runs ({order.n[0]} of base, {order.n[1]} of head): record at least {FEW_RUNS} a side"
        )
    dts = [side.key.dt for side in (draft.pair.base, draft.pair.head)]
    if dts[0] != dts[1]:
        lines.append(
            "throughput is NOT comparable: it counts steps of {:g} s in base, and of {:g} s in head".format(*dts)
        )
    return [*timed.of_sides(*draft.timed), *lines, *_without_power(findings, alpha)]


def _without_power(findings: Sequence[Finding], alpha: float) -> list[str]:
    """Which comparisons could have shown nothing, whatever the runs had been."""
    found = gathered(
        ((f.tested_on, f.least_p), f.title) for f in findings if f.least_p is not None and f.p_adjusted is None
    )
    return [
        f"too few {units}{'' if least > alpha else ' for so many comparisons at once'} to show any change of "
        f"{', '.join(titles)}, however large (smallest p possible: {least:.2g})"
        for (units, least), titles in found.items()
    ]
