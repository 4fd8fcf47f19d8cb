"""Throughput, memory and start-up; and the memory model: exact lines, units, and what least squares of relative errors
must satisfy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.memory import Checkpoints, MemoryModel, allocator_peak, fit_memory, peak_increment
from gpusimbench.evaluator.metrics.throughput import frames_per_second, typical_time

powers = st.lists(st.integers(0, 20).map(lambda k: 2**k), min_size=3, max_size=21, unique=True)
bytes_ = st.floats(1e6, 1e11)


@st.composite
def sweeps(draw: st.DrawFn) -> tuple[list[int], list[float]]:
    """Numbers of environments, and memory that follows no law."""
    n_env = draw(powers)
    return n_env, draw(st.lists(bytes_, min_size=len(n_env), max_size=len(n_env)))


def loss(n_env: list[int], measured: list[float], fixed: float, per_env: float) -> float:
    """Sum of squared relative errors."""
    return sum(((fixed + per_env * n - m) / m) ** 2 for n, m in zip(n_env, measured, strict=True))


@given(powers, st.floats(0, 1e10), st.floats(1, 1e8))
def test_an_exact_line_is_found(n_env: list[int], fixed: float, per_env: float) -> None:
    """Reproduce every point of a line, with no residual and no error to speak of."""
    measured = [fixed + per_env * n for n in n_env]
    model = fit_memory(n_env, measured)
    assert model.largest_residual < 1e-9
    assert model.holds
    for n, memory in zip(n_env, measured, strict=True):
        assert model.at(n) == pytest.approx(memory, rel=1e-9)


@given(sweeps(), st.floats(1e-3, 1e3))
def test_units_carry_through(sweep: tuple[list[int], list[float]], scale: float) -> None:
    """Scale both costs and their errors with the unit of memory; leave relative residuals as they are."""
    n_env, measured = sweep
    one, other = fit_memory(n_env, measured), fit_memory(n_env, [m * scale for m in measured])
    noise = 1e-9 * max(measured) * scale
    for name in ("fixed", "per_env", "fixed_se", "per_env_se"):
        assert getattr(other, name) == pytest.approx(getattr(one, name) * scale, rel=1e-6, abs=noise)
    assert other.residuals == pytest.approx(one.residuals, abs=1e-6)


@given(sweeps(), st.randoms(use_true_random=False))
def test_order_does_not_matter(sweep: tuple[list[int], list[float]], random: object) -> None:
    """Fit the same whatever the order of the points."""
    n_env, measured = sweep
    pairs = list(zip(n_env, measured, strict=True))
    random.shuffle(pairs)  # type: ignore[attr-defined]
    one, other = fit_memory(n_env, measured), fit_memory(*map(list, zip(*pairs, strict=True)))
    assert other.largest_residual == pytest.approx(one.largest_residual, abs=1e-6)
    assert other.at(1) == pytest.approx(one.at(1), rel=1e-6, abs=1e-9 * max(measured))


@given(sweeps(), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_nothing_nearby_fits_better(sweep: tuple[list[int], list[float]], d_fixed: float, d_per_env: float) -> None:
    """Be the minimum of the stated loss."""
    n_env, measured = sweep
    model = fit_memory(n_env, measured)
    best = loss(n_env, measured, model.fixed, model.per_env)
    moved = loss(
        n_env, measured, model.fixed + d_fixed * max(measured), model.per_env + d_per_env * max(measured) / max(n_env)
    )
    assert moved >= best * (1 - 1e-9) - 1e-12
    assert best == pytest.approx(sum(r**2 for r in model.residuals), rel=1e-6, abs=1e-12)


@given(sweeps())
def test_figures_are_finite(sweep: tuple[list[int], list[float]]) -> None:
    """Give finite costs and errors that are not negative, whatever was measured."""
    model = fit_memory(*sweep)
    assert all(map(math.isfinite, (model.fixed, model.per_env, model.fixed_se, model.per_env_se)))
    assert min(model.fixed_se, model.per_env_se) >= 0
    assert model.worst_n in model.n


def test_doubling_allocators_break_the_model() -> None:
    """Say that the line does not hold where memory grows in steps of powers of two."""
    n_env = [100 * k for k in range(1, 12)]
    model = fit_memory(n_env, [float(2 ** math.ceil(math.log2(n * 1e6))) for n in n_env])
    assert not model.holds
    assert model.largest_residual > 0.2


@pytest.mark.parametrize(
    ("n_env", "measured", "message"),
    [
        ([1, 2], [1.0, 2.0], "at least 3"),
        ([1, 2, 2], [1.0, 2.0, 2.0], "at least 3"),
        ([1, 2, 4], [1.0, 2.0], "2 measurements"),
        ([1, 2, 4], [1.0, 0.0, 2.0], "positive and finite"),
        ([1, 2, 4], [1.0, float("nan"), 2.0], "positive and finite"),
        ([1, 2, 4], [1.0, float("inf"), 2.0], "positive and finite"),
        ([0, 2, 4], [1.0, 1.0, 2.0], "positive and finite"),
    ],
)
def test_what_is_refused(n_env: list[int], measured: list[float], message: str) -> None:
    """Refuse what no line can be drawn through."""
    with pytest.raises(ValueError, match=message):
        fit_memory(n_env, measured)


def test_the_worst_point_is_named() -> None:
    """Point at the number of environments with the largest residual."""
    model = MemoryModel(0.0, 1.0, 0.0, 0.0, (1, 2, 4), (0.1, -0.5, 0.2))
    assert (model.worst_n, model.largest_residual, model.holds) == (2, 0.5, False)


def test_standard_errors_are_those_of_weighted_least_squares() -> None:
    """Agree with the inverse of X'X from one environment on, with two degrees of freedom less than points."""
    n = [1, 4, 16, 64, 256]
    memory = np.array([1.02e6, 1.3e6, 2.7e6, 7.2e6, 27.1e6])
    found = fit_memory(n, memory.tolist())
    design = np.column_stack([1 / memory, np.array(n) / memory])
    solution, (left,), _, _ = np.linalg.lstsq(design, np.ones(5), rcond=None)
    errors = np.sqrt(left / 3 * np.diagonal(np.linalg.inv(design.T @ design)))
    assert (found.fixed, found.per_env) == pytest.approx(solution.tolist())
    assert (found.fixed_se, found.per_env_se) == pytest.approx(errors.tolist())
    assert found.n == tuple(n)
    with pytest.raises(ValueError, match="at 1 or more environments"):
        fit_memory([0, 4, 16, 64, 256], memory.tolist())


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
