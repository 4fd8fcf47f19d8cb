"""Numbers as people read them."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.render.numbers import seconds


@pytest.mark.parametrize(
    ("value", "said"),
    [(120.4, "120"), (99.7, "100"), (1.234, "1.2"), (0.0042, "0.004"), (-0.37, "-0.37"), (-0.0042, "-0.004"),
     (2e-06, "< 0.001"), (-2e-06, "> -0.001"), (5e-18, "0"), (-5e-18, "0"), (0.0, "0")],
)  # fmt: skip
def test_seconds(value: float, said: str) -> None:
    """Round neither a small time to zero, nor the rounding of a computation to a small time."""
    assert seconds(value) == said
