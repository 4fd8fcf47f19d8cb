"""Memory of device and host: what a run takes on top of what was in use before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


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
