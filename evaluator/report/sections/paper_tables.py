"""The published tables, made again from these recordings in the paper's layout; and the paper's own figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import (
    EMPTY,
    NONE,
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
from gpusimbench.evaluator.render.numbers import missing
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.rows import facets, named
from gpusimbench.evaluator.report.sections.scaling import beside_published
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results import paper_tables, published
from gpusimbench.evaluator.results.cost_metrics import FPS, GPU_MEMORY
from gpusimbench.evaluator.results.determinism_cost import DEFAULT
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.group_metrics import SUFFIX, W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.published import AtLargest, Variability
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey
from gpusimbench.schemas.configuration import TELLING
from gpusimbench.schemas.text import cut, plural

_SPEED = {"free-fall": 1e4, "franka": 1e6}
_EXPONENT = {"free-fall": 4, "franka": 6}
_GB = 1e9
_HOW = (
    "The two tables of the GPUSimBench paper in its layout and digits, computed from these recordings alone. A largest "
    "N that ended by INVALID runs is a limit of the engine's buffers or solver, not of memory; a largest N that "
    "nothing ended is the end of the sweep, and no limit."
)
_ZERO = (
    "A printed 0.00 is a rounded distance; below it stands what it hides, and beside it the counts of bitwise distinct "
    "environments and runs. The paper ran 16 envs x 10 runs."
)
_LEAST = 5e-3  # of a printed distance [cm]: two decimals round it to 0.00


@dataclass(frozen=True)
class Printed:
    """A value as the paper prints it, its interval, and what the printed digits hide; or why there is none."""

    value: str = ""
    interval: str = ""
    note: str = ""
    why_not: str = ""


@dataclass(frozen=True)
class VariabilityRow:
    """One group of the second table, with the paper's row of its simulator."""

    result: GroupResult
    real: Printed
    parallel: Printed
    run_to_run: Printed
    faults: Faults
    paper: Variability | None


def section(source: Source) -> Section | None:
    """None where nothing here is of the published scenes."""
    capability = paper_tables.capability(source.evaluation.sweeps, source.evaluation.results)
    shown = [r for r in paper_tables.variability(source.evaluation.results) if r in source.shown]
    # beside the default, if there is one: the paper tells of no other level
    shown.sort(key=lambda r: r.group.key.determinism != DEFAULT)
    rows = [_row(r, source, first=_is_first(r, shown)) for r in shown]
    if not capability and not rows:
        return None
    blocks: list[Block] = [Text(_HOW)]
    if capability:
        paper = {r.simulator: r for r in published.SCALING} if source.published else {}
        blocks += [_capability(scene, capability, paper) for scene in paper_tables.CAPABILITY_SCENES]
        if notes := [line for scene in paper_tables.CAPABILITY_SCENES for line in _timed_remarks(capability, scene)]:
            blocks.append(items(*notes))
    if rows:
        blocks.append(_variability(source, rows))
    if missing := _missing(source):
        blocks.append(Text(f"Of the paper's simulators, no complete run is here of {', '.join(missing)}."))
    counts = (("capability", len(capability)), ("variability", len(rows)))
    said = ", ".join(f"{plural(count, 'row')} of {what}" for what, count in counts if count)
    return Section("remade", "The paper's tables, made again", tuple(blocks), said, folded=True)


def _capability(scene: str, rows: Sequence[paper_tables.Capability], paper: dict[str, published.Scaling]) -> Table:
    shown: list[Row] = []
    for row in rows:
        at = row.at.get(scene)
        if at is not None:
            shown.append(_at_max(row, at, scene))
        told = paper.get(published.NAMES.get(row.key.simulator, ""))
        foreign = None if told is None else told.free_fall if scene == "free-fall" else told.franka
        if foreign is not None and at is not None:
            shown.append(_of_paper(foreign, scene))
    speed = f"throughput [10^{_EXPONENT[scene]} env-steps/s]"
    titles = ("simulator", "N_env^max", speed, "memory [GB]", "what limits N; contacts; timed steps")
    return table(key_of("capability", scene), f"Parallel capability at N_env^max, {scene}", titles, shown)


def _at_max(row: paper_tables.Capability, at: paper_tables.AtMax, scene: str) -> Row:
    name = Cell(row.label, notes=(_settings(row.key), *row.elsewhere), tone=Tone.BAD if row.elsewhere else Tone.PLAIN)
    key = row.key
    held = {"simulator": key.simulator, "scene": scene, "device": key.device or "none", "level": key.determinism}
    if at.n_max is None:
        return Row((name, EMPTY, EMPTY, EMPTY, Cell(at.limit.value, notes=(cut(at.ends, 110),))), held)
    counted = "contacts were not counted" if at.contacts is None else f"{words.count(at.contacts)} contacts per env"
    notes = [*([cut(at.ends, 110)] if at.sweep.limited else []), *([str(at.faults)] if at.faults else [])]
    notes += [counted, *(timed.beside(at.timed) if at.timed else [])]
    limit = Cell(at.limit.value, notes=tuple(notes), tone=Tone.BAD if at.faults else Tone.PLAIN)
    fps = _scaled(at.fps, 1 / _SPEED[scene], 3)
    return Row((name, Cell(f"{at.n_max:,}", float(at.n_max)), _cell(fps), _cell(_memory(at.memory)), limit), held)


