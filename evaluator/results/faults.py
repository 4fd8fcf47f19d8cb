"""What speaks against taking a group's figures for a merit: work that was not done, bodies that fell through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.canonical import Law
from gpusimbench.evaluator.results.details import SunkCubes
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey, shown_status
from gpusimbench.evaluator.runs.physics.facts import Check


@dataclass(frozen=True)
class Faults:
    """What is wrong with a group, each in words; empty where nothing of the kind was found.

    invalid    runs that are INVALID: their steps did not do all of their work
    sunk       cubes that went through the floor
    broken     other checks of mechanics that do not hold
    laws       laws in closed form that do not hold
    misplaced  contacts outside of one of their two shapes
    """

    invalid: str = ""
    sunk: str = ""
    broken: str = ""
    laws: str = ""
    misplaced: str = ""

    def __str__(self) -> str:
        return "; ".join(part for part in (self.invalid, self.misplaced, self.sunk, self.broken, self.laws) if part)

    def __bool__(self) -> bool:
        return bool(str(self))


def faults(result: GroupResult) -> Faults:
    """What the recordings of a group show against it."""
    misplaced = result.validity.misplaced
    return Faults(_invalid(result), _sunk(result), _broken(result), _laws(result), misplaced.said if misplaced else "")


def faults_anywhere(result: GroupResult, results: Sequence[GroupResult]) -> tuple[str, ...]:
    """What a group and all others of its engine show against it, in any scene, each with the scene.

    An engine is a simulator of one version on one device, with the options and the level that were asked for. What is
    wrong with another time step of the same scene is not held against it. Laws in closed form are those of the same
    step in every scene, however the environments of the other group begin and whatever differs between them: a law is
    one of the engine, and scenes with laws are recorded with drawn initial states.
    """
    engine = _engine(result)
    others = ((r, _held_against(result, engine, r)) for r in results if r is not result)
    ours = [(result, faults(result)), *others]
    return tuple(dict.fromkeys(f"{wrong} ({r.group.key.scene})" for r, wrong in ours if wrong))


def checked_anywhere(result: GroupResult, results: Sequence[GroupResult]) -> bool:
    """Whether a check of mechanics could be made of a group, or of another group that is held against it."""
    engine = _engine(result)
    return any(r is result or _is_held_against(result, engine, r) for r in results if r.fidelity.checkable)


def _is_held_against(result: GroupResult, engine: GroupKey, other: GroupResult) -> bool:
    """Whether what is wrong with another group, laws aside, is held against a group of an engine."""
    ours, theirs = result.group.key, other.group.key
    return _engine(other) == engine and (theirs.dt == ours.dt or theirs.scene != ours.scene)


def _held_against(result: GroupResult, engine: GroupKey, other: GroupResult) -> Faults:
    """What is wrong with another group that is held against a group of an engine."""
    found, same_step = Faults(), result.group.key.dt == other.group.key.dt
    if other.group.asked.simulator != engine.simulator:
        return found
    if _is_held_against(result, engine, other):
        found = replace(faults(other), laws="")
    if same_step and _begun_anyhow(_engine(other)) == _begun_anyhow(engine):
        found = replace(found, laws=_laws(other))
    return found


def _engine(result: GroupResult) -> GroupKey:
    # packages, driver and variables may differ a little between scenes: what is wrong with one is held against all.
    # Given states, such as tosses, are others with another number of environments
    asked = replace(result.group.asked, conditions="", switches="")
    return asked.with_settings(initial="") if asked.told["initial"].startswith("states:") else asked


def _begun_anyhow(engine: GroupKey) -> GroupKey:
    return engine.with_settings(initial="", vary="", keep="")


def _invalid(result: GroupResult) -> str:
    runs = result.group.recordings
    found = [r for r in runs if r.status == "invalid"]
    if not found:
        return ""
    said = ", ".join(dict.fromkeys(shown_status(r) for r in found))
    return f"{len(found)} of {len(runs)} {'run is' if len(runs) == 1 else 'runs are'} {said}"


def _sunk(result: GroupResult) -> str:
    sank = result.metrics.get("sank")
    if sank is None or isinstance(sank.value, Missing) or not sank.value:
        return ""
    details = sank.of(SunkCubes)
    if sank.value < 0.1:  # few enough to be counted one by one
        return f"{details.total:,} of {details.of:,} cubes sank"
    return f"{sank.value:.3g} of {details.of // sank.n} bodies per env sank"


def _broken(result: GroupResult) -> str:
    rows = [row for row in result.fidelity.of(CheckVerdict.BROKEN) if row.check is not Check.SANK]
    titles = ", ".join(row.check.title for row in rows)
    return f"broken by {result.fidelity.revision.value}: {titles}" if rows else ""


def _laws(result: GroupResult) -> str:
    broken = [law.said for law in result.laws if isinstance(law, Law) and law.held is False]
    return f"laws in closed form broken: {', '.join(broken)}" if broken else ""
