"""Whether differences grow with the number of environments of a sweep."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Section, Text, key_of, table
from gpusimbench.evaluator.render.numbers import NONE, bounds, distance
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.sweeps import Accumulation
from gpusimbench.evaluator.statistics.jackknife import Interval
from gpusimbench.evaluator.statistics.matched import Variability
from gpusimbench.schemas.text import plural

_HOW = (
    "Whether variability grows as parallelisation increases: W1 [cm] with every run reduced to the same number of "
    "environments, since distances of finite samples fall with their number."
)


TITLES = ("N", "runs", "between runs", "floor", "between envs", "between runs, all envs", "floor, all envs")
"""Distances are W1 in cm; the first three are of as many environments at each N."""


def section(source: Source) -> Section | None:
    """None without a sweep that captured states."""
    found = source.evaluation.accumulation
    if not found:
        return None
    tables = [
        table(
            key_of("accumulation", number, one.label),
            f"{one.label}, {one.scene}",
            TITLES,
            [*rows(one)],
            remarks(one),
        )
        for number, one in enumerate(found)
    ]
    title = "Variability against the number of environments"
    return Section("accumulation", title, (Text(_HOW), *tables), plural(len(tables), "sweep"), folded=True)


def rows(found: Accumulation) -> Iterator[tuple[str, ...]]:
    """A row for each number of environments."""
    for point in found.points:
        yield (
            f"{point.n_env:,}",
            str(point.n_run),
            *_cells(point.matched),
            _value(point.matched.parallel),
            *(_cells(point.raw) if point.raw else (NONE, NONE)),
        )


def remarks(found: Accumulation) -> list[str]:
    """What has to be known to read them."""
    envs = plural(found.size, "environment")
    lines = [
        f"each run reduced to {envs}, mean of {found.draws} draws with seed {found.seed}; in brackets 95 % over runs",
        "distances of all environments fall with their number, as their floor does, and are not to be compared",
    ]
    too_many = ((p.n_env, p.raw.reason) for p in found.points if isinstance(p.raw, Missing))
    return [*lines, *dict.fromkeys(f"N = {n_env:,}, all envs: {reason}" for n_env, reason in too_many)]


def _cells(found: Variability) -> tuple[str, str]:
    return _value(found.run_to_run), NONE if found.floor is None else distance(found.floor)


def _value(found: Interval | None) -> str:
    if found is None:
        return NONE
    if not found.ci95:
        return distance(found.estimate)
    return f"{distance(found.estimate)} {bounds(found.ci95, distance)}"
