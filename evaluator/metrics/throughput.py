"""Times of a run: throughput, start-up, and what capturing states costs; and whether capturing changes the states."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def frames_per_second(n_env: int, n_step: int, elapsed_s: float) -> float:
    """Throughput of a timed phase (GPUSimBench definition).

        FPS = N_env * N_step / T_step

    Args:
        n_env: envs stepped in parallel.
        n_step: timed steps, warm-up excluded.
        elapsed_s: wall time of the timed steps [s].

    Returns:
        throughput [env-steps/s].

    Raises:
        ValueError: a count is below one, or the time is not positive and finite.
    """
    if n_env < 1 or n_step < 1:
        raise ValueError(f"n_env and n_step must be at least 1, got {n_env} and {n_step}")
    if not (math.isfinite(elapsed_s) and elapsed_s > 0.0):
        raise ValueError(f"elapsed time must be positive and finite, got {elapsed_s} s")
    return n_env * n_step / elapsed_s


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


def overhead(captured_s: float, captured_steps: int, timed_s: float, timed_steps: int) -> float:
    """Time of a captured step over that of a timed one.

        (T_capture / N_capture) / (T_timed / N_timed)

    Args:
        captured_s: from the first step of the capture to the last one's state on the host [s].
        captured_steps: steps in that time.
        timed_s: wall time of the timed phase [s].
        timed_steps: steps of the timed phase.

    Raises:
        ZeroDivisionError: a count or a time is zero.
    """
    return captured_s / captured_steps / (timed_s / timed_steps)
