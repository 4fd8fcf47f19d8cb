"""Whether the time of a step, or memory, grows with the number of steps made: a test of ranks, how large it is, and
notes on groups for which it does."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.results.timed_work import SHORT_S
from gpusimbench.evaluator.runs.growth import Course
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.text import plural

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

_WORK = 1.05
"""What is counted explains a growth of time where it grew by this factor from the first timed step to the last."""


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


def notes(runs: Sequence[Run]) -> Iterator[str]:
    """A sentence for each kind of growth that the complete runs of a group show beyond noise."""
    found = [(run, run.course) for run in runs if run.course]
    courses = [course for _, course in found]
    if grown := growth([np.array(course.windows) for course in courses]):
        most = max(len(course.windows) for course in courses)
        yield (
            f"the same steps took {_percent(grown)} longer in the last of {most} windows than in the first "
            f"(p = {grown.p_value:.1g}, {_over(courses)}): something grows with the steps made, or the machine became "
            "slower"
        )
    if all(map(_tells_of_steps, courses)) and (grown := growth([np.array(course.parts) for course in courses])):
        contacts = [np.mean(ends) for ends in zip(*(course.work["contacts"] for course in courses), strict=True)]
        yield (
            f"the time of a step grew by {_percent(grown)} over the timed steps (p = {grown.p_value:.1g}, "
            f"{_over(courses)}), although nothing counted did: contacts per env are {contacts[0]:.4g} at the first and "
            f"{contacts[1]:.4g} at the last of them"
        )
    for where, name in (("host", "host"), ("device", "GPU")):
        steps = [_bytes_a_step(run, course, where) for run, course in found]
        if steps and all(steps):
            low, high = (f"{value / 1e3:.3g}" for value in (min(steps), max(steps)))
            yield (
                f"{name} memory of the process grew all the time while steps were timed, by "
                f"{low if low == high else f'{low} to {high}'} kB a step ({_over(courses)}): longer runs need more "
                "memory"
            )


def _percent(grown: Growth) -> str:
    return f"{100 * grown.share:.0f} %"


def _over(courses: Sequence[Course]) -> str:
    return plural(len(courses), "run")


def _tells_of_steps(course: Course) -> bool:
    """Whether a growth within the window says something of the engine, and not of the scene or of the system.

    A window that is timed again is compared with itself. Where nothing is counted, or more is counted at the end than
    at the beginning, steps at the end may have more to do.
    """
    work = course.work
    alike = "contacts" in work and all(last <= first * _WORK for first, last in work.values())
    return len(course.windows) < FEWEST and course.seconds >= SHORT_S and alike


def _bytes_a_step(run: Run, course: Course, where: str) -> float:
    used: tuple[int, ...] = getattr(course, where)
    half = 0.5  # of the windows, to which the readings belong
    return steady_growth(used, half * course.stepped) / (half * (run.timed_steps or 1))
