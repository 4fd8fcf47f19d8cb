"""Shares and bounds in per cent are never rounded to what they are not, and amounts have a unit that suits them."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.render.numbers import distance_bound, length, mean_sd, scaled, seconds
from gpusimbench.evaluator.results.group_metrics import W1_RUN_TO_RUN
from gpusimbench.evaluator.results.metric import Estimate
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


@pytest.mark.parametrize("runs", [2, 3, 4, 10, 100, 1000, 100_000])
def test_an_upper_bound(runs: int) -> None:
    """Round no bound down: 28.3 % of ten runs that agree is 29 %, and 0.3 % of a thousand is not 0 %."""
    below = 1 - 0.05 ** (1 / (runs - 1))
    shown = float(bound(below).removesuffix(" %")) / 100
    assert below <= shown + 1e-12 and shown == pytest.approx(below, rel=0.04)


def test_upper_bounds_that_need_no_rounding() -> None:
    """Show what has no more digits as it is, whichever way floating point rounds 100 times it."""
    shares = (0.0, 0.07, 0.29, 0.57, 0.095, 0.0995, 1.0)
    assert [bound(share) for share in shares] == ["0 %", "7 %", "29 %", "57 %", "9.5 %", "10 %", "100 %"]


def test_bounds_of_a_distance() -> None:
    """Round upper bounds up and lower bounds down, and leave what needs no rounding."""
    values = (0.5031, 0.503, 12.9996, 3.14e-5, 0.0)
    assert [distance_bound(value, upper=True) for value in values] == ["0.504", "0.503", "13.000", "3.2e-05", "0"]
    assert [distance_bound(value, upper=False) for value in values] == ["0.503", "0.503", "12.999", "3.1e-05", "0"]
    certified = Estimate(W1_RUN_TO_RUN, 0.5031, n=1, exactness="certified")
    assert mean_sd(certified) == "<= 0.504"


def test_an_amount_that_rounds_up_to_the_next_unit() -> None:
    """Print 1 GB, and not 1e+03 MB."""
    assert [scaled(value, "B") for value in (999.6e6, 999.4e6, 1e9, 999.6e3)] == ["1 GB", "999 MB", "1 GB", "1 MB"]
    assert scaled(999.6e6, "B", "#.4g") == "0.9996 GB"
    lengths = [length(metres) for metres in (0.9996, 9.996e-4, 9.994e-4, 9.997e-7)]
    assert [scaled(value, "B") for value in (0, 12, 2.5e12)] == ["0 B", "12 B", "2,500 GB"]
    assert [scaled(value, "rad") for value in (2e-6, 1e-12)] == ["2 µrad", "1e-12 rad"]
    assert lengths == ["1 m", "1 mm", "999 µm", "1 µm"]


@pytest.mark.parametrize(
    ("value", "said"),
    [(120.4, "120"), (99.7, "100"), (1.234, "1.2"), (0.0042, "0.004"), (-0.37, "-0.37"), (-0.0042, "-0.004"),
     (2e-06, "< 0.001"), (-2e-06, "> -0.001"), (5e-18, "0"), (-5e-18, "0"), (0.0, "0")],
)  # fmt: skip
def test_seconds(value: float, said: str) -> None:
    """Round neither a small time to zero, nor the rounding of a computation to a small time."""
    assert seconds(value) == said
