"""Whether the steps of a group did the work that they are timed for: contacts, buffers, overflow, actions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gpusimbench.evaluator.missing import Claim, every
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.run import BitSummary, Run
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.provenance import MISPLACED_CONTACTS, Buffer, OverflowBit
from gpusimbench.schemas.text import plural

PHASES = ("capture", "timed")
"""In this order of preference: every captured step is counted, of the others the last of warm-up and timed phase."""

_ALL = "all"

NOTHING_TOLD = Claim(None, "no run tells of its overflow")


@dataclass(frozen=True)
class Counted:
    """What one counter shows, per step and environment, over the complete runs.

    mean   over environments, steps and runs
    p95    95th percentile over environments, mean over steps and runs
    max    of any environment at any step of any run
    phase  "capture" or "timed"
    rows   steps that were counted, all runs together
    n_run  that were counted
    """

    name: str
    meaning: str
    mean: float
    p95: float
    max: float
    phase: str
    rows: int
    n_run: int


@dataclass(frozen=True)
class BufferUse:
    """A capacity, and how much of it was needed at the fullest step of any run, complete or not.

    needed  None where no counter shows it; once a buffer is full, an engine may count no further
    share   needed / asked
    """

    buffer: Buffer
    needed: float | None

    @property
    def share(self) -> float | None:
        """needed / asked; None where either is not known."""
        return None if self.needed is None or not self.buffer.asked else self.needed / self.buffer.asked


@dataclass(frozen=True)
class OverflowSeen:
    """A bit that fired, over all runs, complete or not.

    fatal       contacts or constraints were dropped; None where simulation.json does not describe the bit
    rows        recorded steps at which it fired, all runs together
    envs        most environments with any bit at one of them
    n_run       runs in which it fired
    phase       of the first
    first_step  earliest step; without `first_step_exact`, the bit fired at this step or at any since the row before
    """

    name: str
    fatal: bool | None
    rows: int
    envs: int
    n_run: int
    phase: str
    first_step: int
    first_step_exact: bool


@dataclass(frozen=True)
class Misplaced:
    """Contacts outside of one of their two shapes, over the complete runs that count them.

    contacts  of all counted steps
    n_run     runs that have any
    of        runs that count them
    """

    contacts: int
    n_run: int
    of: int

    @property
    def said(self) -> str:
        """How many there are; empty where there is none."""
        number = plural(self.contacts, "misplaced contact", spec=",")
        return f"{number} in {self.n_run} of {plural(self.of, 'run')}" if self.n_run else ""


@dataclass(frozen=True)
class ActionsApplied:
    """The streams of actions of one phase, over the complete runs.

    generators  JSON, different ones
    sha256      of the actions of first and last step, different ones; more than one: the runs were not given the same
    verified    runs in which the engine held what it was given
    n_run       that said what they applied
    """

    phase: str
    generators: tuple[str, ...]
    sha256: tuple[tuple[str, str], ...]
    verified: int
    n_run: int


@dataclass(frozen=True)
class Validity:
    """Everything of this kind about one group.

    counted    by counter and phase: counters in the order of simulation.json
    buffers    in the order of simulation.json
    overflow   bits that fired; empty where none did, None where the engine does not tell
    actions    by phase; empty where the scene has none
    overflow_told  whether every run tells of its overflow
    misplaced  None where no complete run counts them
    """

    counted: tuple[Counted, ...]
    buffers: tuple[BufferUse, ...]
    overflow: tuple[OverflowSeen, ...] | None
    actions: tuple[ActionsApplied, ...]
    overflow_told: Claim = NOTHING_TOLD
    misplaced: Misplaced | None = None

    def of(self, name: str, *phases: str) -> Counted | None:
        """A counter in the first of these phases that has it; by default in order of PHASES."""
        found = {c.phase: c for c in self.counted if c.name == name}
        return next((found[phase] for phase in phases or PHASES if phase in found), None)


def validity_of(group: Group[Run]) -> Validity:
    """Read it from the group's recordings; DamagedRecording where one says what cannot be."""
    return Validity(
        counted=tuple(_counted(group.complete)),
        buffers=tuple(_buffers(group.recordings)),
        overflow=_overflow(group.recordings),
        actions=tuple(_actions(group.complete)),
        overflow_told=_overflow_told(group.complete),
        misplaced=_misplaced(group.complete),
    )


