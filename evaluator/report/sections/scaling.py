"""Sweeps over the number of environments: curves, how far each goes, every point, and how variability grows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from markupsafe import Markup

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Figure,
    Gallery,
    Numbers,
    Row,
    Section,
    Table,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.figures.scaling import LINE_FROM, Curve, Foreign, scaling_chart
from gpusimbench.evaluator.render.numbers import NONE, bounds, distance, estimate, scaled
from gpusimbench.evaluator.render.table_files import CsvCell
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.rows import facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import DEVICE_MEMORY, FPS, HOST_MEMORY, PROCESS_MEMORY
from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.published import SCALING, AtLargest
from gpusimbench.evaluator.results.sweeps import SOURCES, Accumulation, Sweep, SweepPoint
from gpusimbench.evaluator.runs.groups import beside_cause
from gpusimbench.evaluator.statistics.jackknife import Interval
from gpusimbench.evaluator.statistics.matched import Variability
from gpusimbench.schemas.text import cut, few, plural

_DEVICES = 3  # that a caption names
_LONGEST_END = 160  # characters of why a sweep ended; the whole stands in JSON
_MEMORY = (DEVICE_MEMORY, PROCESS_MEMORY, HOST_MEMORY)
_MARKS = (
    "Both axes are logarithmic. Ring: N_env^max, the largest number of environments with a complete run. Cross: the "
    "next number tried, where no run was complete."
)
_PROPORTION = "Dotted: throughput in proportion to the environments, from the sweep's first point on."
_THIN = "Thin line: the memory model."
_FEW_POINTS = "Sweeps of three points or fewer have no lines."
_HOW = f"{_MARKS} {_PROPORTION} {_THIN} {_FEW_POINTS}"
_MODEL = "memory model: bytes = fixed + per env x N"
_ACCUMULATION = (
    "Whether variability grows as parallelisation increases: W1 [cm] with every run reduced to the same number of "
    "environments, since distances of finite samples fall with their number."
)
_ACCUMULATION_TITLES = (
    "N", "runs", "between runs", "floor", "between envs", "between runs, all envs", "floor, all envs",
)  # fmt: skip
"""Distances are W1 in cm; the first three are of as many environments at each N."""


@dataclass(frozen=True)
class SceneSweeps:
    """The sweeps of one scene, and their figures.

    columns  what stands beside the throughput of a point
    remarks  what must be known to compare the sweeps
    """

    scene: str
    sweeps: list[Sweep]
    charts: list[Figure]
    columns: tuple[timed.Column, ...]
    remarks: list[str]


def beside_published(sweeps: Sequence[Sweep]) -> Iterator[SceneSweeps]:
    """The paper's points at N_env^max, with the sweeps of the same scene where there are any."""
    for scene in ("free-fall", "franka"):
        points = {r.simulator: at for r in SCALING if (at := r.free_fall if scene == "free-fall" else r.franka)}
        yield _with_charts(scene, sweeps, points, f"published-{scene}")


def _with_charts(scene: str, sweeps: Sequence[Sweep], paper: dict[str, AtLargest], key: str) -> SceneSweeps:
    of_scene = [s for s in sweeps if s.key.scene == scene]
    charts = [chart for chart in _charts(scene, of_scene, paper, key) if chart.svg]
    label_of = {point.result.label: sweep.label for sweep in of_scene for point in sweep.points}
    points = [point.result for sweep in of_scene for point in sweep.points]
    remarks = timed.remarks(points, named=lambda result: label_of[result.label])
    return SceneSweeps(scene, of_scene, charts, timed.columns(result.timed for result in points), remarks)


