"""What a report is made from."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.player.playback import Playback
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.metrics import of_table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import swept_only


@dataclass(frozen=True)
class Source:
    """What a page is made from.

    evaluation  that it shows
    published   whether the paper's figures are shown as well, marked as the paper's
    command     that made the page, as a shell would take it
    playback    environments in motion; None where the page is to have none
    """

    evaluation: Evaluation
    published: bool
    command: str
    playback: Playback | None = None

    @cached_property
    def shown(self) -> list[GroupResult]:
        """Groups that are shown one by one."""
        return [r for r in self.evaluation.results if r.label not in self._swept]

    @cached_property
    def hidden(self) -> list[GroupResult]:
        """Groups that are points of a sweep and captured no states."""
        return [r for r in self.evaluation.results if r.label in self._swept]

    def columns(self, table: Table, folded: Collection[str] = ()) -> list[Metric]:
        """Metrics that a table shows: without those of `folded`, and optional ones that no group has."""
        return [
            metric
            for metric in of_table(table)
            if metric.name not in folded
            and not (metric.optional and all(isinstance(r.metrics[metric.name].value, Missing) for r in self.shown))
        ]

    @cached_property
    def _swept(self) -> set[str]:
        return swept_only(self.evaluation.results, self.evaluation.sweeps)
