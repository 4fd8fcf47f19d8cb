"""Who is fastest in a scene on a device, among those that nothing speaks against."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.results.cost_metrics import FPS, ranked_throughput, ranked_words, shown_slower
from gpusimbench.evaluator.results.faults import checked_anywhere, faults_anywhere
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.timed_work import largest_comparable, window_key
from gpusimbench.evaluator.results.toss_metrics import TOSS_POSITION, Ranked, configuration, ranked
from gpusimbench.evaluator.runs.groups import is_instrument
from gpusimbench.schemas.gathering import gathered

_UNKNOWN = "no run of this configuration has errors against tosses"


@dataclass(frozen=True)
class Speed:
    """The fastest group of a simulator in one scene on one device, of its complete runs.

    unchecked  whether no check of mechanics could be made of its engine, in any scene
    """

    scene: str
    device: str
    result: GroupResult
    unchecked: bool = False

    @property
    def fps(self) -> float:
        """Throughput by which it is ranked [env-steps/s]."""
        return ranked_throughput(self.result.metrics[FPS.name])

    @property
    def said(self) -> str:
        """That throughput in words, with its unit."""
        return ranked_words(self.result.metrics[FPS.name])


@dataclass(frozen=True)
class Fastest:
    """Of the simulators that were timed over the same steps of one scene on one device: the fastest, and the next.

    The same steps are those of one window_key.

    scene, device  of all of them
    first, second  of them no run is INVALID, and no check of mechanics and no law in closed form broken, in any scene,
                   and their throughput meets the protocol's rules on the timed window and on evidence of work; where
                   errors against tosses are known, theirs cannot be told apart from the smallest; None where
                   nobody is left
    faster         groups with a higher throughput that are not named first, each with the reason: of the groups of one
                   simulator with one kind of reason, the fastest
    remarks        what must be known to compare the two
    other_steps    of each simulator without a group over the same timed steps: its fastest group over other timed
                   steps, if the throughput of that group is above that of `first`
    """

    scene: str
    device: str
    first: Speed | None
    second: Speed | None
    faster: tuple[tuple[Speed, str], ...]
    remarks: tuple[str, ...]
    other_steps: tuple[Speed, ...] = ()

    @property
    def rival(self) -> Speed | None:
        """The next, where its throughput is not shown to be lower than that of the first; see shown_slower."""
        if self.first is None or self.second is None:
            return None
        first, second = (speed.result.metrics[FPS.name] for speed in (self.first, self.second))
        return None if shown_slower(second, first) else self.second


def not_ranked(found: Fastest, results: Sequence[GroupResult]) -> dict[str, list[GroupResult]]:
    """Groups that were faster than the first one named, by the kind of reason why they are not ranked."""
    return gathered((_kind(speed.result, reason, results), speed.result) for speed, reason in found.faster)


def fastest(results: Sequence[GroupResult]) -> Iterator[Fastest]:
    """For each scene and device, among groups that can be compared.

    Of several sets of such groups, the one whose environments begin and stay as the scene says, then the largest.
    """
    clocked = gathered(
        ((r.group.key.scene, r.group.key.device), r)
        for r in results
        if not (isinstance(r.metrics["fps"].value, Missing) or is_instrument(r.group.key))
    )
    for (scene, device), found in sorted(clocked.items()):
        alike = largest_comparable(found, lambda r: r.group.key, lambda r: window_key(r.group.key, r.timed))
        if not alike:
            continue
        faults = {r.label: speaks_against(r, results) for r in alike}
        # where errors against tosses are known: among those that cannot be told apart from the most accurate
        measured = [r for r in results if (r.group.key.scene, r.group.key.device) == (scene, device)]
        measured = [r for r in measured if known(r.metrics[TOSS_POSITION.name].value) is not None]
        against = {r.label: speaks_against(r, results) for r in measured}
        if accurate := ranked([r for r in measured if not against[r.label]]):
            errs = {
                **{configuration(r): against[r.label] for r in measured},
                **{configuration(one.result): one.less_accurate for one in accurate},
            }
            faults |= {r.label: errs.get(configuration(r), _UNKNOWN) for r in alike if not faults[r.label]}
        sound = _best([r for r in alike if not faults[r.label]], scene, device)[:2]
        sound = [replace(s, unchecked=not checked_anywhere(s.result, results)) for s in sound]
        kinds = {r.label: _kind(r, faults[r.label], results) for r in alike if faults[r.label]}
        wrong = _best([r for r in alike if faults[r.label]], scene, device, kinds)
        first, second = (*sound, None, None)[:2]
        others = _best(_timed_otherwise(found, alike), scene, device)
        yield Fastest(
            scene,
            device,
            first,
            second,
            tuple((s, faults[s.result.label]) for s in wrong if first is None or s.fps > first.fps),
            tuple(line for line in timed.remarks(s.result for s in sound) if line != timed.LEGEND),
            tuple(s for s in others if first is None or s.fps > first.fps),
        )


def _timed_otherwise(found: Sequence[GroupResult], alike: Sequence[GroupResult]) -> list[GroupResult]:
    """Groups that differ from `alike` in the timed steps alone, of simulators that have no group in `alike`."""
    compared = {r.group.key.simulator for r in alike}
    _, *conditions = window_key(alike[0].group.key, alike[0].timed)
    others = [r for r in found if r.group.key.simulator not in compared]
    return [r for r in others if list(window_key(r.group.key, r.timed)[1:]) == conditions]


def _kind(result: GroupResult, reason: str, results: Sequence[GroupResult]) -> str:
    """What kind a reason is of; the section on throughput has the reason in full."""
    if faults_anywhere(result, results):
        return "INVALID, misplaced contacts, or mechanics broken"
    if speaks_against(result, results):
        return f"{PROTOCOL} not met: timed steps, or evidence of work"
    return "errors against the tosses not known" if reason == _UNKNOWN else "larger error against the tosses"


def speaks_against(result: GroupResult, results: Sequence[GroupResult]) -> str:
    """Why a throughput is not named, in words; empty where nothing speaks against it."""
    return _against([result], results)


def speaks_against_pair(one: Ranked, results: Sequence[GroupResult]) -> str:
    """The same of errors against tosses, and of the throughput that stands beside them."""
    return _against([one.result, *([one.timed] if one.timed else ())], results)


def _against(groups: Sequence[GroupResult], results: Sequence[GroupResult]) -> str:
    found = [wrong for each in groups for wrong in faults_anywhere(each, results)]
    return "; ".join(dict.fromkeys(filter(None, (*found, *(each.timed.unmet.of_throughput for each in groups)))))


def _best(
    results: Sequence[GroupResult], scene: str, device: str, kinds: Mapping[str, str] = MappingProxyType({})
) -> list[Speed]:
    """The fastest group of each simulator, and of each kind that labels have, the fastest first."""
    ordered = sorted((Speed(scene, device, r) for r in results), key=lambda speed: -speed.fps)
    best: dict[tuple[str, str], Speed] = {}
    for speed in ordered:
        best.setdefault((speed.result.group.key.simulator, kinds.get(speed.result.label, "")), speed)
    return list(best.values())