def _charts(scene: str, sweeps: Sequence[Sweep], paper: dict[str, AtLargest], key: str) -> Iterator[Figure]:
    devices = list(dict.fromkeys(device for s in sweeps if (device := s.key.device)))
    where = f"{scene} on {few(devices, _DEVICES)}" if devices else scene
    about = f"{where}, sweeps over the number of environments" + (", with the paper's points" if paper else "")
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
        [*(row for _, sweep in of_metric for row in _numbers_of(sweep, metric.name)),
         *((one.label, one.n_env, one.value, *[None] * (4 + len(timed.ALL)), "published") for one in foreign)],
    )  # fmt: skip
    reading = _reading([s for _, s in of_metric], _THIN if metric in _MEMORY else _PROPORTION)
    return Figure(value, "", Markup(svg) if svg else None, key, numbers, about, reading)


def _reading(sweeps: Sequence[Sweep], line: str) -> str:
    runs = [point.complete for sweep in sweeps for point in sweep.points if point.complete]
    said = [_MARKS]
    if runs:
        fewest = "" if min(runs) == max(runs) else f"{min(runs)} to "
        said.insert(0, f"Each mark is the mean of {fewest}{plural(max(runs), 'run')}.")
    if any(len(curve.points) >= LINE_FROM for curve in sweeps):
        said += [line, _FEW_POINTS]
    return " ".join(said)


def _numbers_of(sweep: Sweep, name: str) -> Iterator[tuple[CsvCell, ...]]:
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
        ends=f"N_env^max {sweep.n_max}: {cut(sweep.ends, _LONGEST_END)}",
    )


def steps_label(value: float) -> str:
    """A number of steps or environments as a tick's label."""
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= scale:
            return f"{value / scale:g}{letter}"
    return f"{value:g}"


def section(source: Source) -> Section | None:
    """None without a sweep that measures something: tasks are recorded with several numbers of environments too."""
    measured = [sweep for sweep in source.evaluation.sweeps if sweep.measured]
    scenes = enumerate(dict.fromkeys(s.key.scene for s in measured))
    found = [_with_charts(scene, measured, {}, key_of("scaling", nth, scene)) for nth, scene in scenes]
    if not found:
        return None
    blocks: list[Block] = []
    for scene in found:
        sweeps = plural(len(scene.sweeps), "sweep")
        parts, folded = tuple(_of_scene(scene)), len(found) > 1
        blocks.append(Section(f"scaling-{scene.scene}", scene.scene, parts, sweeps, folded=folded))
    furthest = max((s for s in measured if s.n_max), key=lambda s: s.n_max or 0, default=None)
    said = f"largest number of environments: {furthest.n_max:,} ({furthest.label})" if furthest else ""
    return Section("scaling", "Scaling over the number of environments", tuple(blocks), said, folded=True)


def sentence(sweep: Sweep) -> str:
    """How far a sweep goes, why it ends, and what an environment costs in memory."""
    largest = "no run is complete"
    if sweep.n_max is not None:
        largest = f"most environments (N_env^max) {sweep.n_max:,}: {cut(sweep.ends, _LONGEST_END)}"
    model = sweep.models.get(sweep.memory)
    memory = [f"memory = {words.model(model)} ({SOURCES[sweep.memory]})"] if model else []
    memory += [f"no memory model: {model.reason}"] if isinstance(model, Missing) else []
    return f"{sweep.label}, {sweep.key.scene}: {'; '.join([largest, *memory])}"


def _of_scene(found: SceneSweeps) -> Iterator[Block]:
    if found.charts:
        yield Gallery(tuple(found.charts), 28)
        yield Text(_HOW, Tone.QUIET)
    largest = table(
        f"scaling-largest-{found.scene}",
        f"How far the sweeps of {found.scene} go",
        ["sweep", "N_env^max", FPS.titled, "memory increment", "why it ends", _MODEL],
        [_sweep(sweep, found) for sweep in found.sweeps],
    )
    yield replace(largest, opened="An opened row shows the sweep point by point.")
    if found.remarks:
        yield items(*found.remarks)


