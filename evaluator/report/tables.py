"""An evaluation as tables in a terminal."""

from __future__ import annotations

from typing import IO

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.metrics.radar import SimulatorResult
from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.render.console import PlainTable, make_console, plain_table
from gpusimbench.evaluator.render.numbers import NONE, distance, interval, mean_sd
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.accumulation import print_accumulation
from gpusimbench.evaluator.report.price_table import print_prices
from gpusimbench.evaluator.report.sweep_tables import print_sweeps
from gpusimbench.evaluator.results.clamped_metrics import SUFFIX
from gpusimbench.evaluator.results.fidelity import Verdict
from gpusimbench.evaluator.results.published import SCALING, SOURCE, VARIABILITY, AtLargest
from gpusimbench.evaluator.results.result import Evaluation, GroupResult, Metric
from gpusimbench.evaluator.results.sweeps import swept_only
from gpusimbench.schemas.text import printable

_COLUMNS = 4
_UNSHOWN = (
    "process_memory_peak",
    "allocator_peak",
    "build_time",
    "compile_time",
    "capture_slowdown",
    "divergence_rate",
    "w1_parallel_clamped",
    "w1_run_to_run_clamped",
    "w1_real_clamped",
)  # no row of dashes, so no reason


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
    console.print(printable(f"{scene}, positions at t = {evaluation.sample_time:g} s"), style="bold")
    table = plain_table("", *(printable(result.label) for result in results))

    def row(title: str, cells: list[str]) -> None:
        table.add_row(Text(title), *(Text(printable(c)) for c in cells))

    def told(title: str, cells: list[str]) -> None:
        # what no group of this table tells would be a row of dashes
        if any(cell != NONE for cell in cells):
            row(title, cells)

    def both(title: str, name: str, *, with_interval: bool = True) -> None:
        found = [r.metrics[name] for r in results]
        row(title, [mean_sd(m) for m in found])
        if with_interval and any(m.ci95 and m.value is not None for m in found):
            row("  95 % interval", [interval(m) for m in found])
        floors = [m.extra.get("floor", {}) for m in found]
        if any("p_value" in f for f in floors):
            row(f"  {words.EXCHANGED}", [words.exchanged(m) for m in found])
        if any("energy_p_value" in f for f in floors):
            row("  energy distance; p", [_energy(f) for f in floors])

    row("version", [r.group.key.version or NONE for r in results])
    row("device", [r.group.key.device or NONE for r in results])
    row("envs x complete runs", [f"{r.group.key.n_env} x {len(r.group.complete)}" for r in results])
    told("INVALID or failed runs", [words.trouble(r.group) or NONE for r in results])
    both("throughput [env-steps/s]", "fps")
    for column in timed.columns(r.timed for r in of_scene):
        row(f"  {column.title}", [column.cell(r.timed) for r in results])
    told("  another process on the GPU", [words.shared(r.metrics["fps"]) or NONE for r in results])
    both("GPU memory increment [GB]", "memory_peak_increment")
    told("  the process alone [GB]", [mean_sd(r.metrics["process_memory_peak"]) for r in results])
    both("host memory increment [MB]", "host_memory_peak_increment")
    # where no cube left the board, the clamped distance is the published one
    fell = any(r.metrics["left_board"].value for r in results)
    for title, name in (("envs", "w1_parallel"), ("runs", "w1_run_to_run"), ("reference", "w1_real")):
        to = "to" if name == "w1_real" else "between"
        both(f"W1 {to} {title} [cm]", name)
        if fell and any(r.metrics[name].value is not None for r in results):
            both("  cubes clamped to the board", f"{name}{SUFFIX}")
    told("cubes off the board per env", [mean_sd(r.metrics["left_board"]) for r in results])
    row("distinct envs, bitwise", [_of(r.metrics["distinct_envs"]) for r in results])
    row("distinct runs, bitwise", [_of(r.metrics["distinct_runs"]) for r in results])
    told("envs are", [words.equality(r.metrics["equality_envs"]) for r in results])
    told("runs are", [words.equality(r.metrics["equality_runs"]) for r in results])
    told("envs part: doubling time [s]", [words.doubling(r.metrics["divergence_rate"]) for r in results])
    both("cubes sunk per env", "sank")
    told("checks of mechanics held", [words.mechanics(r.fidelity) for r in results])
    row("published type", [words.regime(r.metrics["regime_published"]) for r in results])
    row("capture changed the states", [_capture(r.metrics["capture_changes_states"]) for r in results])
    told("captured / timed step; standing still", [words.capturing(r.metrics) for r in results])
    told("contacts per env: mean / max", [words.counted(r.validity.of("contacts")) for r in results])
    told("buffers used", [words.buffers(r.validity) for r in results])
    told("overflow", [words.overflow(r.validity) for r in results])
    told("build; compile [s]", [words.preparation(r.metrics) for r in results])
    console.print(table)
    for line in (*_legend(results), *_reasons(results)):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


