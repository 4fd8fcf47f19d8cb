"""What the run of a stranger's recording may take of this machine, and the watch over that.

A recording's configuration may ask for any amount of memory, threads and disk, and what it says of its own run may be a
lie. So the process that started a replay looks at the replay's whole tree of processes while it runs, and kills all of
it once a bound is passed. What counts is memory that is resident. Limits of the operating system on address space
would not do: CUDA and JAX reserve many times what they use.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.recorder.probes.host import memory_bytes

LEAST_MEMORY = 2 << 30
"""What a replay gets where less, or nothing, is recorded of its run's memory [bytes]: compiling an engine's kernels
takes as much, and may not have been necessary where the recording was made."""

_TIMES = 2  # the recorded peak: versions, devices and caches differ
_SHARE = 0.8  # of the machine's memory
_THREADS, _THREADS_PER_CPU = 256, 16  # pools of XLA, of BLAS and of an engine have a thread a CPU each
_DISK = 256 << 20  # beside twice the recording's content: models, logs
_INTERVAL_S = 0.05
_LOOK_S = 1.0  # between two searches for new processes and files, which cost more
_GIB = 1 << 30


@dataclass(frozen=True)
class Cage:
    """What is known of a run beforehand, by the recording that asks for it.

    peak_bytes     that its run took of host and GPU memory together; 0 where nothing is said
    content_bytes  that its recording is going to hold
    """

    peak_bytes: int
    content_bytes: int

    def memory(self, machine: int) -> tuple[int, str]:
        """How much memory the run may take on a machine with that much [bytes], and why."""
        share = int(_SHARE * machine)
        twice = _TIMES * self.peak_bytes
        if share <= max(twice, LEAST_MEMORY):
            return share, f"{_SHARE:.0%} of this machine's memory"
        if twice > LEAST_MEMORY:
            return twice, f"twice the {gib(self.peak_bytes)} that its recording says it took"
        says = (
            f"its recording says {gib(self.peak_bytes)}" if self.peak_bytes else "its recording does not say how much"
        )
        return LEAST_MEMORY, f"the least that a replay gets; {says}"

    @property
    def disk_bytes(self) -> int:
        """How much the run may write [bytes]."""
        return _TIMES * self.content_bytes + _DISK


def most_threads() -> int:
    """How many threads a replay may have on this machine."""
    return _THREADS + _THREADS_PER_CPU * (os.cpu_count() or 1)


class Guard:
    """Kills a process and all that it started once they pass a bound. A context manager.

    broken  the bound that they passed, as a sentence; empty where they kept to all of them
    peak    the most memory that was seen [bytes]
    """

    def __init__(self, process: subprocess.Popen[bytes], cage: Cage, written: Iterable[Path]) -> None:
        """written  files and folders whose size counts."""
        import psutil

        self.broken = ""
        self.peak = 0
        self._errors = psutil.Error
        self._root = process.pid
        self._written = tuple(written)
        self._memory, self._memory_why = cage.memory(memory_bytes())
        self._disk = cage.disk_bytes
        self._threads = most_threads()
        self._processes: dict[int, Any] = {}
        with suppress(psutil.Error):
            self._processes[process.pid] = psutil.Process(process.pid)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="cage", daemon=True)

    def __enter__(self) -> Guard:
        self._thread.start()
        return self

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        looked = 0.0
        while not self._stop.wait(_INTERVAL_S):
            look = time.monotonic() - looked >= _LOOK_S
            if look:
                self._find()
            self.broken = self._passed(look)
            if look:
                looked = time.monotonic()
            if self.broken:
                self._kill()
                return

    def _find(self) -> None:
        # Descendants, and members of the session that the run leads: a child whose parent has ended is no descendant.
        import psutil

        found = []
        with suppress(psutil.Error):
            found += [child.pid for child in psutil.Process(self._root).children(recursive=True)]
        for number in psutil.pids():
            with suppress(OSError):
                if os.getsid(number) == self._root:
                    found.append(number)
        for number in found:
            if number not in self._processes:
                with suppress(psutil.Error):
                    self._processes[number] = psutil.Process(number)

    def _passed(self, look: bool) -> str:
        memory = threads = 0
        for number, process in list(self._processes.items()):
            try:
                memory += process.memory_info().rss
                threads += process.num_threads()
            except self._errors:
                del self._processes[number]  # it has ended
        self.peak = max(self.peak, memory)
        if memory > self._memory:
            return f"memory: it took {gib(memory)}, and may take {gib(self._memory)}, {self._memory_why}"
        if threads > self._threads:
            return f"threads: it had {threads}, and may have {self._threads} on this machine"
        written = sum(map(_size, self._written)) if look else 0
        if written > self._disk:
            return f"disk: it wrote {gib(written)}, and may write {gib(self._disk)}, by what its recording holds"
        return ""

    def _kill(self) -> None:
        self._find()  # what was started meanwhile
        with suppress(ProcessLookupError):
            os.killpg(self._root, signal.SIGKILL)
        for process in self._processes.values():
            with suppress(self._errors):
                process.kill()


def _size(path: Path) -> int:
    total = 0
    with suppress(OSError):
        if not path.is_dir():
            return path.stat().st_size
        for folder, _, names in os.walk(path):
            for name in names:
                with suppress(OSError):
                    total += (Path(folder) / name).lstat().st_size
    return total


def gib(size: int) -> str:
    """A number of bytes, to be read."""
    return f"{size / _GIB:.2f} GiB"
