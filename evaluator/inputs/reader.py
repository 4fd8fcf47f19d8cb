"""From files to runs: each opened, checked, read and closed again; each run once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gpusimbench.evaluator.check.rules.findings import unmet_by_file
from gpusimbench.evaluator.compute.cache import Store
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.cotenants import CoTenants, cotenants
from gpusimbench.evaluator.metrics.levels import AxisVerdict, verdict
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.addresses import Stamp, stamp_of
from gpusimbench.evaluator.read.episodes import count_episodes
from gpusimbench.evaluator.read.evidence import Overflows, StepCounts
from gpusimbench.evaluator.read.failing import ONLY_FAILING
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of, extent_of_trials
from gpusimbench.evaluator.read.streams import Fingerprints, of_both_phases
from gpusimbench.evaluator.runs.growth import course_of
from gpusimbench.evaluator.runs.memory import allocator_peak, gpu_memory, host_memory
from gpusimbench.evaluator.runs.physics.depth import count_sunk
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.evaluator.runs.positions import Positions, outcome_of, sample_joints, sample_positions
from gpusimbench.evaluator.runs.run import BitSummary, CountSummary, OverflowSummary, Run
from gpusimbench.evaluator.runs.spread import spread
from gpusimbench.evaluator.runs.state_hashes import Histories, array_histories, histories_of
from gpusimbench.evaluator.runs.validation import LONGEST_S, NOT_TIMED, check_overflow, timed_of, verify
from gpusimbench.schemas.commands.progress import received, sizes
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, DamagedRecording, GsbError
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.tosses import TOSSES
from gpusimbench.schemas.trial_units import METRES, UnitDoubt, unit_doubt

DEFAULT_S = 5.0
"""Of scenes that are the benchmark's, and before a recording was read [s]."""


@dataclass(frozen=True)
class Unreadable:
    """A file that could not be opened or failed its checks, and why."""

    path: Place
    error: GsbError


@dataclass(frozen=True)
class Reader:
    """How files are read; a file that cannot be is a result too, so that the others are not lost with it.

    sample_time  simulated time at which positions are compared [s]; None: DEFAULT_S, but scenes that name another
                 sample time, or end before it, are read at theirs: see sample_time.py
    verify       whether every byte is read and held against the digests
    verified     stamps of files for which that was done before: a file that still has its stamp is not read as a whole
    """

    sample_time: float | None = None
    verify: bool = True
    verified: Mapping[Place, Stamp] = field(default_factory=dict)

    @property
    def time(self) -> float:
        """The simulated time at which positions are sampled [s]."""
        return DEFAULT_S if self.sample_time is None else self.sample_time

    def __call__(self, path: Place) -> Run | Unreadable:
        """Read one file, in memory that its size does not govern: see docs/scale.md."""
        stamp = stamp_of(path)
        try:
            recording = Recording(path)
            if self.verify and not (stamp and self.verified.get(path) == stamp):
                verify(recording)
            run = read_run(recording, self.time)
            return replace(run, unmet=unmet_by_file(recording), stamp=stamp)
        except GsbError as error:
            return Unreadable(path, error)


def read_run(recording: Recording, sample_time: float) -> Run:
    """Read an open recording; DamagedRecording where the file does not hold what it should.

    What is measured is read of a run that is complete and lost nothing. Rules are not asked.
    """
    run = _described(recording)
    if not run.usable:
        return run
    try:
        board_of(recording)  # of a run that failed, a board that cannot be read is no matter
        check_overflow(recording)
        return _measured(run, recording, sample_time)
    except NUMBERS_OF_A_STRANGER as error:
        raise DamagedRecording(f"{recording.path}: {str(error) or type(error).__name__}") from None


def _described(recording: Recording) -> Run:
    try:
        board = board_of(recording)
    except DamagedRecording:
        board = None
    return Run(
        path=recording.path,
        status=recording.status,
        reason=recording.reason,
        cause=recording.cause,
        content_hash=recording.content_hash,
        provenance=recording.provenance,
        simulation=recording.simulation,
        dropouts=recording.dropouts,
        action_names=recording.action_names,
        counts={
            phase: {name: _counted(counts) for name, counts in by_name.items()}
            for phase, by_name in recording.counts.items()
        },
        overflows={phase: _overflowed(overflows) for phase, overflows in recording.overflows.items()},
        action_streams=recording.action_streams,
        failing=recording.failing,
        board=board,
        named_time=_named_time(recording),
    )


