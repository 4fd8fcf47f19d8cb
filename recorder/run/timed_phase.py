"""The warm-up and the timed phase: steps between clock readings, and nothing else.

Between two clock readings lies what the simulator says of it (Description.timing_covers). From the first reading to the
last, memory is sampled as well, at 100 Hz, and clock rates of the hardware at 5 Hz, both from other threads; nothing is
written, drawn or reported meanwhile, and Python collects no garbage. An interval has `timing_interval` steps; the last
may have fewer.

Windows: a pause of the system is a large part of a short timed phase. Where the timed steps take less than a second,
environments are brought back to their initial states, make the warm-up again, and the same steps are timed once more,
until the windows together take a second. What is counted and hashed is of the first window; gates are asked after all.

A step that returns before the device is done would be timed as fast as work is queued. The first reading of the state
has to wait for such work: how much longer it takes than a reading with no work to wait for is held against the clocks.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.evidence import MOVING, EvidenceWriter, with_motion
from gpusimbench.recorder.capture.samples import Sampling
from gpusimbench.recorder.capture.states import declare_fingerprints, write_fingerprints
from gpusimbench.recorder.run.engine import Engine
from gpusimbench.recorder.run.given_actions import given, write_applied
from gpusimbench.recorder.run.journal import Journal, Phase
from gpusimbench.recorder.run.pace import Report
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fingerprint import fingerprint

ENOUGH_S = 1.0
"""Time [s] that all windows together should take."""

LEAST_STEPS = 100
"""Windows of fewer steps are not timed again: they are tries, and break the protocol anyway."""

_PATIENCE = 30
"""Windows are timed again for at most so many times ENOUGH_S by the clock, initial states and warm-ups included."""

LATE_S = 0.5
LATE_SHARE = 0.5
"""Work that goes on behind the last clocks of the windows makes a run INVALID where it takes longer than both: the time
[s], and this share of the time of the windows. A pause of the system while a state is read is shorter."""

_SAMPLED = "memory is sampled from another thread at 100 Hz, clock rates from another at 5 Hz"


def warm_up_and_time(
    journal: Journal,
    sampling: Sampling,
    engine: Engine,
    description: Description,
    configuration: RunConfiguration,
    progress: Report,
) -> None:
    """Step through both phases; what speaks against them is noted as gates of the journal."""
    sink, warmup, steps = journal.sink, configuration.warmup, configuration.timed_steps
    simulator = engine.simulator
    covers = f"{description.timing_covers}; {_SAMPLED}"
    interval = simulator.timing_interval
    counted = EvidenceWriter(
        sink, description, "timed", dt=configuration.dt, stride=max(1, steps), counters=(*description.counters, MOVING)
    )
    # The whole warm-up's clocks are kept too: its first step shows what compilation costs.
    with Phase(journal, sampling, "warmup"):
        simulator.prepare(given(simulator, configuration, 0, warmup))
        progress("warmup", 0, warmup)
        gc.collect()  # takes a good part of a second with some engines, so not before each window
        clocks = _step(simulator, warmup, interval)
        begun = simulator.state()  # compiles what reading a state needs
        late = _Late()
        hashes = [fingerprint(begun)]
        sampling.checkpoint("post-warmup")
    journal.timing("warmup", clocks, 0, interval, covers)
    if warmup:
        journal.count(with_motion(simulator.evidence(), description.fields, begun), counted, warmup)
    journal.ask_gates(simulator)
    simulator.prepare(given(simulator, configuration, warmup, steps))
    with Phase(journal, sampling, "timed"):
        progress("timed", 0, steps)  # and not again before the last step: throughput counts what lies between
        clocks = _step(simulator, steps, interval)
        state = late.state(simulator, clocks, journal)
        hashes.append(fingerprint(state))
        journal.timing("timed", clocks, warmup, interval, covers)
        # Two hashes at steps that the capture may pass as well: equal ones show that both made the same states.
        declare_fingerprints(sink, "timed")
        write_fingerprints(sink, "timed", np.stack(hashes), first_step=warmup, stride=steps, dt=configuration.dt)
        _ask_finite(journal, state, configuration)
        journal.count(with_motion(simulator.evidence(), description.fields, state), counted, warmup + steps)
        journal.ask_gates(simulator)
        write_applied(journal, simulator, configuration, warmup, steps)
        for again in () if journal.fired else _timed_again(engine, configuration, clocks):
            journal.timing("timed", again, warmup, interval, covers)
            if evidence := simulator.evidence():
                for fired in counted.overflowed(evidence, first_step=warmup + steps):
                    journal.gate(fired, "BUFFER")
            _ask_finite(journal, late.state(simulator, again, journal), configuration)
            journal.ask_gates(simulator)
            if journal.fired:
                break  # the run is INVALID, whatever else is timed


class _Late:
    """Work of the timed steps that went on behind the last clocks of their windows."""

    def __init__(self) -> None:
        self._waits_s: list[float] = []  # of each window, by how much the first reading took longer than another
        self._timed_s = 0.0

    def state(self, simulator: Simulator, clocks: NDArray[np.int64], journal: Journal) -> States:
        """The present state, read directly behind a window with these clocks; a gate fires where too much is late."""
        begun = time.perf_counter()
        state = simulator.state()
        read = time.perf_counter()
        simulator.state()  # with nothing to wait for
        self._waits_s.append((read - begun) - (time.perf_counter() - read))
        self._timed_s += _seconds(clocks)
        # the median: of a thousand short windows, readings that a pause made longer would add up
        late_s = statistics.median(self._waits_s) * len(self._waits_s)
        if late_s > max(LATE_S, LATE_SHARE * self._timed_s):
            journal.gate(
                f"the device went on for {late_s:.3g} s after {self._timed_s:.3g} s of timed steps: step() "
                "returns before the device is done, so the clocks do not cover the work; synchronise in the "
                "adapter's step()"
            )
        return state


def _timed_again(
    engine: Engine, configuration: RunConfiguration, first: NDArray[np.int64]
) -> Iterator[NDArray[np.int64]]:
    """Clocks of further windows of the same steps, until all take ENOUGH_S; `first` has those of the first window."""
    warmup, steps, simulator = configuration.warmup, configuration.timed_steps, engine.simulator
    if steps < LEAST_STEPS or not engine.can_begin_again:
        return
    began, elapsed_s = time.perf_counter(), _seconds(first)
    while elapsed_s < ENOUGH_S and time.perf_counter() - began < _PATIENCE * ENOUGH_S:
        engine.begin_again()
        simulator.prepare(given(simulator, configuration, 0, warmup))
        _step(simulator, warmup, simulator.timing_interval)
        simulator.prepare(given(simulator, configuration, warmup, steps))
        clocks = _step(simulator, steps, simulator.timing_interval)
        elapsed_s += _seconds(clocks)
        yield clocks


def _seconds(clocks: NDArray[np.int64]) -> float:
    return float(clocks[1, -1] - clocks[0, 0]) * 1e-9


def _ask_finite(journal: Journal, state: States, configuration: RunConfiguration) -> None:
    if all(np.isfinite(array).all() for array in state):
        return
    found = ""
    if "capture" not in configuration.phases:
        found = ": --phases capture --keep failing tells which environment fails first, and keeps the steps before"
    journal.gate(f"a state is not finite after {configuration.timed_steps} timed steps{found}", "NOT_FINITE")


def _step(simulator: Simulator, steps: int, interval: int) -> NDArray[np.int64]:
    count = -(-steps // interval)
    clocks = np.empty((2, count), dtype=np.int64)
    clock = time.perf_counter_ns
    gc.disable()  # a collection inside the timed loop would be charged to the engine
    try:
        for k in range(count):
            clocks[0, k] = clock()
            simulator.step(min(interval, steps - k * interval))
            clocks[1, k] = clock()
    finally:
        gc.enable()
    return clocks
