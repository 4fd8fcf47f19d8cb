"""Memory readings of a run to messages."""

from __future__ import annotations

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
