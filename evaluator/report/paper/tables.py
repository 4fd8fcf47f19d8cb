"""The report's main tables as files: what its page and the terminal show, a row for each group."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gpusimbench.evaluator.render.numbers import NONE, interval, mean_sd
from gpusimbench.evaluator.report import accumulation, fidelity, timed, words
from gpusimbench.evaluator.report.page.picture import file_name
from gpusimbench.evaluator.report.page.section import Source
from gpusimbench.evaluator.report.paper.text_table import WRITERS, Format, TextTable
from gpusimbench.evaluator.report.price_table import family_name, ratio
from gpusimbench.evaluator.report.sweep_tables import point_cells
from gpusimbench.evaluator.results.clamped_metrics import SUFFIX
from gpusimbench.evaluator.results.determinism_cost import Family
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.paper_tables import AtMax, Capability, capability
from gpusimbench.evaluator.results.published import SCALING, SOURCE, VARIABILITY, AtLargest
from gpusimbench.evaluator.results.result import Evaluation, GroupResult, Metric
from gpusimbench.evaluator.results.sweeps import Sweep

_TIMED = tuple(column.title for column in timed.ALL)

_VARIABILITY = (
    "group", "scene", "envs x runs", "EMD to reference [cm]", "95 % of EMD", "EMD, clamped [cm]", "parallel [cm]",
    "95 % of parallel", "parallel, clamped [cm]", "run-to-run [cm]", "95 % of run-to-run", "run-to-run, clamped [cm]",
    words.EXCHANGED, "cubes off the board per env", "distinct envs", "distinct runs", "published type",
    "not complete",
)  # fmt: skip
_THROUGHPUT = (
    "group", "scene", "device", "envs x runs", "throughput [env steps/s]", "95 %", *_TIMED, "GPU memory increment [GB]",
    "GPU memory of the process [GB]", "runs with another process on the GPU",
    "host memory increment [MB]", "build; compile [s]", "not complete",
)  # fmt: skip
_LARGEST = (
    "sweep",
    "scene",
    "version",
    "device",
    "N_env^max",
    "throughput [env steps/s]",
    *_TIMED,
    "memory increment",
    "why it ends",
)
_POINTS = (
    "sweep",
    "scene",
    "envs",
    "throughput [env steps/s]",
    *_TIMED,
    "memory increment",
    "contacts per env: mean / max",
    "runs",
)
_CAPABILITY = (
    "simulator", "scene", "N_env^max", "throughput [env steps/s]", "95 %", *_TIMED, "memory increment", "what limits N",
    "what speaks against it", "in other scenes",
)  # fmt: skip
_PRICES = (
    "group", "scene", "envs", "device", "level", "in force beside the default", "distinct envs", "distinct runs",
    "throughput of the default's", *_TIMED, "memory increment of the default's", "what speaks against it",
    "why no price",
)  # fmt: skip
_AT_LARGEST = ("simulator", "N_env^max", "throughput [env steps/s]", "memory increment [GB]")
_GUIDELINES = ("need", "pick", "rule", "evidence")


def text_tables(evaluation: Evaluation, formats: Iterable[Format], *, published: bool) -> dict[str, bytes]:
    """Every table that has a row in each of the formats, Parquet aside, by the name of its file."""
    return {
        f"{table.key}.{wanted.value}": WRITERS[wanted](table).encode("utf-8", "backslashreplace")
        for table in tables(evaluation, published=published)
        for wanted in formats
        if wanted in WRITERS
    }


def tables(evaluation: Evaluation, *, published: bool) -> Iterator[TextTable]:
    """All tables that have a row."""
    shown = Source(evaluation, published, "").shown
    when = f"positions at t = {evaluation.sample_time:g} s"
    swept = evaluation.sweeps
    found = [
        TextTable("variability", f"Variability, {when}; mean ± SD", _VARIABILITY, [*map(_variability, shown)]),
        TextTable("throughput", _warned("Complete runs; mean ± SD", shown), _THROUGHPUT, [*map(_throughput, shown)]),
        TextTable("scaling-largest", "How far sweeps over environments go", _LARGEST, [*map(_largest, swept)]),
        TextTable("scaling-points", "Every point of the sweeps", _POINTS, [*_points(swept)]),
        TextTable("capability", "Parallel capability, the published table re-made", _CAPABILITY, [
            *_capability(capability(swept, evaluation.results))
        ]),
        *_accumulation(evaluation),
        TextTable("prices", "What determinism costs, with 95 % intervals", _PRICES, [*_prices(evaluation.price_list)]),
        TextTable("physics", "Checks of mechanics", ("group", *fidelity.TITLES), [*_physics(shown)]),
        TextTable("guidelines", "Which group for which need", _GUIDELINES, [*_guidelines(evaluation)]),
    ]  # fmt: skip
    yield from (table for table in [*found, *(_published() if published else ())] if table.rows)


def _variability(result: GroupResult) -> tuple[str, ...]:
    key, metrics = result.group.key, result.metrics
    distances = [(metrics[name], metrics[name + SUFFIX]) for name in ("w1_real", "w1_parallel", "w1_run_to_run")]
    return (
        result.label, key.scene, _size(result),
        *(cell for metric, beside in distances for cell in (mean_sd(metric), interval(metric), mean_sd(beside))),
        words.exchanged(metrics["w1_run_to_run"]), mean_sd(metrics["left_board"]),
        _of(metrics["distinct_envs"]), _of(metrics["distinct_runs"]), words.regime(metrics["regime_published"]),
        words.trouble(result.group) or NONE,
    )  # fmt: skip


def _throughput(result: GroupResult) -> tuple[str, ...]:
    key, metrics = result.group.key, result.metrics
    return (
        result.label, key.scene, key.device or NONE, _size(result), mean_sd(metrics["fps"]), interval(metrics["fps"]),
        *_timed(result),
        mean_sd(metrics["memory_peak_increment"]), mean_sd(metrics["process_memory_peak"]),
        words.shared(metrics["fps"]) or NONE, mean_sd(metrics["host_memory_peak_increment"]),
        words.preparation(metrics), words.trouble(result.group) or NONE,
    )  # fmt: skip


def _warned(caption: str, results: Sequence[GroupResult]) -> str:
    # of one scene each: rows of two scenes are not compared
    scenes = dict.fromkeys(r.group.key.scene for r in results)
    found = {scene: timed.incomparable(r for r in results if r.group.key.scene == scene) for scene in scenes}
    return ". ".join([caption, *(f"{scene}: {line}" for scene, lines in found.items() for line in lines)])


def _timed(result: GroupResult | None) -> tuple[str, ...]:
    return timed.cells(timed.ALL, result.timed) if result else tuple(NONE for _ in timed.ALL)


def _size(result: GroupResult) -> str:
    return f"{result.group.key.n_env} x {len(result.group.complete)}"


def _of(metric: Metric) -> str:
    return NONE if metric.value is None else f"{metric.value:.0f} of {metric.n}"


def _largest(sweep: Sweep) -> tuple[str, ...]:
    best = sweep.at_max
    return (
        sweep.label, sweep.key.scene, sweep.key.version or NONE, sweep.key.device or NONE,
        NONE if sweep.n_max is None else f"{sweep.n_max:,}",
        mean_sd(best.metrics["fps"]) if best else NONE, *_timed(best),
        words.amount(best.metrics[sweep.memory]) if best else NONE, sweep.ends,
    )  # fmt: skip


def _points(sweeps: Sequence[Sweep]) -> Iterator[tuple[str, ...]]:
    for sweep in sweeps:
        for point in sweep.points:
            yield (sweep.label, sweep.key.scene, f"{point.n_env:,}", *point_cells(sweep, point, timed.ALL))


def _capability(rows: Sequence[Capability]) -> Iterator[tuple[str, ...]]:
    for row in rows:
        for scene, at in row.at.items():
            yield row.label, scene, *_at_max(at), "; ".join(row.elsewhere) or NONE


def _at_max(at: AtMax) -> tuple[str, ...]:
    if at.n_max is None or at.fps is None or at.memory is None:
        return NONE, NONE, NONE, *_timed(None), NONE, f"{at.limit.value}: {at.ends}", NONE
    limit = f"{at.limit.value}: {at.ends}" if at.sweep.limited else at.limit.value
    speed = mean_sd(at.fps), interval(at.fps), *_timed(at.sweep.at_max)
    return f"{at.n_max:,}", *speed, words.amount(at.memory), limit, str(at.faults) or NONE


def _prices(families: Sequence[Family]) -> Iterator[tuple[str, ...]]:
    for family in families:
        name = family_name(family)
        if family.base is not None:
            yield *_level(name, family.base), "1", *_timed(family.base), "1", str(faults(family.base)) or NONE, NONE
        for price in family.prices:
            own = _level(name, price.result, ", ".join(price.differs) or NONE)
            against, why_not = str(faults(price.result)) or NONE, price.speed.why_not or NONE
            yield *own, ratio(price.speed), *_timed(price.result), ratio(price.memory), against, why_not


def _level(name: str, result: GroupResult, differs: str = NONE) -> tuple[str, ...]:
    key, metrics = result.group.key, result.metrics
    distinct = _of(metrics["distinct_envs"]), _of(metrics["distinct_runs"])
    return name, key.scene, str(key.n_env), key.device or NONE, key.determinism, differs, *distinct


def _accumulation(evaluation: Evaluation) -> Iterator[TextTable]:
    for number, found in enumerate(evaluation.accumulation):
        caption = f"{found.scene}, {found.label}: variability against the number of environments, W1 [cm]"
        key = file_name("accumulation", number, found.label)
        yield TextTable(key, caption, accumulation.TITLES, [*accumulation.rows(found)])


def _physics(results: Sequence[GroupResult]) -> Iterator[tuple[str, ...]]:
    for result in results:
        for row in result.fidelity.rows:
            if not row.reason or row.count:
                yield (result.label, *fidelity.cells(row))


def _guidelines(evaluation: Evaluation) -> Iterator[tuple[str, ...]]:
    for one in evaluation.comparison.guidelines:
        yield one.need, one.pick or f"none: {one.reason}", one.rule, one.evidence or NONE


def _published() -> Iterator[TextTable]:
    rows: list[tuple[str, ...]] = [
        (r.simulator, str(r.regime), str(r.w1_real), str(r.parallel), str(r.run_to_run)) for r in VARIABILITY
    ]
    titles = ("simulator", "type", "EMD to real [cm]", "parallel [cm]", "run-to-run [cm]")
    yield TextTable("published-variability", f"Not results of this evaluation: {SOURCE}", titles, rows)
    for name in ("free_fall", "franka"):
        found = [(r.simulator, *_at(at)) for r in SCALING if (at := getattr(r, name))]
        key = f"published-{name.replace('_', '-')}"
        yield TextTable(key, f"Not results of this evaluation: {SOURCE}", _AT_LARGEST, found)


def _at(at: AtLargest) -> tuple[str, str, str]:
    return f"{at.n_env_max:,}", f"{at.fps:,.0f}", f"{at.memory_gb:.1f}"