def _counted(runs: Sequence[Run]) -> Iterable[Counted]:
    meanings = {c.name: c.meaning for run in runs if run.simulation for c in run.simulation.counters}
    names = dict.fromkeys([*meanings, *(name for run in runs for by in run.counts.values() for name in by)])
    for name in names:
        for phase in PHASES:
            found = [by[name] for run in runs if name in (by := run.counts.get(phase, {}))]
            if found:
                yield Counted(
                    name,
                    meanings.get(name, ""),
                    mean=float(np.mean([c.mean for c in found])),
                    p95=float(np.mean([c.p95 for c in found])),
                    max=max(c.max for c in found),
                    phase=phase,
                    rows=sum(c.rows for c in found),
                    n_run=len(found),
                )


def _buffers(runs: Sequence[Run]) -> Iterable[BufferUse]:
    buffers = dict.fromkeys(buffer for run in runs if run.simulation for buffer in run.simulation.buffers)
    for buffer in buffers:
        having = [run for run in runs if run.simulation and buffer in run.simulation.buffers]
        needed = [
            counts.fullest_mean * run.configuration.n_env if buffer.per == _ALL else counts.max
            for run in having
            for by in run.counts.values()
            if (counts := by.get(buffer.counter)) is not None
        ]
        yield BufferUse(buffer, max(needed, default=None))


def _overflow(runs: Sequence[Run]) -> tuple[OverflowSeen, ...] | None:
    telling = [run for run in runs if run.overflows]
    if not telling:
        return None
    described: dict[int, OverflowBit] = {}
    for run in telling:
        described |= {bit.bit: bit for bit in (run.simulation.overflow_bits if run.simulation else ())}
    seen = gathered(
        (fired.bit, (fired, phase, overflows.spread, index))
        for index, run in enumerate(telling)
        for phase, overflows in run.overflows.items()
        for fired in overflows.bits
    )
    return tuple(_seen(described.get(bit), seen[bit]) for bit in sorted(seen))


def _overflow_told(runs: Sequence[Run]) -> Claim:
    telling = sum(bool(run.overflows) for run in runs)
    why_not = f"{telling} of {len(runs)} complete runs tell of their overflow" if runs else NOTHING_TOLD.why_not
    return every((True if run.overflows else None for run in runs), why_not)


def _misplaced(runs: Sequence[Run]) -> Misplaced | None:
    found = [
        sum(round(c.mean * run.configuration.n_env * c.rows) for c in counted)
        for run in runs
        if (counted := [by[MISPLACED_CONTACTS] for by in run.counts.values() if MISPLACED_CONTACTS in by])
    ]
    return Misplaced(sum(found), sum(map(bool, found)), len(found)) if found else None


def _seen(described: OverflowBit | None, found: Sequence[tuple[BitSummary, str, bool, int]]) -> OverflowSeen:
    first, phase, spread, _ = min(found, key=lambda one: one[0].first_step)
    return OverflowSeen(
        described.name if described else f"bit {first.bit}",
        described.fatal if described else None,
        rows=sum(fired.rows for fired, *_ in found),
        envs=max(fired.envs for fired, *_ in found),
        n_run=len({run for *_, run in found}),
        phase=phase,
        first_step=first.first_step,
        first_step_exact=not spread,
    )


def _actions(runs: Sequence[Run]) -> Iterable[ActionsApplied]:
    for phase in dict.fromkeys(phase for run in runs for phase in run.action_streams):
        found = [run.action_streams[phase] for run in runs if phase in run.action_streams]
        yield ActionsApplied(
            phase,
            tuple(dict.fromkeys(s.generator for s in found)),
            tuple(dict.fromkeys((s.first_sha256, s.last_sha256) for s in found)),
            verified=sum(s.verified for s in found),
            n_run=len(found),
        )
