"""An evaluation as tables in a terminal."""

from __future__ import annotations

from typing import IO

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.metrics.radar import SimulatorResult
from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.console import PlainTable, make_console, plain_table
from gpusimbench.evaluator.render.numbers import NONE, distance, interval
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.accumulation import print_accumulation
from gpusimbench.evaluator.report.price_table import print_prices
from gpusimbench.evaluator.report.sweep_tables import print_sweeps
from gpusimbench.evaluator.results.clamped_metrics import SUFFIX
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import BetweenEnvs, BetweenRuns, ToReference
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.fidelity import Verdict
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.published import SCALING, SOURCE, VARIABILITY, AtLargest
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import swept_only
from gpusimbench.schemas.text import printable

_COLUMNS = 4


def print_tables(evaluation: Evaluation, stream: IO[str]) -> None:
    """Print the evaluation; what a stranger's recording says is printed as text, never as markup.

    Groups side by side, so many at a time that a line can be read. A group that only is a point of a long sweep stands
    in the sweep's table, not there.
    """
    hidden = swept_only(evaluation.results, evaluation.sweeps)
    columns = min(_COLUMNS, len(evaluation.results) - len(hidden))
    console = make_console(stream, columns=columns)
    for scene in dict.fromkeys(r.group.key.scene for r in evaluation.results):
        results = [r for r in evaluation.results if r.group.key.scene == scene and r.label not in hidden]
        for begin in range(0, len(results), _COLUMNS):
            _print_scene(console, evaluation, scene, results[begin : begin + _COLUMNS], results)
        if lines := timed.remarks(results):
            console.print(printable(f"{scene}, throughput"), style="bold")
            for line in lines:
                console.print(printable(f"  {line}"), style="dim")
            console.print()
        print_sweeps(console, scene, [s for s in evaluation.sweeps if s.key.scene == scene])
        for found in (a for a in evaluation.accumulation if a.scene == scene):
            print_accumulation(console, found)
    print_prices(console, evaluation.price_list)
    _print_notes(console, evaluation)
    _print_guidelines(console, evaluation)


def _print_scene(
    console: Console, evaluation: Evaluation, scene: str, results: list[GroupResult], of_scene: list[GroupResult]
) -> None:
    console.print(printable(f"{scene}, positions at t = {evaluation.sampled_at(scene):g} s"), style="bold")
    table = plain_table("", *(printable(result.label) for result in results))

    def row(title: str, cells: list[str]) -> None:
        table.add_row(Text(title), *(Text(printable(c)) for c in cells))

    def row_if_known(title: str, cells: list[str]) -> None:
        # what is known of no group would be a row of dashes
        if any(cell != NONE for cell in cells):
            row(title, cells)

    row("version", [r.group.key.version or NONE for r in results])
    row("device", [r.group.key.device or NONE for r in results])
    row("envs x complete runs", [f"{r.group.key.n_env} x {len(r.group.complete)}" for r in results])
    row_if_known("INVALID or failed runs", [words.trouble(r.group) or NONE for r in results])
    # where no cube left the board, the clamped distance is the published one
    fell = any(known(r.metrics["left_board"].value) for r in results)
    for metric in METRICS.values():
        if metric.name.endswith(SUFFIX) and not fell:
            continue
        found = [r.metrics[metric.name] for r in results]
        row_if_known(metric.titled, [words.cell(one) for one in found])
        row_if_known("  95 % interval", [interval(one) for one in found])
        row_if_known(f"  {words.EXCHANGED}", [words.exchanged(one) for one in found])
        row_if_known(f"  {words.ENERGY}", [words.energy(one) for one in found])
        if metric is FPS:
            for column in timed.columns(r.timed for r in of_scene):
                row(f"  {column.title}", [column.cell(r.timed) for r in results])
            row_if_known("  another process on the GPU", [words.shared(one) or NONE for one in found])
    row_if_known("checks of mechanics held", [words.mechanics(r.fidelity) for r in results])
    row_if_known("contacts per env: mean / max", [words.counted(r.validity.of("contacts")) for r in results])
    row_if_known("buffers used", [words.buffers(r.validity) for r in results])
    row_if_known("overflow", [words.overflow(r.validity) for r in results])
    console.print(table)
    for line in (*_legend(results), *_reasons(results)):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


def _legend(results: list[GroupResult]) -> list[str]:
    types = [r.metrics["regime_published"].value for r in results]
    found = {int(value) for value in types if not isinstance(value, Missing)}
    lines = [f"type {number}: {REGIME_MEANING[number]}" for number in sorted(found)]
    lines += _agreement(results)
    lines += _bounds(results)
    if any(words.exchanged(m) != NONE for r in results for m in r.metrics.values()):
        lines.append(
            f"{words.EXCHANGED}: W1 of the first two runs (or of the first run and the reference), its mean with whole "
            "envs exchanged between them at random, and the share of exchanges that give as much"
        )
    for number, result in enumerate(results, start=1):
        if why_not := words.not_exchanged(result.metrics["w1_run_to_run"]):
            lines.append(f"column {number}: no floor of W1 between runs: {why_not}")
    if any(known(r.metrics["left_board"].value) for r in results):
        lines.append(
            "clamped: each cube beside the board is put at its nearest edge, so that flight after a fall does not count"
        )
    if any(known(r.metrics[name].value) for r in results for name in ("equality_runs", "equality_envs")):
        lines.append("what is less than bit-identical is said of the sample step alone")
    if any(r.fidelity.of(Verdict.BROKEN) for r in results):
        lines.append("which checks of mechanics are broken, and by how much: --all")
    if any(r.fidelity.of(Verdict.MOVING) for r in results):
        lines.append("cubes still move or spin at the sample time, which is no check of mechanics: --all")
    if any(not isinstance(r.metrics["capture_slowdown"].value, Missing) for r in results):
        lines.append("captured and timed steps are other steps of the scene: a difference in contacts counts as well")
    return lines


