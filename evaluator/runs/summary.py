"""What the evaluation knows of a recording once its file is closed: small, picklable, bounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusimbench.evaluator.check.protocol import unmet_by_file
from gpusimbench.evaluator.metrics.board import Board
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.evaluator.read.step_evidence import ActionStream, Overflows, StepCounts
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import Provenance, Simulation


@dataclass(frozen=True)
class CountSummary:
    """One counter of one phase, over its rows.

    mean          over environments and rows
    p95           95th percentile over environments, mean over rows
    max           of any environment at any row
    fullest_mean  largest mean over environments at any row
    rows          steps that were counted
    """

    mean: float
    p95: float
    max: float
    fullest_mean: float
    rows: int


@dataclass(frozen=True)
class BitSummary:
    """One overflow bit of one phase.

    rows        recorded steps at which it fired
    first_step  the first of them
    envs        most environments with any bit at one of them
    """

    bit: int
    rows: int
    first_step: int
    envs: int


@dataclass(frozen=True)
class OverflowSummary:
    """The bits of a phase that fired; `spread` says that a row stands for all steps since the row before."""

    bits: tuple[BitSummary, ...]
    spread: bool


@dataclass(frozen=True)
class Summary:
    """A recording as it says of itself, and what shows that its steps did their work; attributes as Recording has them.

    counts          by phase and name
    overflows       by phase; a phase that tells nothing is left out
    action_streams  what each phase applied, by phase
    board           of the scene; None without one, and where its description cannot be read
    unmet           rules of the benchmark's protocol that the file breaks by itself
    """

    path: Place
    status: str
    reason: str
    cause: str
    content_hash: str
    provenance: Provenance
    simulation: Simulation | None
    dropouts: tuple[str, ...]
    action_names: tuple[str, ...]
    counts: dict[str, dict[str, CountSummary]]
    overflows: dict[str, OverflowSummary]
    action_streams: dict[str, ActionStream]
    board: Board | None
    unmet: tuple[str, ...] = ()

    @property
    def configuration(self) -> RunConfiguration:
        """What was asked."""
        return self.provenance.configuration

    @property
    def fields(self) -> tuple[StateField, ...]:
        """The state fields, in recording order."""
        return self.simulation.fields if self.simulation else ()

    @property
    def usable(self) -> bool:
        """Whether metrics may be computed from it: the run ended well and nothing was lost."""
        return self.status == "complete" and not self.dropouts


def summarise(recording: Recording) -> Summary:
    """Read what a summary holds; DamagedRecording where one of its streams says what cannot be."""
    try:
        board = board_of(recording)
    except DamagedRecording:  # of a run that failed; one that metrics are computed from is read again, and named
        board = None
    return Summary(
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
        board=board,
        unmet=unmet_by_file(recording),
    )


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
