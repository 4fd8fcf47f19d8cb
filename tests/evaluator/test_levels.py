"""How equal samples are, in levels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.levels import EqualityLevel, verdict


def samples(n: int = 4, dtype: Any = np.float32) -> np.ndarray:
    """So many equal samples of two envs with five bodies [m]."""
    one = np.random.default_rng(0).uniform(0.1, 0.9, size=(1, 2, 5, 3))
    return np.repeat(one, n, axis=0).astype(dtype)


def test_bit_identical_needs_the_hashes() -> None:
    """Claim bits of the whole run only where the hashes of all steps agree."""
    same = verdict(samples(), hashes_agree=True)
    assert (same.level, same.worst, same.worst_ulp) == (EqualityLevel.BIT_IDENTICAL, None, 0.0)
    unknown = verdict(samples(), hashes_agree=None)
    assert (unknown.level, "no state hashes" in unknown.note) == (EqualityLevel.BIT_IDENTICAL, True)
    elsewhere = verdict(samples(), hashes_agree=False)
    assert (elsewhere.level, elsewhere.worst_ulp) == (EqualityLevel.DIFFERENT, 0.0)
    assert "other steps" in elsewhere.note


def test_bodies_that_swapped_places() -> None:
    """Find the same positions in another order within an env, of whole envs, and of both; bodies keep their env."""
    x = samples()
    x[2, 1] = x[2, 1, ::-1]
    found = verdict(x, hashes_agree=False)
    assert (found.level, found.text) == (EqualityLevel.EQUAL_UP_TO_ORDER, "equal up to the order of bodies")
    y = samples()
    y[2] = y[2, ::-1]  # the envs of one sample swapped places
    assert verdict(y, hashes_agree=False).text == "equal up to the order of environments"
    y[1, 0] = y[1, 0, ::-1]
    assert verdict(y, hashes_agree=False).text == "equal up to the order of environments and bodies"
    y[3, 0, 0], y[3, 1, 0] = y[3, 1, 0].copy(), y[3, 0, 0].copy()
    assert verdict(y, hashes_agree=False).level is EqualityLevel.DIFFERENT


@pytest.mark.parametrize(("ulps", "level"), [(8, EqualityLevel.WITHIN_ULP), (9, EqualityLevel.WITHIN_TOLERANCE)])
def test_ulps_are_those_of_the_position(ulps: int, level: EqualityLevel) -> None:
    """Count units in the last place at the body's largest coordinate, up to the limit."""
    x = np.full((3, 1, 1, 3), 0.75, dtype=np.float32)
    x[..., 2] = 0.25
    x[1, 0, 0, 0] += np.float32(ulps * 2.0**-24)
    found = verdict(x, hashes_agree=False)
    assert (found.level, found.worst_ulp) == (level, ulps)
    assert (found.worst.samples, found.worst.component, found.worst.ulp) == ((0, 1), 0, ulps)


def test_coordinate_near_zero_has_no_ulps_of_its_own() -> None:
    """Not call 1e-12 m a million units in the last place of a body that is half a metre away."""
    x = np.full((2, 1, 1, 3), 0.5, dtype=np.float32)
    x[:, 0, 0, 1] = [1e-12, -1e-12]
    assert verdict(x, hashes_agree=False).level is EqualityLevel.WITHIN_ULP


@pytest.mark.parametrize(
    ("apart", "level"), [(0.9e-4, EqualityLevel.WITHIN_TOLERANCE), (1.1e-4, EqualityLevel.DIFFERENT)]
)
def test_tolerance(apart: float, level: EqualityLevel) -> None:
    """Hold positions to 0.1 mm."""
    x = samples(dtype=np.float64)
    x[1, 1, 3, 0] += apart
    found = verdict(x, hashes_agree=False)
    assert found.level is level
    assert (found.worst.samples, found.worst.env, found.worst.item, found.worst.component) == ((0, 1), 1, 3, 0)
    assert found.worst.difference == pytest.approx(apart)


