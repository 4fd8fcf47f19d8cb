"""Who stands where: groups of recordings as rows, in sections that can be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.results.cost_metrics import common_memory, ranked_throughput, shown_slower
from gpusimbench.evaluator.results.details import SunkCubes
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.faults import faults, faults_anywhere
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import Sweep, sweep_key
from gpusimbench.evaluator.runs.groups import GroupKey, is_instrument, shown_status
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.contents import BROKEN, Checkup
from gpusimbench.evaluator.share.leaderboard.reproduction import Replay, Reproduction, reproduction
from gpusimbench.schemas.configuration import TELLING, Settings, deciding
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

ELSEWHERE = "the same engine elsewhere"
"""What a reason begins with that is from another row of the same engine."""


@dataclass(frozen=True)
class Entry:
    """One recording of a row.

    name       of the file
    replay_of  content hash of what it replays; empty where it is no replay
    """

    name: str
    content_hash: str
    run_id: str
    status: str
    reason: str
    check: str
    findings: tuple[str, ...]
    deviations: tuple[str, ...]
    replay_of: str


@dataclass(frozen=True)
class Row:
    """One group.

    result        of the evaluation
    entries       its recordings
    reproduction  by replays among all recordings
    sweep         that it is a point of; None where it is in none
    place         in its section, from 1; None where it has none, and `place_missing` says why
    gates         what did not hold, a sentence each
    equals        place of the row above it, where its throughput is not shown to be lower than that of the row above;
                  else None
    """

    result: GroupResult
    entries: tuple[Entry, ...]
    reproduction: Reproduction
    sweep: Sweep | None
    place: int | None
    place_missing: str
    gates: tuple[str, ...]
    equals: int | None = None

    @property
    def key(self) -> GroupKey:
        """The key of the group."""
        return self.result.group.key

    @property
    def name(self) -> str:
        """Of the simulator with what tells it from others of its scene; without the number of environments."""
        return self.sweep.label if self.sweep else self.result.label

    @property
    def fps(self) -> Estimate:
        """Its throughput."""
        return self.result.metrics["fps"]

    @property
    def memory(self) -> Estimate:
        """Of the device; of the process on it, where another one was there in every run; of the host without a GPU."""
        return self.result.metrics[common_memory([self.result.metrics])]


@dataclass(frozen=True)
class Section:
    """What can be compared: one scene with one step on one device, timed over the same steps of the scene.

    scene_hash  of its description
    dt          [s]
    settings    that states depend on, such as how environments begin; empty: as the scene says
    rows        those with a place in their order, then the others
    """

    scene: str
    scene_hash: str
    device: str
    dt: float
    settings: Settings
    rows: tuple[Row, ...]

    @property
    def treatment(self) -> str:
        """The settings in words; empty where environments begin and stay as the scene says."""
        return ", ".join(f"{TELLING[name].title} {TELLING[name].words(value)}" for name, value in self.settings)

    @property
    def timed(self) -> str:
        """The timed steps, in words; empty where no row was timed."""
        return next((row.result.timed.said for row in self.rows if row.result.timed.windows), "")

    @property
    def ranked(self) -> tuple[Row, ...]:
        """Rows with a place."""
        return tuple(row for row in self.rows if row.place is not None)

    @property
    def points(self) -> tuple[Row, ...]:
        """Rows that are other points of a configuration with a place, by configuration and number of environments."""
        return tuple(row for row in self.rows if row.place is None and not row.place_missing)

    @property
    def unranked(self) -> tuple[Row, ...]:
        """Rows that cannot have a place."""
        return tuple(row for row in self.rows if row.place_missing)


def sections(
    evaluation: Evaluation, checkups: Mapping[str, Checkup], replays: Mapping[str, tuple[Replay, ...]]
) -> tuple[Section, ...]:
    """The groups of an evaluation as sections, by scene, device, settings that states depend on, and timed steps.

    A group without a throughput stands in the first section of its scene and device.

    checkups  by the path of the recording, as a text
    replays   by the content hash of what they replay
    """
    swept = {
        result.label: sweep
        for sweep in evaluation.sweeps
        for point in sweep.points
        for result in (point.result, *point.others)
    }
    found: dict[tuple[str, str, str, float, Settings], list[Row]] = {}
    for result in evaluation.results:
        key = result.group.key
        row = _row(result, evaluation.results, checkups, replays, swept.get(result.label))
        found.setdefault((key.scene, key.device, key.scene_hash, key.dt, deciding(key.settings)), []).append(row)
    return tuple(
        Section(scene, scene_hash, device, dt, settings, _placed(rows))
        for (scene, device, scene_hash, dt, settings), everything in sorted(found.items())
        for rows in _by_window(everything)
    )


def _by_window(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows that were timed over the same steps, the steps that most were timed over first."""
    found = gathered((row.result.timed.windows, row) for row in rows if row.result.timed.windows)
    parts = sorted(found.values(), key=len, reverse=True) or [[]]
    parts[0] += [row for row in rows if not row.result.timed.windows]
    return parts


