"""What speaks against taking a group's figures for a merit: work that was not done, bodies that fell through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluator.fidelity import Verdict
from evaluator.groups import settings_asked, shown_status
from evaluator.physics.facts import Check
from evaluator.results import GroupResult


@dataclass(frozen=True)
class Faults:
    """What is wrong with a group, each in words; empty where nothing of the kind was found.

    invalid  runs that are INVALID: their steps did not do all of their work
    sunk     cubes that went through the floor
    broken   other checks of mechanics that do not hold
    """

    invalid: str
    sunk: str
    broken: str

    def __str__(self) -> str:
        return "; ".join(part for part in (self.invalid, self.sunk, self.broken) if part)

    def __bool__(self) -> bool:
        return bool(str(self))


def faults(result: GroupResult) -> Faults:
    """What the recordings of a group show against it."""
    return Faults(_invalid(result), _sunk(result), _broken(result))


def faults_in_other_scenes(result: GroupResult, results: Sequence[GroupResult]) -> tuple[str, ...]:
    """What the same settings show against them in other scenes, each with the scene."""
    key, scene = settings_asked(result.group.recordings), result.group.key.scene
    others = [r for r in results if r.group.key.scene != scene and settings_asked(r.group.recordings) == key]
    return tuple(dict.fromkeys(f"{r.group.key.scene}: {wrong}" for r in others if (wrong := faults(r))))


def _invalid(result: GroupResult) -> str:
    runs = result.group.recordings
    found = [r for r in runs if r.status == "invalid"]
    if not found:
        return ""
    said = ", ".join(dict.fromkeys(shown_status(r) for r in found))
    return f"{len(found)} of {len(runs)} {'run is' if len(runs) == 1 else 'runs are'} {said}"


def _sunk(result: GroupResult) -> str:
    metric = result.metrics.get("sank")
    if metric is None or not metric.value:
        return ""
    if metric.value < 0.1:  # few enough to be counted one by one
        return f"{metric.extra['total']:,} of {metric.extra['of']:,} cubes sank"
    return f"{metric.value:.3g} of {metric.extra['of'] // metric.n} cubes per env sank"


def _broken(result: GroupResult) -> str:
    rows = [row for row in result.fidelity.of(Verdict.BROKEN) if row.check is not Check.SANK]
    return "broken: " + ", ".join(row.check.title for row in rows) if rows else ""
