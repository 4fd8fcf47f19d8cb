"""Streams of one recording held against each other: what each of them alone cannot show."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from evaluator.integrity.problem import Kind, Problems
from evaluator.recording import Recording
from schemas.provenance import REAL, SCENE

_MAX_STEPS = 1 << 24
"""State hashes are expected for no more captured steps than that: no recording holds so many."""


def check_streams(recording: Recording, problems: Problems) -> None:
    """Read every stream, and compare what they say of the same thing."""
    reads: tuple[Callable[[], Any], ...] = (
        lambda: recording.timing,
        lambda: recording.memory,
        lambda: recording.counts,
        lambda: recording.overflows,
        lambda: recording.action_streams,
        lambda: recording.events,
        lambda: recording.dropouts,
        lambda: recording.scene,
        lambda: recording.fingerprints("capture"),
        lambda: recording.fingerprints("timed"),
        *((lambda name=name: recording.actions(name)) for name in recording.action_names),
        *((lambda field=field: recording.state(field.group, field.field)) for field in recording.fields),
    )
    for read in reads:
        with problems.noting(Kind.stream, path=recording.path):
            read()
    for check in (_clocks, _fingerprints, _observer, _contradictions, _dropouts):
        # what cannot be read is told above
        with Problems().noting(Kind.stream):
            check(recording, problems)


def _clocks(recording: Recording, problems: Problems) -> None:
    times = [event.monotonic_ns for event in recording.events]
    if any(later < earlier for earlier, later in zip(times, times[1:], strict=False)):
        problems.add(Kind.clock, "the clock of /run/event runs backwards")
    for source, trace in recording.memory.items():
        if (np.diff(trace.time_ns) < 0).any():
            problems.add(Kind.clock, f"the clock of /memory/{source} runs backwards")
    spans: dict[str, list[int]] = {}
    for event in recording.events:
        if event.kind in ("PHASE_BEGIN", "PHASE_END"):
            spans.setdefault(event.phase, []).append(event.monotonic_ns)
    for phase, span in spans.items():
        if len(span) != 2 and recording.status == "complete":
            problems.add(Kind.clock, f"phase {phase} has {len(span)} begins and ends, not one of each")
        timing = recording.timing.get(phase)
        if timing is not None and len(span) == 2 and not span[0] <= timing.start_ns[0] <= timing.end_ns[-1] <= span[1]:
            problems.add(Kind.clock, f"the steps of phase {phase} are clocked outside of the phase")


def _fingerprints(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    if recording.status != "complete" or c.simulator == REAL:
        return
    if "capture" in c.phases and c.steps < _MAX_STEPS:
        found = recording.fingerprints("capture")
        there = np.zeros(c.steps + 1, dtype=bool)
        if found is not None:
            there[found.steps[found.steps <= c.steps]] = True
        if not there.all():
            missing = np.flatnonzero(~there)
            problems.add(
                Kind.fingerprint,
                f"{len(missing)} of {c.steps + 1} captured steps have none, the first is step {missing[0]}",
            )


def _observer(recording: Recording, problems: Problems) -> None:
    timed, captured = recording.fingerprints("timed"), recording.fingerprints("capture")
    if timed is None or captured is None:
        return
    common, at_timed, at_captured = np.intersect1d(timed.steps, captured.steps, return_indices=True)
    differ = timed.hashes[at_timed] != captured.hashes[at_captured]
    for step, row in zip(common, differ, strict=True):
        if row.any():
            problems.add(Kind.observer, f"at step {step}, in {int(row.sum())} of {len(row)} environments")


def _contradictions(recording: Recording, problems: Problems) -> None:
    add = problems.add
    gates = [event for event in recording.events if event.kind == "GATE"]
    if recording.status == "complete":
        if recording.reason:
            add(Kind.contradiction, f"the run is complete, and has a reason not to be: {recording.reason}")
        for gate in gates:
            add(Kind.contradiction, f"the run is complete, and a gate fired in phase {gate.phase}: {gate.text}")
        described = recording.simulation.overflow_bits if recording.simulation else ()
        for phase, overflows in recording.overflows.items():
            if fatal := overflows.fatal(described):
                add(Kind.contradiction, f"the run is complete, and {fatal[0]} overflowed by step {fatal[1]} of {phase}")
        _complete(recording, problems)
    elif recording.status in ("failed", "invalid") and not recording.reason:
        add(Kind.contradiction, f"the run is {recording.status}, and no reason is given")
    _scene(recording, problems)


def _complete(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    if recording.simulation is None:
        problems.add(Kind.contradiction, "the run is complete, and its simulator was never built")
    timing = recording.timing.get("timed")
    if "timed" in c.phases:
        intervals = -(-c.timed_steps // max(timing.steps_per_interval, 1)) if timing else 0
        found = len(timing.start_ns) if timing else 0
        if timing is None or found != intervals:
            problems.add(
                Kind.contradiction, f"{c.timed_steps} steps were to be timed; there are clocks of {found} intervals"
            )
    if "capture" in c.phases:
        last = 1 if c.simulator == REAL else c.steps
        for field in recording.fields:
            steps = recording.state(field.group, field.field).steps
            if not len(steps) or steps[-1] != last:
                end = f"end at step {steps[-1]}" if len(steps) else "are not there"
                problems.add(Kind.contradiction, f"states of {field.name} {end}; step {last} was asked for")


def _scene(recording: Recording, problems: Problems) -> None:
    import hashlib

    claimed = recording.simulation.scene.get("sha256") if recording.simulation else ""
    text = recording.attachment(SCENE)
    if claimed and text is None:
        problems.add(Kind.contradiction, f"the scene that was simulated has a hash, and {SCENE} is not there")
    elif claimed and text is not None and hashlib.sha256(text).hexdigest() != claimed:
        problems.add(Kind.contradiction, f"{SCENE} is not the scene that simulation.json has the hash of")


def _dropouts(recording: Recording, problems: Problems) -> None:
    for lost in recording.dropouts:
        problems.add(Kind.dropout, lost)
