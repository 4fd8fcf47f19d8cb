"""Clock rates and the like of a run to messages."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.hardware import HardwareSampler
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
