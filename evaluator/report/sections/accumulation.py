"""Whether differences grow with the number of environments of a sweep."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import Section, Text, key_of, table
from gpusimbench.evaluator.render.numbers import plural
from gpusimbench.evaluator.report import accumulation
from gpusimbench.evaluator.report.source import Source

_HOW = (
    "Whether variability grows as parallelisation increases: W1 [cm] with every run reduced to the same number of "
    "environments, since distances of finite samples fall with their number."
)


def section(source: Source) -> Section | None:
    """None without a sweep that captured states."""
    found = source.evaluation.accumulation
    if not found:
        return None
    tables = [
        table(
            key_of("accumulation", number, one.label),
            f"{one.label}, {one.scene}",
            accumulation.TITLES,
            [*accumulation.rows(one)],
            accumulation.remarks(one),
        )
        for number, one in enumerate(found)
    ]
    title = "Variability against the number of environments"
    return Section("accumulation", title, (Text(_HOW), *tables), plural(len(tables), "sweep"), folded=True)
