"""Throughput, memory and start-up."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.metrics.memory import Checkpoints, allocator_peak, peak_increment
from gpusimbench.evaluator.metrics.throughput import frames_per_second, typical_time


def test_frames_per_second() -> None:
    """Count every env's steps per second."""
    assert frames_per_second(4096, 1000, 20.0) == 204800.0


@pytest.mark.parametrize(
    ("n_env", "n_step", "elapsed_s"),
    [(0, 1, 1.0), (1, 0, 1.0), (1, 1, 0.0), (1, 1, float("nan")), (1, 1, float("inf"))],
)
def test_frames_per_second_refuses(n_env: int, n_step: int, elapsed_s: float) -> None:
    """Refuse a phase that was not timed."""
    with pytest.raises(ValueError):
        frames_per_second(n_env, n_step, elapsed_s)


def test_peak_increment() -> None:
    """Subtract what was in use before the run."""
    assert peak_increment(615, 2048) == 1433
    assert peak_increment(615, 615) == 0


@pytest.mark.parametrize(("base", "peak"), [(-1, 5), (5, 4)])
def test_peak_increment_refuses(base: int, peak: int) -> None:
    """Refuse figures that say nothing about the run."""
    with pytest.raises(ValueError):
        peak_increment(base, peak)


@pytest.mark.parametrize(
    ("built", "peaks", "peak"), [(None, [], None), (None, [5, 9], 9), (9, [5, 9], None), (9, [9, 10], 10)]
)
def test_the_peak_of_a_compiler_is_not_that_of_the_simulation(
    built: int | None, peaks: list[int], peak: int | None
) -> None:
    """Give no peak where building the simulator took as much."""
    assert allocator_peak(built, peaks) == peak


def test_checkpoints() -> None:
    """Derive the increment where both ends were sampled, and only there."""
    assert Checkpoints(baseline=100, peak=350).peak_increment == 250
    assert Checkpoints(baseline=100, final=200).peak_increment is None
    assert Checkpoints(peak=100).peak_increment is None


@pytest.mark.parametrize(
    ("peak", "increment", "shrank"), [(99, None, True), (100, 0, False), (101, 1, False), (None, None, False)]
)
def test_a_peak_about_the_baseline(peak: int | None, increment: int | None, shrank: bool) -> None:
    """Say that memory was given back where the peak lies below the baseline, and not where it is the same."""
    found = Checkpoints(baseline=100, peak=peak)
    assert (found.peak_increment, found.shrank) == (increment, shrank)


def test_the_first_run_that_fills_caches_is_not_typical() -> None:
    """Take the median of start-up times, which one run that compiles what others find does not move."""
    assert typical_time([60.0, 2.0, 3.0]) == 3.0
    assert typical_time([60.0, 2.0, 3.0, 4.0]) == 3.5
    with pytest.raises(ValueError, match="at least one"):
        typical_time([])