def _row(
    result: GroupResult,
    results: Sequence[GroupResult],
    checkups: Mapping[str, Checkup],
    replays: Mapping[str, tuple[Replay, ...]],
    sweep: Sweep | None,
) -> Row:
    entries = tuple(_entry(one, checkups[str(one.path)]) for one in result.group.recordings)
    return Row(
        result=result,
        entries=entries,
        reproduction=reproduction(result.group.recordings, dict(replays)),
        sweep=sweep,
        place=None,
        place_missing=_no_place(result, results, entries),
        gates=tuple(_gates(result, entries)),
    )


def _entry(recording: Run, checkup: Checkup) -> Entry:
    of = recording.provenance.replay_of
    return Entry(
        name=recording.path.name,
        content_hash=recording.content_hash,
        run_id=recording.provenance.run_id,
        status=shown_status(recording),
        reason=recording.reason or next(iter(recording.dropouts), ""),
        check=checkup.outcome,
        findings=checkup.findings,
        deviations=checkup.deviations,
        replay_of=of.content_hash if of else "",
    )


def _no_place(result: GroupResult, results: Sequence[GroupResult], entries: Sequence[Entry]) -> str:
    if is_instrument(result.group.key):
        return "it says of itself that it is an instrument with known answers, and no engine"
    outcomes = result.group.outcomes
    if outcomes["invalid"]:
        reasons = dict.fromkeys(e.reason for e in entries if e.status.startswith("INVALID"))
        return f"{outcomes['invalid']} of {plural(len(entries), 'run')} INVALID: {'; '.join(reasons)}"
    if broken := [e for e in entries if e.check == BROKEN]:
        return f"breaks a rule of integrity-1: {broken[0].findings[0]}"
    if not result.group.complete:
        reasons = dict.fromkeys(f"{e.status}: {e.reason}" for e in entries)
        return "; ".join(reasons)
    if wrong := result.fidelity.of(CheckVerdict.BROKEN):
        sank = result.metrics["sank"]
        also = f" ({sunk:.3g} of {sank.of(SunkCubes).cubes})" if (sunk := known(sank.value)) else ""
        titles = "; ".join(row.check.title for row in wrong)
        said = f"states break mechanics ({result.fidelity.revision.value}): {titles}{also}"
        return "; ".join(filter(None, (said, faults(result).laws)))
    if wrong_of_group := faults(result).misplaced or faults(result).laws:
        return wrong_of_group
    fps = result.metrics["fps"]
    if isinstance(fps.value, Missing):
        return fps.value.reason
    if elsewhere := faults_anywhere(result, results):
        return f"{ELSEWHERE}: {'; '.join(elsewhere)}"
    return result.timed.unmet.of_throughput


def _gates(result: GroupResult, entries: Sequence[Entry]) -> list[str]:
    gates = list(dict.fromkeys(finding for entry in entries for finding in entry.findings))
    ended: dict[str, int] = {}
    for entry in entries:
        if entry.status != "complete":
            ended[entry.status] = ended.get(entry.status, 0) + 1
    gates += [f"{count} of {len(entries)} runs {status}" for status, count in ended.items()]
    changed, runs = result.metrics["capture_changes_states"], result.metrics["distinct_runs"]
    if known(changed.value) and runs.value == 1:  # of an engine that does not repeat itself it says nothing
        gates.append(f"timed and captured states differ in {words.count_of(changed)} runs")
    return gates


def _placed(rows: Sequence[Row]) -> tuple[Row, ...]:
    """The fastest point of each configuration gets a place, by throughput; equal throughput, equal place."""
    able = [row for row in rows if not row.place_missing and not isinstance(row.fps.value, Missing)]
    best: dict[GroupKey, Row] = {}
    for row in sorted(able, key=_speed):
        best.setdefault(sweep_key(row.key), row)
    ordered = list(best.values())
    speeds = [ranked_throughput(row.fps) for row in ordered]
    places = [speeds.index(speed) + 1 for speed in speeds]
    equal = [
        None,
        *(
            None if shown_slower(low.fps, high.fps) else at
            for (high, low), at in zip(pairwise(ordered), places, strict=False)
        ),
    ]
    placed = [replace(row, place=at, equals=other) for row, at, other in zip(ordered, places, equal, strict=False)]
    chosen = {row.result.label for row in ordered}
    others = [row for row in rows if row.result.label not in chosen]
    return (*placed, *(row for row in others if not row.place_missing), *(row for row in others if row.place_missing))


def _speed(row: Row) -> tuple[float, int, str]:
    return -ranked_throughput(row.fps), row.key.n_env, row.result.label


@dataclass(frozen=True)
class Board:
    """What is written.

    title        of the page
    sample_time  at which positions were compared [s]
    sections     by scene and device
    unreadable   names of files that nothing is computed from, and why
    notes        about the recordings as a whole: copies, groups that are the same bit for bit
    recordings   that count, each run once
    """

    title: str
    sample_time: float
    sections: tuple[Section, ...]
    unreadable: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    recordings: int

    @property
    def exit_code(self) -> ExitCode:
        """3 where a file is damaged, 5 where nothing has a place, else 0."""
        if self.unreadable:
            return ExitCode.DATA_LOST
        return ExitCode.OK if any(section.ranked for section in self.sections) else ExitCode.NOTHING_COMPARABLE