def _of_paper(found: AtLargest, scene: str) -> Row:
    cells = (f"{found.n_env_max:,}", f"{found.fps / _SPEED[scene]:.3f}", f"{found.memory_gb:.1f}", "published")
    return Row((Cell("the paper's", tone=Tone.QUIET), *(Cell(text, tone=Tone.QUIET) for text in cells)))


def _variability(source: Source, rows: Sequence[VariabilityRow]) -> Table:
    no_real = _no_real(source)
    shown: list[Row] = []
    for row in rows:
        result = row.result
        regime = known(result.metrics["regime_published"].value)
        fault = Cell(str(row.faults), tone=Tone.BAD) if row.faults else Cell("no fault found")
        distances = map(_cell, (row.real, row.parallel, row.run_to_run))
        counted = [result.metrics[f"distinct_{of}"] for of in ("envs", "runs")]
        distinct = (Cell(words.count_of(one), notes=words.timed_notes(one)) for one in counted)
        kind = EMPTY if regime is None else Cell(f"{regime:.0f}", regime)
        against = fault if result.group.complete else EMPTY
        shown.append(Row((named(source, result), kind, *distances, *distinct, against), facets(result.group.key)))
        if row.paper:
            told = (str(one) for one in (row.paper.regime, row.paper.w1_real, row.paper.parallel, row.paper.run_to_run))
            cells = (f"{row.paper.simulator}, the paper's", *told, NONE, NONE, "published")
            shown.append(Row(tuple(Cell(text, tone=Tone.QUIET) for text in cells)))
    titles = ("simulator", "type", "EMD to real [cm]", "parallel [cm]", "run-to-run [cm]", "distinct envs",
              "distinct runs", "what speaks against it")  # fmt: skip
    legend = [_ZERO, *([f"EMD to real: {no_real}"] if no_real else [])]
    caption = "Variability and types: mean ± SD in the paper's digits, 95 % interval below"
    return table("remade-variability", caption, titles, shown, legend)


def _cell(found: Printed) -> Cell:
    if found.why_not:
        return missing(found.why_not)
    return Cell(found.value, range=found.interval, notes=(found.note,) if found.note else ())


def _timed_remarks(rows: Sequence[paper_tables.Capability], scene: str) -> list[str]:
    # one point of each row stands for it
    found = {r.label: row.label for row in rows if scene in row.at and (r := row.at[scene].sweep.at_max)}
    results = [r for row in rows if scene in row.at and (r := row.at[scene].sweep.at_max)]
    lines = timed.remarks(results, named=lambda result: found[result.label])
    return [f"{scene}: {line}" for line in lines if line != timed.LEGEND]


def _settings(key: GroupKey) -> str:
    given = ", ".join(f"{name}={value}" for name, value in key.parsed_options.items())
    level = "" if key.determinism == DEFAULT else f"determinism {key.determinism}"
    settings = ", ".join(TELLING[name].labelled(name, value) for name, value in key.settings)
    return "; ".join(part for part in (key.version or "no version", given, level, settings, key.device) if part)


def _memory(metric: Estimate | None) -> Printed:
    if metric is None:
        return _scaled(None, 1.0, 1)
    scale = metric.metric.per_unit / _GB
    found = _scaled(metric, scale, 1)
    if isinstance(metric.value, Missing) or metric.name == GPU_MEMORY[0]:
        return found
    if metric.name in GPU_MEMORY:
        return Printed(found.value, found.interval, "of the process: others were on the GPU")
    return Printed(found.value, found.interval, "of the host: it ran on the CPU")


def _scaled(metric: Estimate | None, scale: float, decimals: int) -> Printed:
    if metric is None:
        return Printed(why_not="no run is complete")
    if isinstance(metric.value, Missing):
        return Printed(why_not=metric.value.reason)
    value = f"{metric.value * scale:.{decimals}f}"
    note = f"{metric.value * scale:.2g}" if float(value) == 0 else ""
    if not metric.ci95:
        return Printed(value, _no_interval(metric), note)
    return Printed(value, numbers.bounds(metric.ci95, lambda end: f"{end * scale:.{decimals}f}"), note)


def _no_interval(metric: Estimate) -> str:
    if metric.n == 1:
        return "one run"
    return words.why_no_interval(metric, "no interval")


def _is_first(result: GroupResult, shown: list[GroupResult]) -> bool:
    return next(r for r in shown if r.group.key.simulator == result.group.key.simulator) is result


