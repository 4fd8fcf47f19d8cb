"""Moments of a command by what it has done: a clock would tell others where the machine is busy."""

from __future__ import annotations

import os
import resource
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path


def descendants(pid: int) -> list[int]:
    """The process and all that it started, directly or not, as far as they live."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            for child in map(int, task.read_text().split()):
                found += descendants(child)
    return found


def has_worked(pid: int, seconds: float) -> bool:
    """Whether the process and all that it started have taken so much CPU time."""
    ticks = 0
    for each in descendants(pid):
        with suppress(OSError):
            # user and system time of its own, and of its children that have ended; a name may hold blanks
            ticks += sum(map(int, Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()[11:15]))
    return ticks >= seconds * os.sysconf("SC_CLK_TCK")


def has_written(folder: Path, size: float) -> bool:
    """Whether the files of a folder hold so many bytes; a folder that is not there holds none."""
    return _content(folder) >= size


def _content(folder: Path) -> int:
    count = 0
    for path in folder.glob("*"):
        with suppress(FileNotFoundError):
            count += path.stat().st_size
    return count


def whole(command: Sequence[str], folder: Path) -> tuple[float, int]:
    """Run a command to its end: the CPU seconds that it took, and the bytes that lie in the folder then."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, _content(folder)


def wait_until(process: subprocess.Popen[str], reached: Callable[[], bool]) -> None:
    """Wait until a process has come so far, or has ended."""
    while process.poll() is None and not reached():
        time.sleep(0.005)
