"""What the recordings say, in a few lines: who is fastest, whose bits agree, what is invalid, what cannot be said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.claims import Tally, tally
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.faults import faults_anywhere
from gpusimbench.evaluator.results.fidelity import Verdict
from gpusimbench.evaluator.results.identity_metrics import identical
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.timed_work import most_common, window_key
from gpusimbench.evaluator.runs.groups import is_instrument, shown_status


@dataclass(frozen=True)
class Speed:
    """The fastest group of a simulator in one scene on one device, of its complete runs."""

    scene: str
    device: str
    result: GroupResult

    @property
    def fps(self) -> float:
        """Throughput [env-steps/s]."""
        return known(self.result.metrics["fps"].value) or 0.0

    @property
    def broken(self) -> bool:
        """Whether a check of mechanics is broken in its group."""
        return bool(self.result.fidelity.of(Verdict.BROKEN))


@dataclass(frozen=True)
class SimulatorSummary:
    """One simulator over all its groups.

    instrument  whether it is a control with a known answer, which is not ranked
    speeds      by scene and device
    same_envs   groups of which all environments of a run are bit-identical, of those in which that was compared
    same_runs   groups of which all runs are bit-identical, likewise
    runs        recordings; `troubled` of them by how they ended
    broken      groups in which some check of mechanics is broken; `checked` of which any could be made
    """

    name: str
    versions: tuple[str, ...]
    instrument: bool
    speeds: tuple[Speed, ...]
    same_envs: Tally
    same_runs: Tally
    runs: int
    troubled: dict[str, int]
    broken: int
    checked: int


@dataclass(frozen=True)
class Fastest:
    """Of the simulators that were timed over the same steps of one scene on one device: the fastest, and the next.

    scene, device  of all of them
    first, second  of them no run is INVALID and no check of mechanics broken, in any scene; None where nobody is left
    faster         groups of other simulators with a higher throughput that are not named first, each with the reason
    otherwise      simulators that were timed over other steps, which cannot be compared
    remarks        what must be known to compare the two
    """

    scene: str
    device: str
    first: Speed | None
    second: Speed | None
    faster: tuple[tuple[Speed, str], ...]
    otherwise: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...]


def section(source: Source) -> Section | None:
    """None where no group is left."""
    evaluation = source.evaluation
    if not evaluation.results:
        return None
    simulators = [
        _of(name, [r for r in evaluation.results if r.group.key.simulator == name])
        for name in dict.fromkeys(r.group.key.simulator for r in evaluation.results)
    ]
    context = {
        "simulators": simulators,
        "fastest": list(_fastest(evaluation.results)),
        "no_reference": _no_reference(evaluation),
    }
    return Section("summary", "What these recordings say", context, link="Summary")


def _of(name: str, results: Sequence[GroupResult]) -> SimulatorSummary:
    troubled: dict[str, int] = {}
    recordings = [one for r in results for one in r.group.recordings]
    for one in recordings:
        if not one.usable:
            how = "lost data" if one.status == "complete" else shown_status(one)
            troubled[how] = troubled.get(how, 0) + 1
    return SimulatorSummary(
        name,
        tuple(dict.fromkeys(r.group.key.version for r in results if r.group.key.version)),
        all(is_instrument(r.group.key) for r in results),
        tuple(_speeds(results)),
        tally(identical(r.metrics["distinct_envs"]) for r in results),
        tally(identical(r.metrics["distinct_runs"]) for r in results),
        len(recordings),
        troubled,
        sum(bool(r.fidelity.of(Verdict.BROKEN)) for r in results),
        sum(bool(r.fidelity.of(Verdict.BROKEN) or r.fidelity.of(Verdict.HELD)) for r in results),
    )


def _speeds(results: Sequence[GroupResult]) -> Iterator[Speed]:
    best: dict[tuple[str, str], Speed] = {}
    for result in results:
        key = result.group.key
        one = Speed(key.scene, key.device, result)
        before = best.get((key.scene, key.device))
        if not isinstance(result.metrics["fps"].value, Missing) and (before is None or one.fps > before.fps):
            best[key.scene, key.device] = one
    yield from (best[at] for at in sorted(best))


def _fastest(results: Sequence[GroupResult]) -> Iterator[Fastest]:
    """Of each scene and device, among the groups that were timed over the steps that most of them were timed over."""
    clocked: dict[tuple[str, str], list[GroupResult]] = {}
    for result in results:
        key = result.group.key
        if not (isinstance(result.metrics["fps"].value, Missing) or is_instrument(key)):
            clocked.setdefault((key.scene, key.device), []).append(result)
    for (scene, device), found in sorted(clocked.items()):
        windows = [window_key(r.group.key, r.timed) for r in found]
        usual = most_common(windows)
        alike = [r for r, window in zip(found, windows, strict=True) if window == usual]
        faults = {r.label: "; ".join(faults_anywhere(r, results)) for r in alike}
        if len({r.group.key.simulator for r in alike}) < 2:
            continue
        sound = _best([r for r in alike if not faults[r.label]], scene, device)
        wrong = _best([r for r in alike if faults[r.label]], scene, device)
        first, second = (*sound, None, None)[:2]
        yield Fastest(
            scene,
            device,
            first,
            second,
            tuple((s, faults[s.result.label]) for s in wrong if first is None or s.fps > first.fps),
            tuple((r.label, r.timed.said) for r, window in zip(found, windows, strict=True) if window != usual),
            tuple(line for line in timed.remarks(s.result for s in sound[:2]) if line != timed.LEGEND),
        )


def _best(results: Sequence[GroupResult], scene: str, device: str) -> list[Speed]:
    """The fastest group of each simulator, the fastest first."""
    ordered = sorted((Speed(scene, device, r) for r in results), key=lambda speed: -speed.fps)
    best: dict[str, Speed] = {}
    for speed in ordered:
        best.setdefault(speed.result.group.key.simulator, speed)
    return list(best.values())


def _no_reference(evaluation: Evaluation) -> str:
    """Why distances to real trials are missing; empty where they are not."""
    if evaluation.reference is None:
        return evaluation.reference_note
    return "" if evaluation.reference.measured else "the reference is another simulation, not measured"
