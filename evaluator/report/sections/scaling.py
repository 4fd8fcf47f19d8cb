"""Throughput and memory against the number of environments: curves, how far each sweep goes, and every point."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Gallery,
    Row,
    Section,
    Table,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE, estimate
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.scaling import LONGEST_END, SceneSweeps, scene_sweeps
from gpusimbench.evaluator.report.sections.rows import facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.sweeps import SOURCES, Sweep, SweepPoint
from gpusimbench.schemas.text import cut, plural

_HOW = (
    "Both axes are logarithmic. Ring: N_env^max, the largest number of environments with a complete run. Cross: the "
    "next number tried, where no run was complete. Dotted: throughput in proportion to the environments, from the "
    "sweep's first point on. Thin line: the memory model. Sweeps of three points or fewer have no lines."
)

_MODEL = "memory model: bytes = fixed + per env x N"


def section(source: Source) -> Section | None:
    """None without a sweep that measures something: tasks are recorded with several numbers of environments too."""
    measured = [sweep for sweep in source.evaluation.sweeps if sweep.measured]
    found = list(scene_sweeps(measured))
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
        largest = f"most environments (N_env^max) {sweep.n_max:,}: {cut(sweep.ends, LONGEST_END)}"
    model = sweep.models.get(sweep.memory)
    memory = [f"memory = {words.model(model)} ({SOURCES[sweep.memory]})"] if model else []
    memory += [f"no memory model: {model.reason}"] if isinstance(model, Missing) else []
    return f"{sweep.label}, {sweep.key.scene}: {'; '.join([largest, *memory])}"


def _of_scene(found: SceneSweeps) -> Iterator[Block]:
    sweeps = [sweep for _, sweep in found.sweeps]
    if found.charts:
        yield Gallery(tuple(found.charts), 28)
        yield Text(_HOW, Tone.QUIET)
    yield table(
        f"scaling-largest-{found.scene}",
        f"How far the sweeps of {found.scene} go",
        [
            "sweep",
            "N_env^max",
            FPS.titled,
            "memory increment",
            "why it ends",
            _MODEL,
        ],
        [_sweep(sweep, found) for sweep in sweeps],
        ["An opened row shows the sweep point by point."],
    )
    if found.remarks:
        yield items(*found.remarks)


def _sweep(sweep: Sweep, found: SceneSweeps) -> Row:
    where = f"{sweep.key.version or 'no version'}; {sweep.key.device or 'no device'}"
    best = sweep.at_max
    models = [
        f"{f'no model: {model.reason}' if isinstance(model, Missing) else words.model(model)} ({SOURCES[name]})"
        for name, model in sweep.models.items()
    ]
    largest = (
        Cell(NONE, notes=("no run is complete",))
        if sweep.n_max is None
        else Cell(f"{sweep.n_max:,}", float(sweep.n_max))
    )
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
    failures = tuple(f"{failure.short}: {failure.reason}" for failure in point.failures)
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