def _bounds(results: list[GroupResult]) -> list[str]:
    lines = []
    for number, result in enumerate(results, start=1):
        for metric in result.metrics.values():
            details = metric.details
            bounds = details.bounds_cm if isinstance(details, BetweenRuns | ToReference) else None
            drawn = metric.of(BetweenEnvs).sampled
            where = f"column {number}, {metric.name}"
            if bounds:
                low, high = bounds
                pairs = f", of {metric.n} pairs drawn with seed 0" if metric.exactness == "sampled" else ""
                lines.append(f"{where} is {metric.exactness}: between {distance(low)} and {distance(high)}{pairs}")
            elif drawn:
                lines.append(f"{where} is sampled: {drawn.envs} envs of a run drawn with seed {drawn.seed}")
    return lines


def _agreement(results: list[GroupResult]) -> list[str]:
    # runs that all agree leave a resampling nothing to find
    found = [again for r in results if (again := words.resampled(r.metrics["regime_published"])) and again.agreement]
    lines = {(again.runs, again.agreement): words.another(again) for again in found}
    return [
        f"{count} runs that are {'bit-identical' if kind == 'bits' else 'within 0.01 cm'}: {line}"
        for (count, kind), line in sorted(lines.items())
    ]


def _reasons(results: list[GroupResult]) -> list[str]:
    # metrics that miss for the same reason share a line, and so do columns
    metrics: dict[tuple[int, str], list[str]] = {}
    for number, result in enumerate(results, start=1):
        for metric in result.metrics.values():
            if isinstance(metric.value, Missing) and not metric.metric.optional:
                metrics.setdefault((number, metric.value.reason), []).append(metric.name)
    columns: dict[tuple[str, str], list[int]] = {}
    for (column, why), missing in metrics.items():
        columns.setdefault((", ".join(missing), why), []).append(column)
    lines = []
    for (names, why), found in columns.items():
        plural = "column" if len(found) == 1 else "columns"
        where = "" if len(found) == len(results) else f"{plural} {', '.join(map(str, found))}: "
        lines.append(f"{where}no {names}: {why}")
    return lines


def _print_notes(console: Console, evaluation: Evaluation) -> None:
    lines = list(evaluation.notes)
    if evaluation.reference:
        lines.append(evaluation.reference_note)
    for result in evaluation.results:
        lines += [f"{result.label}: {note}" for note in result.notes]
    for line in lines:
        console.print(printable(f"note: {line}"))
    if lines:
        console.print()


def _print_guidelines(console: Console, evaluation: Evaluation) -> None:
    picked = [g for g in evaluation.comparison.guidelines if g.pick]
    if not picked:
        return
    console.print("which for which need, from these recordings alone", style="bold")
    table = PlainTable(show_edge=False, pad_edge=False, box=None, header_style="bold")
    for title in ("need", "pick", "rule"):
        table.add_column(title, overflow="fold")
    for guideline in picked:
        table.add_row(Text(guideline.need), Text(printable(guideline.pick or "")), Text(guideline.rule))
    console.print(table)
    names = {c.speed.label: c.figures.name for c in evaluation.comparison.contenders if c.speed}
    speeds = [c.speed for c in evaluation.comparison.contenders if c.speed]
    for line in timed.remarks(speeds, named=lambda result: names[result.label]):
        console.print(printable(f"  throughputs compared: {line}"), style="dim")
    for guideline in evaluation.comparison.guidelines:
        for line in guideline.unranked:
            console.print(printable(f"  qualifies too for {guideline.need}, not ranked: {line}"), style="dim")
    barred = {f"{c.figures.name}: {why}" for c in evaluation.comparison.contenders if (why := _barred(c.figures))}
    for line in sorted(barred):
        console.print(printable(f"  barred from picks: {line}"), style="dim")
    console.print()


def _barred(figures: SimulatorResult) -> str:
    return "; ".join(dict.fromkeys(part for part in (figures.barred, figures.barred_articulated) if part))


def print_published(stream: IO[str]) -> None:
    """Print both published tables; none of it was measured by this project."""
    console = make_console(stream)
    console.print(f"published figures, not results of this evaluation ({SOURCE})", style="bold")
    variability = plain_table("simulator", "type", *(metric.titled for metric in (W1_REAL, W1_PARALLEL, W1_RUN_TO_RUN)))
    for row in VARIABILITY:
        variability.add_row(row.simulator, str(row.regime), str(row.w1_real), str(row.parallel), str(row.run_to_run))
    console.print(variability)
    console.print()
    console.print("published, at the largest number of environments", style="bold")
    scaling = plain_table("simulator", "free-fall envs", FPS.unit, "GB", "franka envs", FPS.unit, "GB")
    for at in SCALING:
        scaling.add_row(at.simulator, *_published_cells(at.free_fall), *_published_cells(at.franka))
    console.print(scaling)
    console.print()


def _published_cells(at: AtLargest | None) -> tuple[str, str, str]:
    if at is None:
        return ("not supported", NONE, NONE)
    return (f"{at.n_env_max:,}", f"{at.fps:,.0f}", f"{at.memory_gb:.1f}")
