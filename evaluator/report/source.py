"""What a report is made from: the evaluation, and clips of its groups, within what a page can hold."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.player.clip import Clip, make_clip
from gpusimbench.evaluator.player.encode import encode
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.verdicts import for_probe
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.metrics import of_table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import swept_only
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.labels import options_given, row_names, short_device
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, GsbError

BUDGET_BYTES = 2_000_000
"""Of all clips of a page, as text."""

_CLIP_BYTES = 500_000
_MOST_RUNS = 16
_UNREADABLE = (GsbError, OSError, *NUMBERS_OF_A_STRANGER)

_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class NotShown:
    """Groups that are not played, and why."""

    labels: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class Playback:
    """What a page plays: groups whose environments part first are first, those that never do last."""

    clips: tuple[Clip, ...]
    not_shown: tuple[NotShown, ...]


def playback_of(results: Sequence[GroupResult], *, budget: int = BUDGET_BYTES) -> Playback:
    """Clips of groups that captured states; measured trials, in which nothing moves, are left out.

    Files are opened again. One that cannot be read any more, or that is not of this machine, is named with the reason.
    """
    moving = [result for result in results if not result.group.measured]
    scenes = {result.group.key.scene for result in moving}
    made: list[Clip] = []
    missing: dict[str, list[str]] = {}
    for result in each(moving, "reading states that the report plays"):
        title = result.label if len(scenes) == 1 else f"{result.label}, {result.group.key.scene}"
        found = _clip(result.group, title)
        if isinstance(found, Clip):
            made.append(found)
        else:
            missing.setdefault(found, []).append(title)
    kept = list(_within(sorted(made, key=_turn), budget, missing))
    return Playback(tuple(kept), tuple(NotShown(tuple(labels), reason) for reason, labels in missing.items()))


def _clip(group: Group[Run], title: str) -> Clip | str:
    if not group.captured:
        return "no complete run captured states"
    runs = [run for run in group.complete if "capture" in run.configuration.phases]
    paths = [run.path for run in runs[:_MOST_RUNS] if isinstance(run.path, Path)]
    if not paths:
        return "its recordings are elsewhere; gsb-view shows them"
    try:
        clip = make_clip([Recording(path) for path in paths], title=title, budget=_CLIP_BYTES)
    except _UNREADABLE as error:
        # numbers of a stranger that numpy cannot take, too; evaluator.inputs.reader reads them the same way
        return str(error) or type(error).__name__
    return clip


def _turn(clip: Clip) -> tuple[bool, int]:
    first = clip.changes.first_divergence if clip.changes else None
    return first is None, first or 0


def _within(clips: Iterable[Clip], budget: int, missing: dict[str, list[str]]) -> Iterator[Clip]:
    for clip in clips:
        size = len(encode(clip))
        if size > budget:
            missing.setdefault("there is no more room in this page; gsb-view shows them", []).append(clip.title)
            continue
        budget -= size
        yield clip


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
