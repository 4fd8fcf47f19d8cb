"""Clips of the groups of an evaluation: read once more from their files, within what a page can hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.player.clip import Clip, make_clip
from gpusimbench.evaluator.player.encode import encode
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, GsbError

BUDGET_BYTES = 2_000_000
"""Of all clips of a page, as text."""

_CLIP_BYTES = 500_000
_MOST_RUNS = 16
_UNREADABLE = (GsbError, OSError, *NUMBERS_OF_A_STRANGER)


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
