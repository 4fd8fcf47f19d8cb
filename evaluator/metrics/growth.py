"""Whether the time of a step, or memory, grows with the number of steps made: a test of ranks, and how large it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

ALPHA = 0.01
"""Chance of a false alarm, at most, where values of one law follow each other independently."""

LEAST = 0.05
"""Growth below this share of the median is not told: clocks that warm up make as much."""

FEWEST = 4
"""Fewer values of a run show no trend."""

LEAST_BYTES = 1_000_000
"""Growth of memory below this [byte], or below as much in each second, is not told: the recorder's own readings take up
to 0.15 MB/s."""

Series = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Growth:
    """Times that grow.

    share    median over runs of the growth from the first value to the last, over the median of the run
    p_value  of the test of ranks, over all runs together
    """

    share: float
    p_value: float


def growth(runs: Sequence[Series]) -> Growth | None:
    """Growth of values that follow each other in each of some runs.

    The growth of a run is the slope of Theil and Sen, times the number of values after the first. The test is that of
    Mann and Kendall with the statistics and the variances of the runs summed:

        S = sum over runs, i < j of sign(x_j - x_i),   Var S = sum over runs of n (n - 1) (2 n + 5) / 18

    Args:
        runs: values in order, one array a run; shorter ones than FEWEST are left out, and those of a median of zero.

    Returns:
        the growth; None where it is below LEAST, or p above ALPHA.
    """
    shares, score, variance = [], 0.0, 0.0
    for values in runs:
        n = len(values)
        median = float(np.median(values)) if n >= FEWEST else 0.0
        if not median > 0:
            continue
        first, second = np.triu_indices(n, 1)
        differences = values[second] - values[first]
        shares.append(float(np.median(differences / (second - first))) * (n - 1) / median)
        score += float(np.sign(differences).sum())
        variance += n * (n - 1) * (2 * n + 5) / 18
    if not shares or score <= 1:
        return None
    share = float(np.median(shares))
    p_value = 0.5 * math.erfc((score - 1) / math.sqrt(2 * variance))
    return Growth(share, p_value) if share >= LEAST and p_value <= ALPHA else None


def steady_growth(used: Sequence[int], seconds: float) -> int:
    """By how much memory grew that grows all the time [byte]; 0 where it does not, or by too little.

    Each part has to add at least a quarter of the mean of all parts, which an allocator that grows once does not, nor a
    cache that fills.

    Args:
        used: bytes in use after each of some parts of equal duration.
        seconds: of the parts after the first.
    """
    added = np.diff(np.array(used, dtype=np.float64))
    total = float(added.sum())
    if not len(added) or total < LEAST_BYTES * max(1.0, seconds):
        return 0
    return int(total) if float(added.min()) >= total / len(added) / 4 else 0
