"""Throughput: simulated frames per second of wall time."""

from __future__ import annotations

import math


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