@given(st.integers(0, 2**32 - 1), st.integers(2, 7))
def test_worst_is_that_of_all_pairs(seed: int, n: int) -> None:
    """Find without pairs what a look at every pair finds, in any order of samples."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 2, 3, 2)).astype(np.float32)
    found = verdict(x, hashes_agree=False)
    apart = np.abs(x[:, None].astype(np.float64) - x[None].astype(np.float64))
    assert found.worst.difference == apart.max()
    i, j = found.worst.samples
    assert apart[i, j, found.worst.env, found.worst.item, found.worst.component] == apart.max()
    moved = verdict(x[rng.permutation(n)], hashes_agree=False)
    assert (moved.level, moved.worst_ulp) == (found.level, found.worst_ulp)


def test_origins_take_the_bits() -> None:
    """Claim no bits beside different origins, and no tolerance finer than float32 has there."""
    local = np.random.default_rng(0).uniform(0.1, 0.9, size=(1, 1, 5, 3))
    origins = np.array([[0.0, 0, 0], [3000.0, 0, 0]])
    recorded = (local + origins[:, None, None]).astype(np.float32)
    found = verdict(recorded, hashes_agree=False, origins=origins)
    assert found.level is EqualityLevel.WITHIN_TOLERANCE
    assert found.resolution == np.spacing(np.float32(3000.0))
    assert found.tolerance == found.resolution > 1e-4
    assert "origins" in found.note
    assert "below that" in found.note
    recorded[1, 0, 2, 0] += 0.01
    assert verdict(recorded, hashes_agree=False, origins=origins).level is EqualityLevel.DIFFERENT
    together = np.zeros((2, 3))
    assert verdict(samples(2), hashes_agree=True, origins=together).level is EqualityLevel.BIT_IDENTICAL


def test_numbers_that_are_not_finite() -> None:
    """Call NaN beside a number different, equal NaNs identical, and overflow no error."""
    x = samples()
    x[1, 0, 0, 0] = np.nan
    found = verdict(x, hashes_agree=False)
    assert (found.level, found.worst, "not finite" in found.note) == (EqualityLevel.DIFFERENT, None, True)
    assert verdict(np.full((2, 1, 1, 3), np.nan), hashes_agree=True).level is EqualityLevel.BIT_IDENTICAL
    assert verdict(np.full((2, 1, 1, 3), np.nan), hashes_agree=False).level is EqualityLevel.DIFFERENT
    beside = verdict(x, hashes_agree=False, origins=np.arange(12.0).reshape(4, 3))
    assert beside.level is EqualityLevel.DIFFERENT
    far = np.array([-1e308, 1e308]).reshape(2, 1, 1, 1)
    assert verdict(far, hashes_agree=False).level is EqualityLevel.DIFFERENT


@pytest.mark.parametrize(
    ("x", "keywords", "message"),
    [
        (samples(1), {}, "two samples"),
        (samples()[0], {}, "sample, env, item, width"),
        (samples()[:, :0], {}, "sample, env, item, width"),
        (samples()[:, :, :0], {}, "sample, env, item, width"),
        (samples().astype(np.int64), {}, "float32"),
        (samples(), {"origins": np.zeros((2, 3))}, "origins"),
        (samples(), {"tolerance": -1.0}, "limits"),
        (samples(), {"max_ulp": float("nan")}, "limits"),
    ],
)
def test_refuses(x: Any, keywords: Any, message: str) -> None:
    """Refuse what cannot be compared."""
    with pytest.raises(ValueError, match=message):
        verdict(x, hashes_agree=False, **keywords)


def test_refuses_hashes_that_cannot_be() -> None:
    """Refuse hashes that agree for positions that do not."""
    x = samples()
    x[1, 0, 0, 0] += 1
    with pytest.raises(ValueError, match="hashes are equal"):
        verdict(x, hashes_agree=True)


@pytest.mark.parametrize(
    ("max_ulp", "tolerance", "level"),
    [
        (0.0, 0.0, EqualityLevel.DIFFERENT),
        (0.0, 1e-4, EqualityLevel.WITHIN_TOLERANCE),
        (8.0, 0.0, EqualityLevel.DIFFERENT),
    ],
)
def test_limits_of_zero_are_limits(max_ulp: float, tolerance: float, level: EqualityLevel) -> None:
    """Take zero for either limit: what is one unit apart has to pass the tolerance whatever its units are."""
    x = samples()
    x[1, 1, 3, 0] = np.nextafter(x[1, 1, 3, 0], np.float32(np.inf))
    assert verdict(x, hashes_agree=False, max_ulp=max_ulp, tolerance=tolerance).level is level
