"""Notes on groups whose steps become slower, or whose processes become larger, the more steps they make."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gpusimbench.evaluator.metrics.growth import FEWEST, Growth, growth, steady_growth
from gpusimbench.evaluator.results.timed_work import SHORT_S
from gpusimbench.evaluator.runs.growth import Course
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.text import plural

_WORK = 1.05
"""What is counted explains a growth of time where it grew by this factor from the first timed step to the last."""


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
