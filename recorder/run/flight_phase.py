"""The capture phase of a run that keeps failing environments alone: every environment steps, and few are written."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.flight import MOST, FlightWriter
from gpusimbench.recorder.capture.states import declare_fingerprints, write_fingerprints
from gpusimbench.recorder.capture.writing import CaptureClock
from gpusimbench.recorder.run.given_actions import begin_anew, prepare, write_applied
from gpusimbench.recorder.run.intervention import intervene
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.run.pace import Report
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.flight import AFTER, BEFORE, BLOCK_STEPS, RING_STEPS, Flight, Watch
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.treatment import Intervention, Keep


class FlightPhase:
    """Steps a simulator to the last step, and writes the states around the first failures.

    last_step  the last one made
    """

    def __init__(self, journal: Journal, configuration: RunConfiguration, progress: Report) -> None:
        self._journal = journal
        self._configuration = configuration
        self._progress = progress
        self.last_step = 0

    def run(self, simulator: Simulator, description: Description) -> None:
        """Step from the initial state; failed environments are a gate of the journal."""
        c, sink = self._configuration, self._journal.sink
        begin_anew(simulator, c)
        watch = watch_of(c, description)
        declare_fingerprints(sink, "capture")
        self._hash(simulator)
        bits = {bit.bit: bit.name for bit in description.overflow_bits}
        writer = FlightWriter(sink, watch, bits, n_env=c.n_env, dt=c.dt)
        flight = simulator.flight(watch)
        clock = CaptureClock()
        try:
            self._step(simulator, description, flight, writer, clock)
        except DataLost:
            raise
        except BaseException:
            with suppress(Exception):  # an engine that has failed may tell nothing more
                writer.finish(flight)
            raise
        self._hash(simulator)
        writer.finish(flight)
        clock.written()
        covers = (
            f"from block to block: steps, and what failed in them; the last {RING_STEPS} states are held on the "
            f"{flight.where}, {flight.held_bytes} bytes; of the first {MOST} environments that fail, {BEFORE} steps "
            f"before the failure and {AFTER} after it are copied and written"
        )
        self._journal.timing("capture", clock.blocks, 0, BLOCK_STEPS, covers)
        self._journal.timing("drain", clock.drain, c.steps, 1, "from the last block to the end of the phase's data")
        if writer.problem:
            self._journal.gate(*writer.problem)
        self._journal.ask_gates(simulator)
        write_applied(self._journal, simulator, c, 0, c.steps)

    def _step(
        self, simulator: Simulator, description: Description, flight: Flight, writer: FlightWriter, clock: CaptureClock
    ) -> None:
        c = self._configuration
        intervention = Intervention.of(c.intervention)

        def look(failures: NDArray[np.int64], last_step: int) -> None:
            if last_step:
                clock.arrive()
            self.last_step = last_step
            writer.look(flight, failures, last_step)

        def ready(first: int, count: int) -> None:
            interruption.check()
            self._progress("capture", first, c.steps)
            prepare(simulator, c, first, count)

        until = c.steps if intervention is None else intervention.step
        look(flight.failures(), 0)
        fly(flight, 0, until, ready, look)
        if intervention is not None:
            intervene(simulator, description.fields, intervention, c)
            fly(flight, until, c.steps, ready, look)

    def _hash(self, simulator: Simulator) -> None:
        c = self._configuration
        hashes = fingerprint(simulator.state())[np.newaxis]
        write_fingerprints(self._journal.sink, "capture", hashes, first_step=self.last_step, stride=1, dt=c.dt)


def fly(
    flight: Flight,
    first: int,
    last: int,
    prepare: Callable[[int, int], None],
    look: Callable[[NDArray[np.int64], int], None],
) -> None:
    """Make the steps from `first` to `last`, and look at each block.

    prepare  called before a block is begun, with its first step and their number
    look     called with the failures so far, and the last step that they are of
    """
    begun = first
    ahead: deque[int] = deque()  # last steps of blocks that were begun and not looked at
    while begun < last or ahead:
        if begun < last and len(ahead) < flight.ahead:
            count = min(BLOCK_STEPS, last - begun)
            prepare(begun, count)
            flight.begin(count)
            begun += count
            ahead.append(begun)
        else:
            look(flight.failures(), ahead.popleft())


def watch_of(configuration: RunConfiguration, description: Description) -> Watch:
    """What a run looks for in the states of a simulator that says this of itself."""
    origins = np.array(description.env_origins, dtype=np.float64) if description.env_origins else None
    fatal = sum(1 << bit.bit for bit in description.overflow_bits if bit.fatal)
    return Watch(description.fields, Keep.parse(configuration.keep).within, origins, fatal)