def _energy(floor: dict[str, float]) -> str:
    if "energy_p_value" not in floor:
        return NONE
    return f"{distance(floor['energy_cm'])}; {floor['energy_p_value']:.2g}"


def _of(metric: Metric) -> str:
    return NONE if metric.value is None else f"{metric.value:.0f} of {metric.n}"


def _legend(results: list[GroupResult]) -> list[str]:
    found = {int(m.value) for r in results if (m := r.metrics["regime_published"]).value is not None}
    lines = [f"type {number}: {REGIME_MEANING[number]}" for number in sorted(found)]
    lines += _agreement(results)
    lines += _bounds(results)
    if any("p_value" in m.extra.get("floor", {}) for r in results for m in r.metrics.values()):
        lines.append(
            f"{words.EXCHANGED}: W1 of the first two runs (or of the first run and the reference), its mean with whole "
            "envs exchanged between them at random, and the share of exchanges that give as much"
        )
    for number, result in enumerate(results, start=1):
        if why_not := words.not_exchanged(result.metrics["w1_run_to_run"]):
            lines.append(f"column {number}: no floor of W1 between runs: {why_not}")
    if any(r.metrics["left_board"].value for r in results):
        lines.append(
            "cubes clamped to the board: each cube beside the board is put at its nearest edge, so that flight after a "
            "fall does not count"
        )
    if any(r.metrics["equality_runs"].value or r.metrics["equality_envs"].value for r in results):
        lines.append("what is less than bit-identical is said of the sample step alone")
    if any(r.fidelity.of(Verdict.BROKEN) for r in results):
        lines.append("which checks of mechanics are broken, and by how much: --physics")
    if any(r.fidelity.of(Verdict.MOVING) for r in results):
        lines.append("cubes still move or spin at the sample time, which is no check of mechanics: --physics")
    if any(r.metrics["capture_slowdown"].value is not None for r in results):
        lines.append("captured and timed steps are other steps of the scene: a difference in contacts counts as well")
    return lines


def _bounds(results: list[GroupResult]) -> list[str]:
    lines = []
    for number, result in enumerate(results, start=1):
        for metric in result.metrics.values():
            low, high = metric.extra.get("bounds_cm", (None, None))
            where = f"column {number}, {metric.name}"
            if low is not None and high is not None:
                pairs = f", of {metric.n} pairs drawn with seed 0" if metric.exactness == "sampled" else ""
                lines.append(f"{where} is {metric.exactness}: between {distance(low)} and {distance(high)}{pairs}")
            elif metric.exactness == "sampled":
                drawn = metric.extra["sampled"]
                lines.append(f"{where} is sampled: {drawn['envs']} envs of a run drawn with seed {drawn['seed']}")
    return lines


def _agreement(results: list[GroupResult]) -> list[str]:
    # runs that all agree leave a resampling nothing to find
    found = [m for r in results if (m := r.metrics["regime_published"]).extra.get("agreement")]
    lines = {(m.extra["runs"], m.extra["agreement"]): words.another(m) for m in found}
    return [
        f"{count} runs that are {'bit-identical' if kind == 'bits' else 'within 0.01 cm'}: {line}"
        for (count, kind), line in sorted(lines.items())
    ]


def _capture(metric: Metric) -> str:
    if metric.value is None:
        return NONE
    return f"in {metric.value:.0f} of {metric.n} runs"


def _reasons(results: list[GroupResult]) -> list[str]:
    # metrics that miss for the same reason share a line, and so do columns
    metrics: dict[tuple[int, str], list[str]] = {}
    for number, result in enumerate(results, start=1):
        for metric in result.metrics.values():
            if metric.value is None and metric.name not in _UNSHOWN:
                metrics.setdefault((number, metric.why_not), []).append(metric.name)
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
    variability = plain_table("simulator", "type", "W1 to real [cm]", "between envs [cm]", "between runs [cm]")
    for row in VARIABILITY:
        variability.add_row(row.simulator, str(row.regime), str(row.w1_real), str(row.parallel), str(row.run_to_run))
    console.print(variability)
    console.print()
    console.print("published, at the largest number of environments", style="bold")
    scaling = plain_table("simulator", "free-fall envs", "env-steps/s", "GB", "franka envs", "env-steps/s", "GB")
    for at in SCALING:
        scaling.add_row(at.simulator, *_published_cells(at.free_fall), *_published_cells(at.franka))
    console.print(scaling)
    console.print()


def _published_cells(at: AtLargest | None) -> tuple[str, str, str]:
    if at is None:
        return ("not supported", NONE, NONE)
    return (f"{at.n_env_max:,}", f"{at.fps:,.0f}", f"{at.memory_gb:.1f}")