def _measured(run: Run, recording: Recording, sample_time: float) -> Run:
    positions = sample_positions(recording, sample_time)
    sunk = count_sunk(recording)
    timing, timed = recording.timing, timed_of(recording)
    gpu = gpu_memory(recording)
    captured, of_timed = recording.fingerprints("capture"), recording.fingerprints("timed")
    if recording.configuration.keep:
        histories: Histories | Missing = Missing(ONLY_FAILING)  # hashes of the first state and the last are no history
    else:
        histories = histories_of(captured) if captured is not None else Missing(_no_hashes(recording))
    if captured is None:
        ends: Histories | Missing = histories_of(of_timed) if of_timed is not None else Missing("no states were hashed")
    else:
        ends = Missing("captured states tell more")
    return replace(
        run,
        elapsed_s=timed if isinstance(timed, Missing) else timed[1],
        timed_steps=timed if isinstance(timed, Missing) else timed[0],
        gpu=gpu,
        host=host_memory(recording),
        allocator=allocator_peak(recording),
        build_s=timing["build"].elapsed_s if "build" in timing else Missing("building was not clocked"),
        compile_s={p: timing[f"compile_{p}"].elapsed_s for p in ("timed", "capture") if f"compile_{p}" in timing},
        capture_s=timing["capture"].elapsed_s if "capture" in timing else Missing("the capture was not clocked"),
        stalled_s=timing["stall"].total_s if "stall" in timing else 0.0,
        histories=histories,
        timed_histories=ends,
        observed=_observed(of_timed, captured, recording.configuration.intervention),
        positions=positions,
        joints=sample_joints(recording, sample_time),
        reached=_reached(recording, sample_time),
        doubt=_doubt(recording, positions),
        equality=_equality(positions, histories),
        spread=spread(recording),
        sunk=sunk,
        physics=physics_of(recording, sunk),
        timed_from=timing["timed"].first_step if "timed" in timing else NOT_TIMED,
        cotenants=cotenants(gpu) if gpu else CoTenants(),
        episodes=count_episodes(recording) or Missing("no episodes of a task were recorded"),
        course=course_of(recording),
        arrays=array_histories(recording),
    )


def _no_hashes(recording: Recording) -> str:
    fields = recording.fields[:1]  # all have the same rows
    states = any(len(recording.state(field.group, field.field)) for field in fields)
    return "no state hashes were recorded" if states else "no states were captured"


def _named_time(recording: Recording) -> float | None:
    found = recording.scene.get("sample_time") if recording.usable else None
    return float(found) if isinstance(found, (int, float)) and 0 < found <= LONGEST_S else None


def _reached(recording: Recording, sample_time: float) -> bool:
    fields = recording.fields[:1]  # all have the same rows
    step = sampling_step(sample_time, recording.configuration.dt)
    return any(step in recording.state(field.group, field.field).steps for field in fields)


def _counted(counts: StepCounts) -> CountSummary:
    return CountSummary(
        mean=float(counts.mean.mean()),
        p95=float(counts.p95.mean()),
        max=float(counts.max.max()),
        fullest_mean=float(counts.mean.max()),
        rows=len(counts.steps),
    )


def _overflowed(overflows: Overflows) -> OverflowSummary:
    fired = int(np.bitwise_or.reduce(overflows.bits))
    return OverflowSummary(
        tuple(_bit(overflows, bit) for bit in range(32) if fired >> bit & 1), spread=overflows.stride > 1
    )


def _bit(overflows: Overflows, bit: int) -> BitSummary:
    hit = overflows.rows_of(bit)
    return BitSummary(bit, int(hit.sum()), int(overflows.steps[hit][0]), int(overflows.envs[hit].max()))


def _equality(positions: Positions | Missing, histories: Histories | Missing) -> AxisVerdict | Missing:
    if isinstance(positions, Missing):
        return positions
    if len(positions.recorded) < 2:
        return Missing("needs at least two environments")
    agree = histories.n_distinct == 1 if histories else None
    try:
        return verdict(positions.recorded[:, np.newaxis], hashes_agree=agree, origins=positions.origins)
    except ValueError as error:
        raise ValueError(f"environments: {error}") from None


