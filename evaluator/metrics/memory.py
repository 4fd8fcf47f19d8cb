"""Memory of device and host: what a run takes on top of what was in use before, and how it grows with environments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

MIN_POINTS = 3
"""Two points lie on a line whatever they are; only a third can disagree."""

HOLDS_WITHIN = 0.10
"""Largest relative residual with which the model is called good."""


@dataclass(frozen=True)
class Checkpoints:
    """Memory in use [bytes] at the protocol's checkpoints, by one source; None where it was not sampled.

    baseline      before any env exists
    post_init     after the envs are created
    post_warmup   after the warm-up steps
    peak          highest sample during stepping
    final         after the last step
    """

    baseline: int | None = None
    post_init: int | None = None
    post_warmup: int | None = None
    peak: int | None = None
    final: int | None = None

    @property
    def peak_increment(self) -> int | None:
        """M_peak - M_base [bytes]; None where either was not sampled, and where the peak lies below the baseline."""
        if self.baseline is None or self.peak is None or self.peak < self.baseline:
            return None
        return peak_increment(self.baseline, self.peak)

    @property
    def shrank(self) -> bool:
        """Whether the peak lies below the baseline: somebody gave memory back, and the increment says nothing."""
        return self.baseline is not None and self.peak is not None and self.peak < self.baseline


@dataclass(frozen=True)
class Listing:
    """What NVML listed beside the run's process: how many processes, and their bytes; None where it did not tell."""

    processes: int
    bytes: int | None


@dataclass(frozen=True)
class GpuMemory:
    """Memory of the device that a run stepped on.

    device         by NVML, of the whole device
    process        by NVML, of the run's process, which holds none at the baseline; None where NVML did not tell
    listed         other processes by moment (a checkpoint, or "timed" for the largest of that phase's readings); a
                   moment is missing where NVML did not tell the others from the run's own process
    reserved       what the driver kept for itself at the baseline [bytes]; None where it did not tell
    """

    device: Checkpoints
    process: Checkpoints | None = None
    listed: Mapping[str, Listing] = field(default_factory=dict)
    reserved: int | None = None


def peak_increment(base_bytes: int, peak_bytes: int) -> int:
    """Memory increment of a run (GPUSimBench definition, of GPU memory; the same of the host's resident set).

        M_usage = M_peak - M_base

    Args:
        base_bytes: memory in use before env creation [bytes].
        peak_bytes: highest memory in use during stepping [bytes].

    Returns:
        increment [bytes].

    Raises:
        ValueError: a figure is negative, or the peak lies below the baseline: something else on
            the device gave memory back meanwhile, and the difference says nothing about the run.
    """
    if base_bytes < 0:
        raise ValueError(f"baseline memory is negative: {base_bytes} bytes")
    if peak_bytes < base_bytes:
        raise ValueError(f"peak memory {peak_bytes} lies below the baseline {base_bytes} bytes")
    return peak_bytes - base_bytes


def allocator_peak(built_bytes: int | None, peaks_bytes: Sequence[int]) -> int | None:
    """Peak that the engine's own allocator kept while it stepped.

        M = max over checkpoints of M_peak, where that is larger than the peak of building the simulator

    Args:
        built_bytes: the peak by the time the simulator was built [bytes]; None where it was not read.
        peaks_bytes: the peaks at all checkpoints [bytes].

    Returns:
        the peak [bytes]; None without one, and where building took as much: then it is the memory of a compiler or a
        loader, and that of the simulation was smaller.
    """
    peak = max(peaks_bytes, default=None)
    return None if peak is None or (built_bytes is not None and peak <= built_bytes) else peak


@dataclass(frozen=True)
class MemoryModel:
    """bytes = fixed + per_env * N, fitted over a sweep.

    fixed, per_env            [bytes], [bytes per env]
    fixed_se, per_env_se      their standard errors [same units], from the residuals
    n                         numbers of environments that were fitted
    residuals                 (model - measured) / measured at each of them, in that order
    """

    fixed: float
    per_env: float
    fixed_se: float
    per_env_se: float
    n: tuple[int, ...]
    residuals: tuple[float, ...]

    @property
    def largest_residual(self) -> float:
        """Largest relative residual, without its sign."""
        return max(abs(r) for r in self.residuals)

    @property
    def worst_n(self) -> int:
        """The number of environments at which it is."""
        return max(zip(self.residuals, self.n, strict=True), key=lambda pair: abs(pair[0]))[1]

    @property
    def holds(self) -> bool:
        """Whether the model is within HOLDS_WITHIN everywhere; allocators that grow in powers of two break it."""
        return self.largest_residual <= HOLDS_WITHIN

    def at(self, n_env: float) -> float:
        """What the model says of so many environments [bytes]."""
        return self.fixed + self.per_env * n_env


def fit_memory(n_env: Sequence[int], measured: Sequence[float]) -> MemoryModel:
    """Least squares of relative errors.

        minimise  sum_i ((fixed + per_env N_i - M_i) / M_i)^2

    Memory of a sweep spans decades. Unweighted, the largest N alone would decide and the constant be lost; relative
    errors weigh each point alike, and suit allocators whose granules grow with what they hand out. Standard errors,
    with X the rows (1, N_i) / M_i and r the residuals:

        cov = sum r^2 / (n - 2) * inverse(X'X)

    Args:
        n_env: numbers of environments, one a point.
        measured: memory increments M [bytes].

    Raises:
        ValueError: fewer than MIN_POINTS different N, or a point that is not positive and finite.
    """
    if len(n_env) != len(measured):
        raise ValueError(f"{len(n_env)} numbers of environments and {len(measured)} measurements")
    if len(set(n_env)) < MIN_POINTS:
        raise ValueError(f"needs at least {MIN_POINTS} numbers of environments, got {len(set(n_env))}")
    for n, used in zip(n_env, measured, strict=True):
        if n < 1 or not (math.isfinite(used) and used > 0):
            raise ValueError(f"memory must be positive and finite at 1 or more environments: {used} bytes at {n}")
    count, memory = np.array(n_env, dtype=np.float64), np.array(measured, dtype=np.float64)
    design = np.column_stack([1.0 / memory, count / memory])
    size = np.linalg.norm(design, axis=0)  # columns of one size: the fit is as exact as the numbers allow
    q, r = np.linalg.qr(design / size)
    solution = np.linalg.solve(r, q.T @ np.ones(len(count)))
    residuals = (design / size) @ solution - 1.0
    inverse = np.linalg.inv(r)
    variance = float(residuals @ residuals) / (len(count) - 2)
    errors = np.sqrt(variance * (inverse**2).sum(axis=1)) / size
    fixed, per_env = solution / size
    return MemoryModel(
        float(fixed), float(per_env), float(errors[0]), float(errors[1]), tuple(n_env), tuple(residuals.tolist())
    )
