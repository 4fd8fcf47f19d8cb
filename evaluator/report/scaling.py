"""What the HTML page shows of sweeps: the curves of each scene, and the paper's points beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from markupsafe import Markup

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import Figure, Numbers, key_of
from gpusimbench.evaluator.render.figures import lines
from gpusimbench.evaluator.render.figures.scaling import Curve, Foreign, scaling_chart
from gpusimbench.evaluator.render.numbers import scaled
from gpusimbench.evaluator.render.table_files import CsvCell
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.results.cost_metrics import DEVICE_MEMORY, FPS, HOST_MEMORY, PROCESS_MEMORY
from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.published import SCALING, AtLargest
from gpusimbench.evaluator.results.sweeps import Sweep
from gpusimbench.schemas.text import cut

LONGEST_END = 160  # characters of why a sweep ended; the whole stands in JSON
_MEMORY = (DEVICE_MEMORY, PROCESS_MEMORY, HOST_MEMORY)


@dataclass(frozen=True)
class SceneSweeps:
    """The sweeps of one scene, each with its swatch, and their figures.

    columns  what stands beside the throughput of a point
    remarks  what must be known to compare the sweeps
    """

    scene: str
    sweeps: list[tuple[Markup, Sweep]]
    charts: list[Figure]
    columns: tuple[timed.Column, ...]
    remarks: list[str]


def scene_sweeps(sweeps: Sequence[Sweep]) -> Iterator[SceneSweeps]:
    """By scene, in order."""
    for nth, scene in enumerate(dict.fromkeys(s.key.scene for s in sweeps)):
        of_scene = [s for s in sweeps if s.key.scene == scene]
        marked = [(Markup(lines.swatch(i)), s) for i, s in enumerate(of_scene)]
        charts = [c for c in _charts(scene, of_scene, {}, key_of("scaling", nth, scene)) if c.svg]
        yield _of_scene(scene, marked, charts)


def beside_published(sweeps: Sequence[Sweep]) -> Iterator[SceneSweeps]:
    """The paper's points at N_env^max, with the sweeps of the same scene where there are any."""
    for scene in ("free-fall", "franka"):
        of_scene = [s for s in sweeps if s.key.scene == scene]
        marked = [(Markup(lines.swatch(i)), s) for i, s in enumerate(of_scene)]
        points = {r.simulator: at for r in SCALING if (at := r.free_fall if scene == "free-fall" else r.franka)}
        charts = _charts(scene, of_scene, points, f"published-{scene}")
        yield _of_scene(scene, marked, [c for c in charts if c.svg])


def _of_scene(scene: str, marked: list[tuple[Markup, Sweep]], charts: list[Figure]) -> SceneSweeps:
    label_of = {point.result.label: sweep.label for _, sweep in marked for point in sweep.points}
    points = [point.result for _, sweep in marked for point in sweep.points]
    lines = timed.remarks(points, named=lambda result: label_of[result.label])
    return SceneSweeps(scene, marked, charts, timed.columns(result.timed for result in points), lines)


def _charts(scene: str, sweeps: Sequence[Sweep], paper: dict[str, AtLargest], key: str) -> Iterator[Figure]:
    about = f"{scene}, sweeps over the number of environments" + (", with the paper's points" if paper else "")
    speed = [Foreign(name, at.n_env_max, at.fps) for name, at in paper.items()]
    yield _chart(steps_label, sweeps, FPS, speed, f"{key}-throughput", about)
    for metric in _MEMORY:
        memory = [Foreign(name, at.n_env_max, at.memory_gb * 1e9) for name, at in paper.items()]
        if metric is DEVICE_MEMORY or not paper:
            yield _chart(partial(scaled, unit="B"), sweeps, metric, memory, f"{key}-{key_of(metric.title)}", about)


def _chart(
    tick: Callable[[float], str],
    sweeps: Sequence[Sweep],
    metric: Metric,
    foreign: list[Foreign],
    key: str,
    about: str,
) -> Figure:
    """A metric of the sweeps that have it, and the published points; without a picture where nothing is measured."""
    of_metric = [(i, s) for i, s in enumerate(sweeps) if metric not in _MEMORY or s.memory == metric.name]
    curves = [_curve(i, s, metric.name) for i, s in of_metric]
    value = metric.title if metric in _MEMORY else metric.titled
    svg = scaling_chart(curves, value=value, tick=tick, foreign=foreign)
    numbers = Numbers(
        ("sweep", "environments", f"{metric.title} [{metric.base_unit}]", "95 % low", "95 % high",
         *(c.title for c in timed.ALL), "complete runs", "memory model [B]", "what"),
        [*(row for _, sweep in of_metric for row in _rows(sweep, metric.name)),
         *((one.label, one.n_env, one.value, *[None] * (4 + len(timed.ALL)), "published") for one in foreign)],
    )  # fmt: skip
    return Figure(value, "", Markup(svg) if svg else None, key, numbers, about)


def _rows(sweep: Sweep, name: str) -> Iterator[tuple[CsvCell, ...]]:
    model = sweep.models.get(name)
    for point in sweep.points:
        metric = point.result.metrics[name]
        scale, found = metric.metric.per_unit, (known(metric.value), *(metric.ci95 or (None, None)))
        value, low, high = (None if v is None else v * scale for v in found)
        what = "N_env^max" if point.n_env == sweep.n_max else "" if point.complete else "; ".join(point.causes)
        modelled = model.at(point.n_env) if model else None
        beside = timed.cells(timed.ALL, point.result.timed)
        yield sweep.label, point.n_env, value, low, high, *beside, point.complete, modelled, what


def _curve(index: int, sweep: Sweep, name: str) -> Curve:
    found = [(p.n_env, p.result.metrics[name]) for p in sweep.points]
    points = tuple(
        (float(n), m.value * m.metric.per_unit) for n, m in found if not isinstance(m.value, Missing) and m.value
    )
    model = sweep.models.get(name)
    return Curve(
        index,
        sweep.label,
        points,
        model=model.at if model else None,
        ideal=name == FPS.name,
        n_max=sweep.n_max,
        failed=next((p.n_env for p in sweep.points if p.n_env > (sweep.n_max or 0) and not p.complete), None),
        ends=f"N_env^max {sweep.n_max}: {cut(sweep.ends, LONGEST_END)}",
    )


def steps_label(value: float) -> str:
    """A number of steps or environments as a tick's label."""
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= scale:
            return f"{value / scale:g}{letter}"
    return f"{value:g}"