def _no_real(source: Source) -> str:
    """Why no group has a distance to real trials; empty where some has."""
    reference = source.evaluation.reference
    if reference is None:
        return source.evaluation.reference_note
    return "" if reference.measured else "the reference is another simulation, not measured"


def _row(result: GroupResult, source: Source, *, first: bool) -> VariabilityRow:
    name = published.NAMES.get(result.group.key.simulator)
    beside = source.published and first
    told = next((r for r in published.VARIABILITY if r.simulator == name), None) if beside else None
    real, parallel, between = (result.metrics[n] for n in ("w1_real", "w1_parallel", "w1_run_to_run"))
    distance = Printed("–") if _no_real(source) else _printed(real, 3)
    printed = [_beside(_printed(metric, 2), result, metric) for metric in (parallel, between)]
    return VariabilityRow(result, distance, printed[0], printed[1], faults(result), told)


def _beside(figure: Printed, result: GroupResult, metric: Estimate) -> Printed:
    """With what the value is without the flight of cubes that left the board."""
    fell, clamped = (known(result.metrics[name].value) for name in ("left_board", metric.name + SUFFIX))
    if not fell or clamped is None:
        return figure
    said = f"clamped to the board: {numbers.distance(clamped)}; {numbers.figure(fell, '')} bodies off it per env"
    return replace(figure, note="; ".join(part for part in (figure.note, said) if part))


def _printed(metric: Estimate, decimals: int) -> Printed:
    """Mean and SD [cm] with the paper's decimals, and what those hide of a small value."""
    if isinstance(metric.value, Missing):
        return Printed(why_not=metric.value.reason)
    value = f"{metric.value:.{decimals}f}"
    if metric.sd is not None:
        value += f" ± {metric.sd:.{decimals}f}"
    note = ""
    if metric.value < _LEAST:
        note = "exactly 0" if metric.value == 0 else f"not 0: {numbers.distance(metric.value)}"
    interval = numbers.interval(metric) if metric.ci95 else "" if metric.value == 0 else _no_interval(metric)
    return Printed(value, interval, note)


def _missing(source: Source) -> list[str]:
    """The paper's simulators of which nothing is here."""
    there = {r.group.key.simulator for r in source.evaluation.results if r.group.complete}
    return [name for simulator, name in published.NAMES.items() if simulator not in there]


_NOT_OURS = (
    f"These are the paper's figures, not results of this report. Source: {published.SOURCE}; its authors' machine: "
    f"{published.MACHINE}. Speed and memory of another machine do not compare with those of this report; types and "
    "distances hold for the versions and switches of that time."
)


def published_figures(source: Source) -> Section | None:
    """None where they were not asked for."""
    if not source.published:
        return None
    distances = (metric.titled for metric in (W1_REAL, W1_PARALLEL, W1_RUN_TO_RUN))
    blocks: list[Block] = [
        Text(_NOT_OURS, Tone.WARNING),
        table(
            "published-variability",
            f"Variability as published: inclined-collision, 16 envs, 10 runs. {published.SOURCE}",
            ["simulator", "version", *distances, "type"],
            [
                (r.simulator, published.SIMULATOR_VERSIONS[r.simulator], str(r.w1_real), str(r.parallel),
                 str(r.run_to_run), str(r.regime))
                for r in published.VARIABILITY
            ],
        ),
        *_curves_beside(source),
        table(
            "published-scaling",
            f"Throughput and memory as published, at the largest number of envs sustained. {published.SOURCE}",
            ["simulator", *(f"{scene}: {what}" for scene in ("free-fall", "franka") for what in
                            ("N_env^max", FPS.titled, "memory [GB]"))],
            [(r.simulator, *_at(r.free_fall), *_at(r.franka)) for r in published.SCALING],
        ),
    ]  # fmt: skip
    return Section("published", "Figures of the paper", tuple(blocks), "not results of this report", folded=True)


def _at(found: AtLargest | None) -> tuple[Cell, Cell, Cell]:
    if found is None:
        return Cell("not supported", tone=Tone.QUIET), EMPTY, EMPTY
    return (
        Cell(f"{found.n_env_max:,}", float(found.n_env_max)),
        Cell(f"{found.fps:,.0f}", found.fps),
        Cell(f"{found.memory_gb:.1f}", found.memory_gb),
    )


def _curves_beside(source: Source) -> Iterator[Block]:
    for scene in beside_published(source.evaluation.sweeps):
        ours = ", ".join(f"{sweep.label} on {sweep.key.device or 'no device'}" for sweep in scene.sweeps)
        said = f"curves: this report's, {ours}" if ours else "this report has no sweep of this scene"
        drawn = Gallery(tuple(scene.charts), 28)
        legend = Text(f"Diamonds with names: the paper's, on its machine, at N_env^max; {said}.", Tone.QUIET)
        key = f"published-{scene.scene}"
        yield Section(key, f"{scene.scene}: the paper's figures beside these sweeps", (drawn, legend))
