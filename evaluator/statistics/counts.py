"""Counts of several classes that should be equally likely: Pearson's chi-squared test, and what it would miss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

FEWEST = 5.0
"""Expected count of each class, below which the distribution of the statistic is not that of chi-squared."""


@dataclass(frozen=True)
class Uniformity:
    """Whether all classes are equally likely.

    statistic  sum of (observed - expected)^2 / expected
    degrees    of freedom: its mean if they are
    critical   that the statistic exceeds with the probability alpha if they are
    p          probability of a statistic as large
    least      share by which the probability of a class has to be off, and of the others the other way, for the test to
               see it with the power asked for
    """

    statistic: float
    degrees: int
    critical: float
    p: float
    least: float


def uniformity(counts: Sequence[int], *, alpha: float, power: float) -> Uniformity | None:
    """Pearson's test of equal probabilities; None where fewer than FEWEST are expected of a class.

    A class of probability (1 + x) / k and k - 1 of (1 - x / (k - 1)) / k give the statistic the noncentrality
    n x^2 / (k - 1) (Cohen, Statistical Power Analysis, chapter 7). This is asymptotic: of six classes, the power is
    95 % with 6000 throws, and 93 % with 600.
    """
    from scipy.special import chdtrc, chdtri, chndtrinc

    total, classes = sum(counts), len(counts)
    expected = total / classes
    if expected < FEWEST:
        return None
    degrees = classes - 1
    statistic = sum((count - expected) ** 2 for count in counts) / expected
    critical = float(chdtri(degrees, alpha))
    noncentrality = float(chndtrinc(critical, degrees, 1.0 - power))
    least = math.sqrt(noncentrality * degrees / total)
    return Uniformity(statistic, degrees, critical, float(chdtrc(degrees, statistic)), least)
