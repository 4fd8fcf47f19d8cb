"""Episodes of tasks: how many ended, how they ended, how long they were, and what they returned."""

from __future__ import annotations

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.episodes import EpisodeCounts
from gpusimbench.evaluator.render.document import Cell, Row, Section, table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.sections.rows import facets, named
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import plural

_TITLES = ("group", "envs x runs", "steps", "ended", "terminated", "truncated", "cut", "mean length", "mean return")
_LEGEND = (
    "cut: episodes that a reset of the user or the end of the recording ended. They are in no mean.",
    "Means are over the episodes that ended within the recorded steps, of all complete runs. Short episodes are more "
    "frequent among these: gsb-episodes takes as many episodes of every environment, and gives intervals.",
)


def section(source: Source) -> Section | None:
    """None where no complete run has episodes of a task."""
    found = [(result, counts) for result in source.shown if (counts := counts_of(result))]
    if not found:
        return None
    made = table("episodes", "", _TITLES, [_row(source, *one) for one in found], _LEGEND)
    ended = sum(one.ended for _, counts in found for one in counts)
    return Section("episodes", "Episodes", (made,), f"{plural(ended, 'episode')} ended", folded=True)


def counts_of(result: GroupResult) -> list[EpisodeCounts]:
    """The counts of the complete runs that have episodes."""
    return [run.episodes for run in result.group.complete if not isinstance(run.episodes, Missing)]


def _row(source: Source, result: GroupResult, counts: list[EpisodeCounts]) -> Row:
    whole = (sum(getattr(one, name) for one in counts) for name in ("steps", "ended", "terminated", "truncated", "cut"))
    return Row(
        (
            named(source, result),
            Cell(f"{result.group.key.n_env:,} x {len(counts)}"),
            *(Cell(f"{number:,}", number) for number in whole),
            _mean(counts, "mean_length"),
            _mean(counts, "mean_return"),
        ),
        facets(result.group.key),
    )


def mean_of(counts: list[EpisodeCounts], name: str) -> float | None:
    """The mean over the ended episodes of all runs.

    name  "mean_length" [step] or "mean_return" [unit of the reward]

    None where no episode ended, or a run with episodes has none, as without rewards.
    """
    of = [(getattr(one, name), one.ended) for one in counts if one.ended]
    if not of or any(value is None for value, _ in of):
        return None
    return float(sum(value * ended for value, ended in of) / sum(ended for _, ended in of))


def _mean(counts: list[EpisodeCounts], name: str) -> Cell:
    mean = mean_of(counts, name)
    return Cell(NONE) if mean is None else Cell(f"{mean:.4g}", mean)
