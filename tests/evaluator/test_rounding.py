"""Shares and bounds in per cent are never rounded to what they are not, and amounts have a unit that suits them."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.render.numbers import length, scaled
from gpusimbench.schemas.text import bound, percent


@pytest.mark.parametrize(
    ("share", "shown"),
    [
        *((0.0, "0 %"), (0.001, "less than 1 %"), (0.4, "40 %"), (0.994, "99 %")),
        *((0.999, "more than 99 %"), (1.0, "100 %"), (1.5, "150 %")),
    ],
)
def test_a_share(share: float, shown: str) -> None:
    """Say 0 % and 100 % of exact values alone."""
    assert percent(share) == shown


@pytest.mark.parametrize("runs", [2, 3, 10, 100, 1000, 100_000])
def test_an_upper_bound(runs: int) -> None:
    """Round no small bound down: of a thousand runs that agree, 0.3 % is not 0 %."""
    below = 1 - 0.05 ** (1 / (runs - 1))
    shown = float(bound(below).removesuffix(" %")) / 100
    assert shown == pytest.approx(below, rel=0.04) and (shown >= below or below > 0.095)
    assert bound(0.0) == "0 %"


def test_an_amount_that_rounds_up_to_the_next_unit() -> None:
    """Print 1 GB, and not 1e+03 MB."""
    assert [scaled(value, "B") for value in (999.6e6, 999.4e6, 1e9, 999.6e3)] == ["1 GB", "999 MB", "1 GB", "1 MB"]
    assert scaled(999.6e6, "B", "#.4g") == "0.9996 GB"
    lengths = [length(metres) for metres in (0.9996, 9.996e-4, 9.994e-4, 9.997e-7)]
    assert [scaled(value, "B") for value in (0, 12, 2.5e12)] == ["0 B", "12 B", "2,500 GB"]
    assert [scaled(value, "rad") for value in (2e-6, 1e-12)] == ["2 µrad", "1e-12 rad"]
    assert lengths == ["1 m", "1 mm", "999 µm", "1 µm"]
