"""Speed against divergence, a figure a scene: which engine is fast, which repeats itself, which does both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from markupsafe import Markup

from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.render.document import Figure, Numbers, key_of
from gpusimbench.evaluator.render.figures.plot import tick_label
from gpusimbench.evaluator.render.figures.scatter import Point, scatter
from gpusimbench.evaluator.render.numbers import figure, interval
from gpusimbench.evaluator.report.sections.rows import absences
from gpusimbench.evaluator.report.sections.scaling import steps_label
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.faults import faults_anywhere
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_POSITION, ranked
from gpusimbench.evaluator.runs.groups import is_instrument
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.schemas.gathering import gathered

_SPEED = "fps"


def pictures(evaluation: Evaluation) -> Iterator[Figure]:
    """A figure for each scene in which a group has both a throughput and a distance."""
    for nth, scene in enumerate(dict.fromkeys(r.group.key.scene for r in evaluation.results)):
        results = [r for r in evaluation.results if r.group.key.scene == scene and not is_instrument(r.group.key)]
        distance = _distance(results)
        if distance == TOSS_POSITION.name:
            results = [one.with_throughput for one in ranked(results)]
        told = [r for r in results if _has_value(r.metrics[_SPEED]) and _has_value(r.metrics[distance])]
        if told:
            yield _picture(scene, told, _absent(results, distance), distance, evaluation, nth)


def _distance(results: Sequence[GroupResult]) -> str:
    """The distance that the scene is drawn with: the first of these that any group has, or the last."""
    if any(_has_value(r.metrics[TOSS_POSITION.name]) for r in results):
        return TOSS_POSITION.name
    return "w1_real" if any(_has_value(r.metrics["w1_real"]) for r in results) else "w1_run_to_run"


def _has_value(found: Estimate) -> bool:
    return not isinstance(found.value, Missing)


def _picture(
    scene: str, told: Sequence[GroupResult], absent: str, distance: str, evaluation: Evaluation, nth: int
) -> Figure:
    speed, far = told[0].metrics[_SPEED].metric, told[0].metrics[distance].metric
    faults = {r.label: "; ".join(faults_anywhere(r, evaluation.results)) for r in told}
    simulators = list(dict.fromkeys(r.group.key.simulator for r in told))
    named = _to_name(told, faults)
    points = [
        _point(r, simulators.index(r.group.key.simulator), named.get(r.label, ""), distance, faults[r.label])
        for r in told
    ]
    svg = scatter(points, across=speed.titled, up=far.titled, across_tick=steps_label, up_tick=tick_label)
    titles = (
        "group", speed.titled, "95 % low", "95 % high", far.titled, "95 % low", "95 % high", "what speaks against it",
        "footnotes",
    )  # fmt: skip
    rows = [
        (r.label, p.speed, *(p.speed_ci or (None, None)), p.divergence, *(p.divergence_ci or (None, None)),
         faults[r.label], "; ".join(r.footnotes))
        for r, p in zip(told, points, strict=True)
    ]  # fmt: skip
    said = _caption(points, told, far.title, absent)
    return Figure(f"Speed and divergence, {scene}", said, Markup(svg), key_of("speed-divergence", nth, scene),
                   Numbers(titles, rows))  # fmt: skip


def _to_name(told: Sequence[GroupResult], faults: dict[str, str]) -> dict[str, str]:
    """Names by label, of the groups that are named: each simulator's fastest without a fault, and a faster with one.

    A name has what tells apart the groups that are named, which is less than what tells apart all.
    """
    chosen: list[GroupResult] = []
    sound = set[str]()
    for result in sorted(told, key=lambda r: (-_value(r.metrics[_SPEED]), r.label)):
        simulator = result.group.key.simulator
        if simulator not in sound and not any(
            simulator == c.group.key.simulator and faults[result.label] for c in chosen
        ):
            chosen.append(result)
        if not faults[result.label]:
            sound.add(simulator)
    names = labels([r.group.key for r in chosen], options_given(run for r in chosen for run in r.group.recordings))
    return {r.label: f"{name}{' †' if r.footnotes else ''}" for r, name in zip(chosen, names, strict=True)}


def _point(result: GroupResult, index: int, name: str, distance: str, fault: str) -> Point:
    speed, far = result.metrics[_SPEED], result.metrics[distance]
    said = [result.label, *(f"{figure(_value(m), m.unit)} {m.unit} {interval(m) if m.ci95 else ''}".strip()
                            for m in (speed, far)), fault, *result.footnotes]  # fmt: skip
    return Point(
        index,
        name,
        _value(speed),
        _value(far),
        speed.ci95 or None,
        far.ci95 or None,
        bool(fault),
        "; ".join(filter(None, said)),
    )


def _value(found: Estimate) -> float:
    assert not isinstance(found.value, Missing)
    return found.value


def _caption(points: Sequence[Point], told: Sequence[GroupResult], far: str, absent: str) -> str:
    said = [f"Right is faster, below is a smaller {far}. Lines: 95 % intervals over runs."]
    if len(points) > len({p.label for p in points if p.label}):
        said.append("Marks of one shape and colour are groups of one simulator, named once or twice.")
    if any(p.broken for p in points):
        said.append("Hollow: invalid, or mechanics do not hold.")
    if zeros := sum(p.divergence == 0 for p in points):
        said.append(f"Shaded strip: exactly 0 ({zeros}).")
    if others := sum(bool(r.footnotes) for r in told):
        one = others == 1
        said.append(
            f"{others} {'group was' if one else 'groups were'} timed or run in another way than the others"
            f"{' (†)' if any('†' in p.label for p in points) else ''}: see the footnotes on labels."
        )
    if absent:
        said.append(f"Not here: {absent}.")
    return " ".join(said)


def _absent(results: Sequence[GroupResult], distance: str) -> str:
    reasons = (
        (next(filter(None, (why_missing(r.metrics[m].value) for m in (_SPEED, distance))), ""), r) for r in results
    )
    return absences(gathered((why, r.label) for why, r in reasons if why))
