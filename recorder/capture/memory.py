"""Memory readings of a run to messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.memory import MemorySampler
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import message_class


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

    def start(self) -> None:
        """Begin sampling."""
        self._sampler.start()

    def stop(self) -> None:
        """End sampling."""
        self._sampler.stop()

    def checkpoint(self, name: str) -> None:
        """Read every source now, under the name of a checkpoint of the protocol."""
        self._sampler.checkpoint(name)

    def use_allocator(self, read: Callable[[], tuple[int, int] | None] | None) -> None:
        """Read the engine's own allocator too, at checkpoints, from this thread; None: no more."""
        self._sampler.allocator = read

    def enter(self, phase: str) -> None:
        """Readings from here on belong to this phase."""
        self._sampler.phase = phase

    def leave(self) -> None:
        """Take one last reading of the phase, so that the shortest has one; what follows belongs to none."""
        self._sampler.read_now()
        self._sampler.phase = ""

    def failures(self) -> str:
        """How many readings failed, and why the last did; empty when none."""
        count = self._sampler.failures
        return f"{count} memory readings failed, the last one: {self._sampler.last_failure}" if count else ""

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