def _doubt(recording: Recording, positions: Positions | Missing) -> UnitDoubt | None:
    if recording.configuration.simulator != REAL or isinstance(positions, Missing):
        return None
    fields = outcome_of(recording)
    extent = None if isinstance(fields, Missing) else extent_of_trials(recording, fields[0].group)
    options = recording.simulation.options if recording.simulation else {}
    unit, names = str(options.get("unit", "m")), options.get("trials")
    if extent is None or unit not in METRES or recording.attachment(TOSSES) is not None:
        return None
    planar = positions.planar
    if not isinstance(names, list) or len(names) != len(planar):
        names = [*range(len(planar))]
    return unit_doubt(planar, unit, [str(name) for name in names], extent)


def _observed(timed: Fingerprints | None, captured: Fingerprints | None, intervention: str) -> bool | Missing:
    steps, at_timed, at_captured = of_both_phases(timed, captured, intervention)
    if not len(steps):
        return Missing("no step was passed by both the timed and the capture phase")
    return bool((at_timed != at_captured).any())


@dataclass(frozen=True)
class KnownFiles:
    """What was read of files before, under the content hashes of their recordings.

    That a file has the content hash that it claims is found by verifying it, which takes far longer than all else. It
    is done once, and again whenever the file system says that the file is another one.
    """

    store: Store
    reader: Reader

    def find(self, path: Place) -> Run | None:
        """What was read of a file; None where it is not known, or may have changed."""
        stamp = stamp_of(path)
        if not stamp:
            return None
        content_hash = self.store.get(self.store.key(Stamp, stamp), str)
        run = self.store.get(self._key(content_hash, stamp), Run) if content_hash is not None else None
        return replace(run, path=path) if run is not None else None

    def keep(self, stamp: Stamp, run: Run) -> None:
        """Keep what was read and verified of a file: it had the stamp before, where it was read, and has it now."""
        if run.content_hash and run.stamp == stamp == stamp_of(run.path):
            self.store.put(self.store.key(Stamp, stamp), run.content_hash)
            self.store.put(self._key(run.content_hash, stamp), run)

    def _key(self, content_hash: str, stamp: Stamp) -> str:
        # of this very file: what the content hash does not cover, such as the cause of a failure, may be another's
        return self.store.key(Reader, [content_hash, stamp, self.reader.time])


def read_all(paths: Sequence[Place], reader: Reader, work: Work) -> Iterator[Run | Unreadable]:
    """Read files wherever the work is done, those that are not known, in order."""
    known = KnownFiles(work.store, reader) if work.store else None
    stamps = {path: stamp_of(path) for path in paths} if known else {}
    found: dict[Place, Run | Unreadable] = {path: old for path in paths if known and (old := known.find(path))}
    missing = [path for path in paths if path not in found]
    fresh = received(work.mapper(reader, missing), "reading recordings", len(missing), sizes(missing))
    for path in paths:
        if path in found:
            yield found[path]
            continue
        read = next(fresh)
        stamp = stamps.get(path)
        if known and stamp and reader.verify and isinstance(read, Run):
            known.keep(stamp, read)
        yield read


@dataclass(frozen=True)
class FileSet:
    """A set of files as they were read.

    runs        that could be read, each once
    unreadable  files that could not be read, and those that have the run id of another run
    notes       on copies, a sentence each
    """

    runs: tuple[Run, ...]
    unreadable: tuple[Unreadable, ...] = ()
    notes: tuple[str, ...] = ()


def without_copies(files: Iterable[Run | Unreadable]) -> FileSet:
    """Count each run once; a file that has the run id of another file, and another content, is unreadable."""
    files = list(files)
    runs: dict[str, Run] = {}
    unreadable = [file for file in files if isinstance(file, Unreadable)]
    notes: list[str] = []
    # of a whole file and one that was cut short, the whole one stays
    for run in sorted((file for file in files if isinstance(file, Run)), key=lambda run: run.status == "incomplete"):
        first = runs.setdefault(run.provenance.run_id, run)
        if first is run:
            continue
        if run.content_hash in (first.content_hash, ""):
            notes.append(f"{run.path.name} is a copy of {first.path.name}; it counts once")
        else:
            why = f"{run.path} has the run id of {first.path.name} and another content: one of them was changed"
            unreadable.append(Unreadable(run.path, DamagedRecording(why)))
    return FileSet(tuple(runs.values()), tuple(unreadable), tuple(notes))