def _sweep(sweep: Sweep, found: SceneSweeps) -> Row:
    where = f"{sweep.key.version or 'no version'}; {sweep.key.device or 'no device'}"
    best = sweep.at_max
    models = [
        f"{f'no model: {model.reason}' if isinstance(model, Missing) else words.model(model)} ({SOURCES[name]})"
        for name, model in sweep.models.items()
    ]
    largest = Cell(NONE, notes=("no run is complete",))
    if sweep.n_max is not None:
        largest = Cell(f"{sweep.n_max:,}", float(sweep.n_max))
    return Row(
        (
            Cell(sweep.label, notes=(where,)),
            largest,
            estimate(best.metrics[FPS.name]) if best else Cell(NONE),
            Cell(words.amount(best.metrics[sweep.memory]) if best else NONE),
            Cell(sweep.ends),
            Cell("; ".join(models) or NONE),
        ),
        facets(sweep.key),
        (_points(sweep, found),),
    )


def _points(sweep: Sweep, found: SceneSweeps) -> Table:
    titles = ("envs", FPS.titled, *(c.title for c in found.columns), "memory increment", "allocator's peak",
              "contacts per env: mean / max", "build; compile [s]", "runs")  # fmt: skip
    name = key_of("scaling-points", found.scene, sweep.label)
    return table(name, f"{sweep.label}, {found.scene}", titles, [_point(sweep, point, found) for point in sweep.points])


def _point(sweep: Sweep, point: SweepPoint, found: SceneSweeps) -> Row:
    metrics = point.result.metrics
    failures = tuple(f"{failure.short}: {beside_cause(failure.cause, failure.reason)}" for failure in point.failures)
    runs = f"{point.complete} of {len(point.recordings)} complete"
    return Row(
        (
            Cell(f"{point.n_env:,}", float(point.n_env)),
            estimate(metrics[FPS.name]),
            *map(Cell, timed.cells(found.columns, point.result.timed)),
            Cell(words.amount(metrics[sweep.memory])),
            Cell(words.amount(metrics["allocator_peak"])),
            Cell(words.counted(point.result.validity.of("contacts", "timed", "capture"))),
            Cell(f"{words.cell(metrics['build_time'])}; {words.cell(metrics['compile_time'])}"),
            Cell(runs, notes=failures, tone=Tone.BAD if failures else Tone.PLAIN),
        ),
        facets(sweep.key),
    )


def accumulation(source: Source) -> Section | None:
    """None without a sweep that captured states."""
    found = source.evaluation.accumulation
    if not found:
        return None
    tables = [
        table(
            key_of("accumulation", number, one.label), f"{one.label}, {one.scene}", _ACCUMULATION_TITLES,
            [*_matched(one)], _reduced(one),
        )
        for number, one in enumerate(found)
    ]  # fmt: skip
    title = "Variability against the number of environments"
    return Section("accumulation", title, (Text(_ACCUMULATION), *tables), plural(len(tables), "sweep"), folded=True)


def _matched(found: Accumulation) -> Iterator[tuple[str, ...]]:
    """A row for each number of environments."""
    for point in found.points:
        yield (
            f"{point.n_env:,}",
            str(point.n_run),
            *_cells(point.matched),
            _value(point.matched.parallel),
            *(_cells(point.raw) if point.raw else (NONE, NONE)),
        )


def _reduced(found: Accumulation) -> list[str]:
    """Notes that a reader of the rows needs."""
    envs = plural(found.size, "environment")
    lines = [
        f"each run reduced to {envs}, mean of {found.draws} draws with seed {found.seed}; in brackets 95 % over runs",
        "distances of all environments fall with their number, as their floor does, and are not to be compared",
    ]
    too_many = ((p.n_env, p.raw.reason) for p in found.points if isinstance(p.raw, Missing))
    return [*lines, *dict.fromkeys(f"N = {n_env:,}, all envs: {reason}" for n_env, reason in too_many)]


def _cells(found: Variability) -> tuple[str, str]:
    return _value(found.run_to_run), NONE if found.floor is None else distance(found.floor)


def _value(found: Interval | None) -> str:
    if found is None:
        return NONE
    if not found.ci95:
        return distance(found.estimate)
    return f"{distance(found.estimate)} {bounds(found.ci95, distance)}"
