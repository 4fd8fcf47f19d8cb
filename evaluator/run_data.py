"""What the metrics need of one run, read from its recording in one place.

Behind this, nothing reads a file: a recording that cannot be read is found out here, and the others go on without it.
"""

from __future__ import annotations

from dataclasses import dataclass

from evaluator.metrics.board import Board
from evaluator.metrics.memory import Checkpoints
from evaluator.positions import Positions, sample_positions
from evaluator.recording import Fingerprints, MemoryTrace, Recording
from schemas import checks
from schemas.errors import DamagedRecording


@dataclass(frozen=True)
class RunData:
    """One complete run.

    recording   that it was read from
    elapsed_s   of the timed phase [s]; None where it was left out
    gpu         memory of the device [byte]; None without a GPU
    host        memory of the process [byte]; None where it was not sampled
    captured    state hashes of the capture phase, or None
    timed       state hashes at the begin and end of the timed phase, or None
    positions   at the sample step; None where there are none, and `no_positions` says why
    board       of the scene, or None
    """

    recording: Recording
    elapsed_s: float | None
    gpu: Checkpoints | None
    host: Checkpoints | None
    captured: Fingerprints | None
    timed: Fingerprints | None
    positions: Positions | None
    no_positions: str
    board: Board | None


def read_run(recording: Recording, sample_time: float) -> RunData:
    """Read a run; DamagedRecording where the file does not hold what it should, whatever is wrong with it."""
    try:
        positions, no_positions = sample_positions(recording, sample_time)
        gpu = recording.memory.get("gpu0/device") if recording.provenance.gpus else None
        host = recording.memory.get("host")
        return RunData(
            recording=recording,
            elapsed_s=_elapsed(recording),
            gpu=_checkpoints(gpu) if gpu else None,
            host=_checkpoints(host) if host else None,
            captured=recording.fingerprints("capture"),
            timed=recording.fingerprints("timed"),
            positions=positions,
            no_positions=no_positions,
            board=board_of(recording),
        )
    except (ValueError, OverflowError, MemoryError) as error:
        raise DamagedRecording(f"{recording.path}: {str(error) or type(error).__name__}") from None


def _elapsed(recording: Recording) -> float | None:
    timing = recording.timing.get("timed")
    if timing is None:
        return None
    c = recording.configuration
    intervals = -(-c.timed_steps // max(timing.steps_per_interval, 1))  # the last one may be shorter
    if timing.steps_per_interval < 1 or len(timing.start_ns) != intervals:
        raise DamagedRecording(
            f"{recording.path}: {len(timing.start_ns)} intervals of {timing.steps_per_interval} steps were timed, "
            f"not the {c.timed_steps} steps that were asked for"
        )
    return timing.elapsed_s


def _checkpoints(trace: MemoryTrace) -> Checkpoints:
    baseline = trace.at("baseline")
    peak = trace.peak("timed")
    if peak is not None and baseline is not None:
        peak = max(peak, baseline)  # a monitor of a whole device also sees others release memory
    return Checkpoints(baseline, trace.at("post-init"), trace.at("post-warmup"), peak, trace.at("final"))


def board_of(recording: Recording) -> Board | None:
    """The board that the recording's scene names, None where it names none; DamagedRecording where it is unreadable."""
    scene = recording.scene
    name = scene.get("board")
    if not name:
        return None
    try:
        for body in checks.objects(scene, "bodies"):
            if body.get("name") == name:
                size = checks.vector(checks.mapping(body, "shape").get("size"), 3, "the board's size")
                centre = checks.vector(body.get("position"), 3, "the board's position")
                return Board(size, centre)
    except DamagedRecording as error:
        raise DamagedRecording(f"{recording.path}: {error}") from None
    raise DamagedRecording(f"{recording.path}: the scene has no body named {name!r}")
