"""Memory readings during a run, from a thread of their own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import Reading, Sampler
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import enum_values

INTERVAL_S = 0.01

BASELINE = "baseline"
"""The phase in which nothing of the engine exists."""


@dataclass
class _Alike:
    """Readings of one topic that are equal in all but the clock to the last that was kept.

    kept    fields of the reading that was kept, without the clock
    latest  all fields of the latest reading, None where none followed the one that was kept
    count   readings that followed it
    """

    kept: dict[str, Any]
    latest: dict[str, Any] | None = None
    count: int = 0


class MemorySampler(Sampler[Reading]):
    """Reads host and GPU memory at 100 Hz while running, and at checkpoints when told to.

    Of readings in a row that are equal in all but the clock, the first and the last are kept: GPU memory changes some
    tens of times in a run, and hours of readings would otherwise be more than what a timed run records besides.

    allocator  of the engine on GPU 0: bytes in use and their peak; read at checkpoints alone, since engines do not
               promise that another thread may ask
    topics     that readings are of
    """

    message = "gsb.v1.MemorySample"
    metadata: ClassVar = {
        "unit": "byte",
        "rate": "100 Hz and at checkpoints; of equal readings in a row, the first and last",
    }

    def __init__(self, gpus: Gpus) -> None:
        import psutil

        super().__init__("memory", INTERVAL_S)
        self._process = psutil.Process()
        self._host_total = psutil.virtual_memory().total
        self._gpus = gpus
        of_gpu = [topics.gpu_memory(i, of) for i in range(len(gpus)) for of in ("device", "process", "allocator")]
        self.topics = [topics.MEMORY_HOST, *of_gpu]
        self._sources = enum_values("gsb.v1.MemorySource")
        self._alike: dict[str, _Alike] = {}
        self.allocator: Callable[[], tuple[int, int] | None] | None = None

    def checkpoint(self, name: str) -> None:
        """Read every source now, under the name of a checkpoint of the protocol."""
        with self._lock:
            self._read(name)

    def take(self) -> list[Reading]:
        """The readings since the last call, in order of time."""
        with self._lock:
            for topic in self._alike:
                self._end_of_alike(topic)
        return sorted(super().take(), key=lambda reading: reading.fields["monotonic_ns"])

    def _read(self, checkpoint: str = "") -> None:
        now = time.perf_counter_ns()
        self._try("host", partial(self._read_host, now, checkpoint))
        for index in range(len(self._gpus)):
            self._try(f"gpu{index}", partial(self._read_gpu, index, now, checkpoint))
        if checkpoint and self.allocator is not None and len(self._gpus):
            self._try("allocator", partial(self._read_allocator, self.allocator, now, checkpoint))

    def _read_host(self, now: int, checkpoint: str) -> None:
        used = self._process.memory_info().rss
        self._add(topics.MEMORY_HOST, "HOST_RSS", 0, now, used, self._host_total, checkpoint)

    def _read_gpu(self, index: int, now: int, checkpoint: str) -> None:
        used, total = self._gpus.device_memory(index)
        found = self._gpus.processes(index, before_engine=self.phase == BASELINE)
        self._add(
            topics.gpu_memory(index, "device"), "GPU_DEVICE", index, now, used, total, checkpoint,
            other_processes=found.others, other_bytes=found.other_bytes,
            reserved_bytes=self._gpus.reserved_memory(index) if checkpoint else None,
        )  # fmt: skip
        if found.own_bytes is not None:
            self._add(
                topics.gpu_memory(index, "process"), "GPU_PROCESS", index, now, found.own_bytes, total, checkpoint
            )

    def _read_allocator(self, read: Callable[[], tuple[int, int] | None], now: int, checkpoint: str) -> None:
        found = read()
        if found is None:
            return
        used, peak = found
        self._add(topics.gpu_memory(0, "allocator"), "GPU_ALLOCATOR", 0, now, used, 0, checkpoint)
        self._add(topics.gpu_memory(0, "allocator"), "GPU_ALLOCATOR", 0, now, peak, 0, f"peak until {checkpoint}")

    def _add(
        self,
        topic: str,
        source: str,
        device: int,
        now: int,
        used: int,
        total: int,
        checkpoint: str,
        **others: int | None,
    ) -> None:
        fields = {
            "source": self._sources[f"MEMORY_SOURCE_{source}"], "device": device, "monotonic_ns": now,
            "used_bytes": used, "total_bytes": total, "phase": self.phase, "checkpoint": checkpoint, **others,
        }  # fmt: skip
        values = {name: value for name, value in fields.items() if name != "monotonic_ns"}
        alike = self._alike.get(topic)
        if alike and alike.kept == values and not checkpoint:
            alike.latest = fields
            alike.count += 1
            return
        self._end_of_alike(topic)
        self._alike[topic] = _Alike(values)
        self._readings.append(Reading(topic, fields))

    def _end_of_alike(self, topic: str) -> None:
        alike = self._alike.get(topic)
        if alike and alike.latest:
            self._readings.append(Reading(topic, {**alike.latest, "omitted_readings": alike.count - 1}))
            alike.latest, alike.count = None, 0
