"""The most memory that a program takes, with all processes that it starts."""

from __future__ import annotations

from functools import partial

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import Sampler

_INTERVAL_S = 0.1
HOST = "host"


class ProgramMemory(Sampler[int]):
    """Reads 10 times a second the resident memory of a process and its descendants, and what each GPU has in use.

    NVML numbers processes by another namespace in most containers, so that memory of a GPU is that of the whole device.
    """

    def __init__(self, pid: int, gpus: Gpus) -> None:
        super().__init__("memory of the program", _INTERVAL_S)
        self._pid = pid
        self._gpus = gpus
        self.peaks: dict[str, int] = {}  # the largest reading of each source so far: "host", "gpu0", ... [bytes]

    def _read(self) -> None:
        self._try(HOST, self._read_host)
        for index in range(len(self._gpus)):
            self._try(f"gpu{index}", partial(self._read_gpu, index))

    def _read_host(self) -> None:
        import psutil

        root = psutil.Process(self._pid)
        total = 0
        for process in (root, *root.children(recursive=True)):
            try:
                total += process.memory_info().rss
            except psutil.Error:  # it has ended
                continue
        self._note(HOST, total)

    def _read_gpu(self, index: int) -> None:
        self._note(f"gpu{index}", self._gpus.device_memory(index)[0])

    def _note(self, source: str, used: int) -> None:
        self.peaks[source] = max(used, self.peaks.get(source, 0))
