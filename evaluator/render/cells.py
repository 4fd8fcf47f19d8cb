"""Cells of values: an estimate, a count, a reason why there is no value."""

from __future__ import annotations

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import EMPTY, Cell, Tone
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.metric import Estimate


def estimate(found: Estimate, *notes: str, tone: Tone = Tone.PLAIN) -> Cell:
    """Mean and SD of an estimate with its 95 % interval, or the reason why there is none."""
    if isinstance(found.value, Missing):
        return missing(found.value)
    bounds = numbers.interval(found)
    return Cell(
        numbers.mean_sd(found),
        float(found.value),
        found.ci95,
        "" if bounds == numbers.NONE else bounds,
        tuple(note for note in notes if note),
        tone,
    )


def ranked(fps: Estimate) -> Cell:
    """The throughput by which a group is ranked: the estimate, or the range of the slowest outcome."""
    speeds = fps.of(Throughput).speeds
    if speeds is None:
        return estimate(fps)
    slowest = speeds.outcomes[0]
    return Cell(slowest.said, slowest.low, notes=(f"the slowest of {len(speeds.outcomes)} outcomes",))


def missing(why: Missing | str) -> Cell:
    """No value, and the reason."""
    reason = why.reason if isinstance(why, Missing) else why
    return Cell(EMPTY.text, notes=(reason,) if reason else (), tone=Tone.QUIET)
