"""Streams of one recording held against each other: what each of them alone cannot show."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import of_both_phases
from gpusimbench.evaluator.runs.validation import demands
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.provenance import LOGGED, REAL, SCENE
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.treatment import Intervention

_LEAST_READING_NS = 1_000  # no memory is read in less
_PHASE_OF = {"stall": "capture", "drain": "capture"}
"""Clocks whose phase has another name."""


def check_streams(recording: Recording, problems: Problems) -> None:
    """Read every stream, and compare what they say of the same thing."""
    for demand in demands(recording):
        with problems.noting(Kind.stream, path=recording.path):
            demand()
    for name in recording.action_names:
        with problems.noting(Kind.stream, path=recording.path):
            recording.check_actions(name)
    for kind, checks in _CHECKS.items():
        for check in checks:
            # what cannot be read is told above
            with problems.skipping(kind, path=recording.path):
                check(recording, problems)


def _event_clock(recording: Recording, problems: Problems) -> None:
    times = [event.monotonic_ns for event in recording.events]
    if any(later < earlier for earlier, later in zip(times, times[1:], strict=False)):
        problems.add(Kind.clock, "the clock of /run/event runs backwards")


def _sampled_clocks(recording: Recording, problems: Problems) -> None:
    memory = {f"/memory/{source}": trace.time_ns for source, trace in recording.memory.items()}
    hardware = {f"/hardware/{source}": trace.time_ns for source, trace in recording.hardware.items()}
    for topic, times in (memory | hardware).items():
        if (np.diff(times) < 0).any():
            problems.add(Kind.clock, f"the clock of {topic} runs backwards")


def _omitted_readings(recording: Recording, problems: Problems) -> None:
    for source, trace in recording.memory.items():
        between = np.diff(trace.time_ns, prepend=trace.time_ns[:1])
        for at in np.flatnonzero(trace.omitted).tolist():
            ends = {
                (trace.used_bytes[i], trace.phase[i], trace.checkpoint[i], *trace.others[i : i + 1])
                for i in (max(at - 1, 0), at)
            }
            if not at or len(ends) > 1 or trace.omitted[at] > between[at] / _LEAST_READING_NS:
                count = plural(int(trace.omitted[at]), "reading")
                left_out = f"{count} between it and the message before were left out as equal to both"
                problems.add(
                    Kind.contradiction, f"message {at + 1} of /memory/{source} says that {left_out}, which cannot be"
                )
                break


def _phases(recording: Recording, problems: Problems) -> None:
    spans = gathered(
        (event.phase, event.monotonic_ns) for event in recording.events if event.kind in ("PHASE_BEGIN", "PHASE_END")
    )
    for phase, span in spans.items():
        if len(span) != 2 and recording.status == "complete":
            problems.add(Kind.clock, f"phase {phase} has {len(span)} begins and ends, not one of each")
    for name, timing in recording.timing.items():
        span = spans.get(_PHASE_OF.get(name, name), [])
        if len(span) == 2 and not span[0] <= timing.start_ns[0] <= timing.end_ns[-1] <= span[1]:
            problems.add(Kind.clock, f"/timing/{name} is clocked outside of the phase {_PHASE_OF.get(name, name)}")


def _fingerprints(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    if recording.status != "complete" or c.simulator == REAL:
        return
    if "capture" in c.phases:
        found = recording.fingerprints("capture")
        if c.keep:
            missing_rows = sorted({0, c.steps} - set(() if found is None else found.steps.tolist()))
            if missing_rows:
                problems.add(Kind.fingerprint, f"the state of step {missing_rows[0]} has none")
            return
        # sorted, each once; how many steps were asked for is a stranger's number, and nothing of its size is made
        there = np.empty(0, dtype=np.int64) if found is None else found.steps[found.steps <= c.steps]
        there = there[there >= c.first_step]
        if missing := c.captured_steps + 1 - len(there):
            gaps = np.flatnonzero(there != c.first_step + np.arange(len(there)))
            first = c.first_step + (gaps[0] if len(gaps) else len(there))
            problems.add(
                Kind.fingerprint,
                f"{missing} of {c.captured_steps + 1} captured steps have none, the first is step {first}",
            )


def _observer(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    phases = recording.fingerprints("timed"), recording.fingerprints("capture")
    steps, timed, captured = of_both_phases(*phases, c.intervention)
    for step, row in zip(steps, timed != captured, strict=True):
        if row.any():
            where = f"step {step}, in {int(row.sum())} of {plural(len(row), 'environment')}"
            problems.add(Kind.observer, f"timed and captured states differ at {where}; level {c.determinism}")


def _status(recording: Recording, problems: Problems) -> None:
    if recording.status == "complete":
        if recording.reason:
            problems.add(Kind.contradiction, f"the run is complete, and has a reason not to be: {recording.reason}")
        if recording.simulation is None:
            problems.add(Kind.contradiction, "the run is complete, and its simulator was never built")
    elif recording.status in ("failed", "invalid") and not recording.reason:
        problems.add(Kind.contradiction, f"the run is {recording.status}, and no reason is given")


def _gates(recording: Recording, problems: Problems) -> None:
    for event in recording.events if recording.status == "complete" else ():
        if event.kind == "GATE":
            what = f"the run is complete, and a gate fired in phase {event.phase}: {event.text}"
            problems.add(Kind.contradiction, what)


def _intervals(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    if recording.status != "complete":
        return
    asked = {"warmup": c.warmup, "timed": c.timed_steps} if "timed" in c.phases else {}
    if recording.simulation is not None and recording.simulation.fresh_start == LOGGED:
        asked.pop("warmup", None)  # a program that is no adapter clocks the timed steps alone
    if "capture" in c.phases and "capture" in recording.timing:  # older files have none
        asked["capture"] = c.captured_steps
    for phase, steps in asked.items():
        timing = recording.timing.get(phase)
        spans = _capture_spans(c) if phase == "capture" else [steps]
        intervals = sum(-(-span // max(timing.steps_per_interval, 1)) for span in spans) if timing else 0
        found = len(timing.start_ns) if timing else 0
        wrong = timing.times_of(steps) is None if timing and phase == "timed" else found != intervals
        if wrong or (steps and timing is None):
            verb = {"warmup": "come first", "timed": "be timed", "capture": "be captured"}[phase]
            what = f"{steps} steps were to {verb}; there are clocks of {found} intervals"
            problems.add(Kind.contradiction, what)


def _capture_spans(c: RunConfiguration) -> list[int]:
    # steps between those after which the capture stops to save or to change the state: blocks end there
    done = Intervention.of(c.intervention)
    stops = {*c.snapshots, *(done.stops(c.steps) if done else ())}
    ends = sorted({c.first_step, c.steps, *(step for step in stops if c.first_step < step < c.steps)})
    return [end - begin for begin, end in pairwise(ends)]


def _states(recording: Recording, problems: Problems) -> None:
    c = recording.configuration
    if recording.status == "complete" and "capture" in c.phases and not c.keep:
        for field in recording.fields:
            steps = recording.state(field.group, field.field).steps
            if not len(steps) or steps[-1] != c.steps:
                end = f"end at step {steps[-1]}" if len(steps) else "are not there"
                problems.add(Kind.contradiction, f"states of {field.name} {end}; step {c.steps} was asked for")


def _scene(recording: Recording, problems: Problems) -> None:
    import hashlib

    claimed = recording.simulation.scene.get("sha256") if recording.simulation else ""
    text = recording.attachment(SCENE)
    if claimed and text is None:
        problems.add(Kind.contradiction, f"the scene that was simulated has a hash, and {SCENE} is not there")
    elif claimed and text is not None and hashlib.sha256(text).hexdigest() != claimed:
        problems.add(Kind.contradiction, f"{SCENE} is not the scene that simulation.json has the hash of")


def _varied(recording: Recording, problems: Problems) -> None:
    if recording.attachment(SCENE) is None:
        return  # a run that failed before it knew its scene
    try:
        _ = recording.varied
    except DamagedRecording as error:
        problems.add(Kind.contradiction, str(error).removeprefix(f"{recording.path}: "))


def _dropouts(recording: Recording, problems: Problems) -> None:
    for lost in recording.dropouts:
        problems.add(Kind.dropout, lost)


_CHECKS: dict[Kind, tuple[Callable[[Recording, Problems], None], ...]] = {
    Kind.clock: (_event_clock, _sampled_clocks, _phases),
    Kind.fingerprint: (_fingerprints,),
    Kind.observer: (_observer,),
    Kind.contradiction: (_omitted_readings, _status, _gates, _intervals, _states, _scene, _varied),
    Kind.dropout: (_dropouts,),
}
"""Comparisons by the kind that each finds; one that cannot be read to its end leaves the others as they are."""
