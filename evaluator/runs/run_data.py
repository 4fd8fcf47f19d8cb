"""What the metrics need of one run, read from its recording in one place.

Behind this, nothing reads a file: a recording that cannot be read is found out here, and the others go on without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusimbench.evaluator.metrics.capture import changes_states
from gpusimbench.evaluator.metrics.cotenants import BASELINE, CHECKPOINTS, TIMED, CoTenants, cotenants
from gpusimbench.evaluator.metrics.levels import Verdict, verdict
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of, extent_of_trials
from gpusimbench.evaluator.read.streams import Fingerprints, MemoryTrace, StepTiming
from gpusimbench.evaluator.runs.physics.facts import PhysicsFacts
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.evaluator.runs.positions import GROUP, Positions, sample_positions, was_recorded
from gpusimbench.evaluator.runs.sinking import Sunk, sunk
from gpusimbench.evaluator.runs.spread import Spread, spread
from gpusimbench.evaluator.runs.state_hashes import Histories, histories_of
from gpusimbench.evaluator.runs.summary import Summary
from gpusimbench.evaluator.runs.validation import NOT_TIMED, check_overflow, elapsed_of
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, DamagedRecording
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.trial_units import METRES, UnitDoubt, unit_doubt


@dataclass(frozen=True)
class RunData:
    """One complete run.

    recording   that it was read from, in summary
    elapsed_s   of the timed phase [s]
    gpu         memory of the device that steps [byte]; Missing also where the simulator ran on the CPU
    host        memory of the process [byte]
    allocator   peak of the engine's own device allocator up to the end of the timed phase [byte]
    build_s     import of the engine, loading, allocation [s]
    compile_s   compilation of what the timed phase runs, and of what the capture phase runs [s], by phase
    capture_s   from the first step of the capture to the last one's state on the host [s]
    stalled_s   part of that in which the engine stood still until states were written [s]
    histories   of the captured states by bits
    observed    whether capturing changed the states, by the hashes of steps that timed and capture phase both passed
    positions   at the sample step
    doubt       what speaks against the unit of real trials; None where nothing does, and of simulations
    reached     whether the sample step was recorded at all, whatever the positions are
    equality    of the environments, by bits and at the sample step
    spread      how the environments move apart
    physics     how far the states keep to mechanics
    sunk        cubes that went through the floor
    timed_from  steps of the scene that were made before the first timed one
    cotenants   other processes on that device, as far as the recordings it was read with tell
    """

    recording: Summary
    elapsed_s: float | Missing
    gpu: GpuMemory | Missing
    host: Checkpoints | Missing
    allocator: int | Missing
    build_s: float | Missing
    compile_s: dict[str, float]
    capture_s: float | Missing
    stalled_s: float
    histories: Histories | Missing
    observed: bool | Missing
    positions: Positions | Missing
    reached: bool
    doubt: UnitDoubt | None
    equality: Verdict | Missing
    spread: Spread | Missing
    sunk: Sunk | Missing
    physics: PhysicsFacts
    timed_from: int | Missing
    cotenants: CoTenants = CoTenants()


def read_run(recording: Recording, summary: Summary, sample_time: float) -> RunData:
    """Read a run; DamagedRecording where the file does not hold what it should, whatever is wrong with it."""
    try:
        board_of(recording)  # of a run that failed, a board that cannot be read is no matter
        check_overflow(recording)
        positions = sample_positions(recording, sample_time)
        through = sunk(recording)
        timing = recording.timing
        gpu = gpu_memory(recording)
        host = recording.memory.get("host")
        timed = recording.timing.get("timed")
        captured = recording.fingerprints("capture")
        histories = histories_of(captured) if captured is not None else Missing("no states were captured")
        return RunData(
            recording=summary,
            elapsed_s=elapsed_of(recording),
            gpu=gpu,
            host=_checkpoints(host, timed) if host else Missing("no memory of the process was sampled"),
            allocator=_allocator_peak(recording),
            build_s=timing["build"].elapsed_s if "build" in timing else Missing("building was not clocked"),
            compile_s={p: timing[f"compile_{p}"].elapsed_s for p in ("timed", "capture") if f"compile_{p}" in timing},
            capture_s=timing["capture"].elapsed_s if "capture" in timing else Missing("the capture was not clocked"),
            stalled_s=timing["stall"].total_s if "stall" in timing else 0.0,
            histories=histories,
            observed=_observed(captured, recording.fingerprints("timed")),
            positions=positions,
            reached=isinstance(positions, Positions) or was_recorded(recording, sample_time),
            doubt=_doubt(recording, positions),
            equality=_equality(positions, histories),
            spread=spread(recording),
            sunk=through,
            physics=physics_of(recording, through),
            timed_from=timed.first_step if timed else NOT_TIMED,
            cotenants=cotenants(gpu) if gpu else CoTenants(),
        )
    except NUMBERS_OF_A_STRANGER as error:
        raise DamagedRecording(f"{recording.path}: {str(error) or type(error).__name__}") from None


def _equality(positions: Positions | Missing, histories: Histories | Missing) -> Verdict | Missing:
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
    extent = extent_of_trials(recording, GROUP)
    options = recording.simulation.options if recording.simulation else {}
    unit, names = str(options.get("unit", "m")), options.get("trials")
    if extent is None or unit not in METRES:
        return None
    planar = positions.planar
    if not isinstance(names, list) or len(names) != len(planar):
        names = [*range(len(planar))]
    return unit_doubt(planar, unit, [str(name) for name in names], extent)


def _observed(captured: Fingerprints | None, timed: Fingerprints | None) -> bool | Missing:
    nothing_common = Missing("no step was passed by both the timed and the capture phase")
    if captured is None or timed is None:
        return nothing_common
    changed = changes_states(timed.steps, timed.hashes, captured.steps, captured.hashes)
    return nothing_common if changed is None else changed


def _allocator_peak(recording: Recording) -> int | Missing:
    trace = recording.memory.get("gpu0/allocator") if "timed" in recording.configuration.phases else None
    peak = trace.own_peak() if trace else None
    return Missing("the engine's allocator did not tell its peak") if peak is None else peak


def gpu_memory(recording: Recording) -> GpuMemory | Missing:
    """Memory of the device that a recording's simulator stepped on."""
    if not recording.provenance.gpus:
        return Missing("no GPU on the machine that recorded")
    if recording.simulation and recording.simulation.device == "cpu":
        return Missing("this simulator ran on the CPU")
    # recordings list the GPUs that CUDA shows, in its order, and engines step on the first of them
    device = recording.memory.get("gpu0/device")
    if device is None:
        return Missing("no memory of the GPU was sampled")
    timed = recording.timing.get("timed")
    own = recording.memory.get("gpu0/process")
    found = {name: device.most_others(checkpoint=name) for name in CHECKPOINTS}
    found[TIMED] = device.most_others(phase=TIMED)
    return GpuMemory(
        _checkpoints(device, timed),
        _checkpoints(own, timed) if own else None,
        {moment: Listing(*others) for moment, others in found.items() if others},
        device.reserved.get(BASELINE),
    )


def _checkpoints(trace: MemoryTrace, timing: StepTiming | None) -> Checkpoints:
    peak = None if timing is None else trace.peak("timed", int(timing.end_ns[-1]))
    return Checkpoints(trace.at("baseline"), trace.at("post-init"), trace.at("post-warmup"), peak, trace.at("final"))
