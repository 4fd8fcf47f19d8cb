"""GPU memory: what a run takes on top of what was in use before it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Checkpoints:
    """GPU memory in use [bytes] at the protocol's checkpoints; None where it was not sampled.

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
        """M_peak - M_base [bytes]; None where either was not sampled."""
        if self.baseline is None or self.peak is None:
            return None
        return peak_increment(self.baseline, self.peak)


def peak_increment(base_bytes: int, peak_bytes: int) -> int:
    """Memory increment of a run (GPUSimBench definition).

        M_usage = M_peak - M_base

    Args:
        base_bytes: GPU memory in use before env creation [bytes].
        peak_bytes: highest GPU memory in use during stepping [bytes].

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
