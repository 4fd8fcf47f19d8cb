"""What is sampled during a run from threads of their own, memory and how fast the hardware could run, to messages."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import HardwareSampler, MemorySampler
from gpusimbench.schemas.messages import message_class


class SampleWriter:
    """Writes the readings of a sampler, between phases: the sink belongs to one thread."""

    def __init__(self, sink: Sink, sampler: MemorySampler | HardwareSampler) -> None:
        self._sink, self._sampler = sink, sampler
        for topic in sampler.topics:
            sink.channel(topic, sampler.message, sampler.metadata)

    def drain(self) -> None:
        """Write the readings since the last call."""
        message = message_class(self._sampler.message)
        with interruption.shielded():  # readings that were taken are written
            for topic, fields in self._sampler.take():
                self._sink.write(topic, message(**fields).SerializeToString())


class Sampling:
    """Both samplers of a run, and what writes their readings between phases."""

    def __init__(self, sink: Sink, gpus: Gpus) -> None:
        self._memory = MemorySampler(gpus)
        self._samplers = (self._memory, HardwareSampler(gpus))
        self._writers = [SampleWriter(sink, sampler) for sampler in self._samplers]

    def start(self) -> None:
        """Begin sampling."""
        for sampler in self._samplers:
            sampler.start()

    def stop(self) -> None:
        """End sampling."""
        for sampler in self._samplers:
            sampler.stop()

    def checkpoint(self, name: str) -> None:
        """Read all memory now, under the name of a checkpoint of the protocol."""
        self._memory.checkpoint(name)

    def use_allocator(self, read: Callable[[], tuple[int, int] | None] | None) -> None:
        """Read the engine's own allocator too, at checkpoints, from this thread; None: no more."""
        self._memory.allocator = read

    def enter(self, phase: str) -> None:
        """Readings from here on belong to this phase."""
        for sampler in self._samplers:
            sampler.phase = phase

    def leave(self) -> None:
        """Take one last reading of the phase, so that the shortest has one; what follows belongs to none."""
        for sampler in self._samplers:
            sampler.read_now()
            sampler.phase = ""

    def failures(self) -> list[str]:
        """How many readings failed and why the last did, one sentence for each sampler of which any did."""
        return [
            f"{s.failures} {s.what} readings failed, the last one: {s.last_failure}"
            for s in self._samplers
            if s.failures
        ]

    def drain(self) -> None:
        """Write the readings since the last call."""
        for writer in self._writers:
            writer.drain()
