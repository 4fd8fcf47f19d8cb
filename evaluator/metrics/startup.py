"""Start-up: what building and compiling a simulator take before its first step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def typical_time(times_s: Sequence[float]) -> float:
    """Typical time of building, or of compiling, over runs.

        T = median over runs r of  T_r

    The first run of a set fills the caches on disk that the others find: a mean would mix the two.

    Args:
        times_s: one per run [s].

    Raises:
        ValueError: no times.
    """
    if not len(times_s):
        raise ValueError("a median needs at least one time")
    return float(np.median(times_s))
