"""What the figures were measured on, and how runs are summed up."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from gpusimbench.recorder.probes.host import describe_host


def machine() -> str:
    """One line on this machine."""
    host = describe_host()
    return f"{host['cpu']}, {host['usable_threads']} threads, {host['memory_bytes'] / 2**30:.0f} GiB"


def spread(values: Sequence[float], digits: int = 3) -> str:
    """Median, smallest and largest."""
    return f"{statistics.median(values):.{digits}f} (min {min(values):.{digits}f}, max {max(values):.{digits}f})"
