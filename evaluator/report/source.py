"""What a report is made from."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.player.playback import Playback
from gpusimbench.evaluator.report.verdicts import for_probe
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.metrics import of_table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import swept_only
from gpusimbench.evaluator.runs.labels import options_given, row_names, short_device

_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


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
        """Groups that are shown one by one; those that only gsb-probe needs come last."""
        found = [r for r in self.evaluation.results if r.label not in self._swept]
        return sorted(found, key=for_probe)

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
    def names(self) -> dict[str, str]:
        """By label, what the rows of tables call a group: they have columns for the scene, the device and the size."""
        results = self.evaluation.results
        marks = [self.marks.get(r.footnotes, "") for r in results]
        given = options_given(run for r in results for run in r.group.recordings)
        named = row_names([r.group.key for r in results], given, marks)
        return {r.label: name for r, name in zip(results, named, strict=True)}

    def title(self, result: GroupResult) -> str:
        """What figures of a scene call a group: its name in tables, and device and size where the scene has several."""
        of_scene = [r.group.key for r in self.shown if r.group.key.scene == result.group.key.scene]
        key, parts = result.group.key, [self.names[result.label]]
        if len({other.device for other in of_scene}) > 1:
            parts.append(short_device(key.device) or "no device")
        if len({other.n_env for other in of_scene}) > 1:
            parts.append(f"{key.n_env:,} env{'' if key.n_env == 1 else 's'}")
        return ", ".join(parts)

    @cached_property
    def marks(self) -> dict[tuple[str, ...], str]:
        """The marks of footnotes, one for all that a group has: ¹ to ⁹, ¹⁰ and so on."""
        found = dict.fromkeys(r.footnotes for r in self.evaluation.results if r.footnotes)
        return {said: str(number).translate(_RAISED) for number, said in enumerate(found, start=1)}

    @cached_property
    def _swept(self) -> set[str]:
        return swept_only(self.evaluation.results, self.evaluation.sweeps)
