"""What is sampled during a run from threads of their own, memory and how fast the hardware could run, to messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.hardware import HardwareSampler
from gpusimbench.recorder.probes.memory import MemorySampler
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import message_class


class HardwareWriter:
    """Hardware readings of a run, written between phases: the sink belongs to one thread."""

    def __init__(self, sink: Sink, sampler: HardwareSampler, gpu_count: int) -> None:
        self._sink = sink
        self.sampler = sampler
        for topic in (topics.HARDWARE_HOST, *map(topics.gpu_hardware, range(gpu_count))):
            sink.channel(topic, "gsb.v1.HardwareSample", {"rate": "5 Hz"})

    def drain(self) -> None:
        """Write the readings since the last call."""
        sample: Any = message_class("gsb.v1.HardwareSample")
        with interruption.shielded():  # readings that were taken are written
            for reading in self.sampler.take():
                message = sample(
                    device=reading.device,
                    monotonic_ns=reading.monotonic_ns,
                    phase=reading.phase,
                    not_known=reading.not_known,
                    **reading.values,
                )
                self._sink.write(reading.topic, message.SerializeToString())


class MemoryWriter:
    """Memory readings of a run, written between phases: the sink belongs to one thread."""

    def __init__(self, sink: Sink, sampler: MemorySampler, gpu_count: int) -> None:
        self._sink = sink
        self._sampler = sampler
        metadata = {"unit": "byte", "rate": "100 Hz and at checkpoints"}
        sink.channel(topics.MEMORY_HOST, "gsb.v1.MemorySample", metadata)
        for index in range(gpu_count):
            for source in ("device", "process", "allocator"):
                sink.channel(topics.gpu_memory(index, source), "gsb.v1.MemorySample", metadata)

    def drain(self) -> None:
        """Write the readings since the last call."""
        sample: Any = message_class("gsb.v1.MemorySample")
        with interruption.shielded():  # readings that were taken are written
            for reading in self._sampler.take():
                message = sample(
                    source=reading.source,
                    device=reading.device,
                    monotonic_ns=reading.monotonic_ns,
                    used_bytes=reading.used_bytes,
                    total_bytes=reading.total_bytes,
                    phase=reading.phase,
                    checkpoint=reading.checkpoint,
                    other_processes=reading.other_processes,
                    other_bytes=reading.other_bytes,
                    reserved_bytes=reading.reserved_bytes,
                )
                self._sink.write(reading.topic, message.SerializeToString())


class Watch:
    """Both samplers of a run, and what writes their readings between phases."""

    def __init__(self, sink: Sink, gpus: Gpus) -> None:
        self._memory = MemorySampler(gpus)
        self._samplers = (self._memory, HardwareSampler(gpus))
        self._writers = (
            MemoryWriter(sink, self._memory, len(gpus)),
            HardwareWriter(sink, self._samplers[1], len(gpus)),
        )

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
