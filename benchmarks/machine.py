"""What the figures were measured on, and how runs are summed up."""

from __future__ import annotations

import statistics
import threading
from collections.abc import Sequence
from pathlib import Path

from gpusimbench.recorder.probes.host import describe_host


def machine() -> str:
    """One line on this machine."""
    host = describe_host()
    return f"{host['cpu']}, {host['usable_threads']} threads, {host['memory_bytes'] / 2**30:.0f} GiB"


def spread(values: Sequence[float], digits: int = 3) -> str:
    """Median, smallest and largest."""
    return f"{statistics.median(values):.{digits}f} (min {min(values):.{digits}f}, max {max(values):.{digits}f})"


def thread_seconds() -> tuple[float, float]:
    """How long the calling thread has run, and waited for a processor [s], by Linux; zeros elsewhere."""
    try:
        ran, waited, _ = map(int, Path(f"/proc/self/task/{threading.get_native_id()}/schedstat").read_text().split())
    except OSError:
        return 0.0, 0.0
    return ran / 1e9, waited / 1e9
