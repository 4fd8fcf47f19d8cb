"""Published regimes."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.metrics.regime import REGIME_MEANING, Regime, is_present, published_regime

PUBLISHED = [
    ("Isaac Lab", 4.21, 0.00, 1),
    ("ManiSkill", 4.76, 0.00, 1),
    ("Genesis", 0.00, 0.00, 2),
    ("MJX", 0.00, 0.00, 2),
    ("Madrona", 32.53, 11.47, 3),
    ("MuJoCo Warp", 4.55, 2.15, 3),
    ("Playground", 0.00, 1.39, 4),
]


@pytest.mark.parametrize(("simulator", "parallel", "run_to_run", "expected"), PUBLISHED)
def test_published_types(simulator: str, parallel: float, run_to_run: float, expected: int) -> None:
    """Reproduce the published type from the published figures."""
    assert published_regime(parallel, run_to_run) == expected, simulator


@pytest.mark.parametrize(("value", "present"), [(0.0, False), (0.0049, False), (0.0051, True)])
def test_rounding(value: float, present: bool) -> None:
    """Round to 0.01 cm before asking for zero."""
    assert is_present(value) is present


def test_every_regime_has_a_meaning() -> None:
    """Give each type one sentence of its own."""
    assert set(REGIME_MEANING) == set(Regime)
    assert len(set(REGIME_MEANING.values())) == 4


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_refuses(value: float) -> None:
    """Refuse what is no distance."""
    with pytest.raises(ValueError):
        published_regime(0.0, value)
