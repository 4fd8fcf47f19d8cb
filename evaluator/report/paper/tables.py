"""The report's main tables as files: what its page and the terminal show, a row for each group."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from gpusimbench.evaluator.render.numbers import NONE, interval, mean_sd
from gpusimbench.evaluator.report import accumulation, fidelity, timed, words
from gpusimbench.evaluator.report.page.picture import file_name
from gpusimbench.evaluator.report.page.section import Source
from gpusimbench.evaluator.report.paper.text_table import WRITERS, Format, TextTable
from gpusimbench.evaluator.report.price_table import family_name, ratio
from gpusimbench.evaluator.report.sweep_tables import point_cells
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.determinism_cost import Family
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.metric import Estimate, Metric, Table
from gpusimbench.evaluator.results.metrics import of_table
from gpusimbench.evaluator.results.paper_tables import AtMax, Capability, capability
from gpusimbench.evaluator.results.published import SCALING, SOURCE, VARIABILITY, AtLargest
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import Sweep

_TIMED = tuple(column.title for column in timed.ALL)

_LARGEST = (
    "sweep",
    "scene",
    "version",
    "device",
    "N_env^max",
    FPS.titled,
    *_TIMED,
    "memory increment",
    "why it ends",
)
_POINTS = (
    "sweep",
    "scene",
    "envs",
    FPS.titled,
    *_TIMED,
    "memory increment",
    "contacts per env: mean / max",
    "runs",
)
_CAPABILITY = (
    "simulator", "scene", "N_env^max", FPS.titled, "95 %", *_TIMED, "memory increment", "what limits N",
    "what speaks against it", "in other scenes",
)  # fmt: skip
_PRICES = (
    "group", "scene", "envs", "device", "level", "in force beside the default", "distinct envs", "distinct runs",
    "throughput of the default's", *_TIMED, "memory increment of the default's", "what speaks against it",
    "why no price",
)  # fmt: skip
_AT_LARGEST = ("simulator", "N_env^max", FPS.titled, "memory increment [GB]")
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
    when = f"positions at {evaluation.sampled()}"
    swept = evaluation.sweeps
    found = [
        _of_metrics(Table.VARIABILITY, f"Variability, {when}; mean ± SD", shown),
        _of_metrics(Table.THROUGHPUT, _warned("Complete runs; mean ± SD", shown), shown),
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


_Column = tuple[str, Callable[[GroupResult], str]]


def _of_metrics(wanted: Table, caption: str, shown: Sequence[GroupResult]) -> TextTable:
    """Every metric of a table, each with its interval and with what else stands beside it."""
    columns: list[_Column] = [
        ("group", lambda r: r.label),
        ("scene", lambda r: r.group.key.scene),
        ("device", lambda r: r.group.key.device or NONE),
        ("envs x runs", _size),
        *(column for metric in of_table(wanted) for column in _columns(metric)),
        ("not complete", lambda r: words.trouble(r.group) or NONE),
    ]
    titles = [title for title, _ in columns]
    return TextTable(wanted.value, caption, titles, [tuple(cell(r) for _, cell in columns) for r in shown])


def _columns(metric: Metric) -> Iterator[_Column]:
    def of(write: Callable[[Estimate], str]) -> Callable[[GroupResult], str]:
        return lambda r: write(r.metrics[metric.name])

    yield metric.titled, of(words.cell)
    if metric.has_interval:
        yield f"95 % of {metric.title}", of(interval)
    if metric is FPS:
        yield from ((column.title, _beside(column)) for column in timed.ALL)
        yield "runs with another process on the GPU", of(lambda fps: words.shared(fps) or NONE)
    if metric is W1_RUN_TO_RUN:
        yield words.EXCHANGED, of(words.exchanged)


def _beside(column: timed.Column) -> Callable[[GroupResult], str]:
    return lambda r: column.cell(r.timed)


def _warned(caption: str, results: Sequence[GroupResult]) -> str:
    # of one scene each: rows of two scenes are not compared
    scenes = dict.fromkeys(r.group.key.scene for r in results)
    found = {scene: timed.incomparable(r for r in results if r.group.key.scene == scene) for scene in scenes}
    return ". ".join([caption, *(f"{scene}: {line}" for scene, lines in found.items() for line in lines)])


def _timed(result: GroupResult | None) -> tuple[str, ...]:
    return timed.cells(timed.ALL, result.timed) if result else tuple(NONE for _ in timed.ALL)


def _size(result: GroupResult) -> str:
    return f"{result.group.key.n_env} x {len(result.group.complete)}"


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
    distinct = words.count_of(metrics["distinct_envs"]), words.count_of(metrics["distinct_runs"])
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
    titles = ("simulator", "type", *(metric.titled for metric in (W1_REAL, W1_PARALLEL, W1_RUN_TO_RUN)))
    yield TextTable("published-variability", f"Not results of this evaluation: {SOURCE}", titles, rows)
    for name in ("free_fall", "franka"):
        found = [(r.simulator, *_at(at)) for r in SCALING if (at := getattr(r, name))]
        key = f"published-{name.replace('_', '-')}"
        yield TextTable(key, f"Not results of this evaluation: {SOURCE}", _AT_LARGEST, found)


def _at(at: AtLargest) -> tuple[str, str, str]:
    return f"{at.n_env_max:,}", f"{at.fps:,.0f}", f"{at.memory_gb:.1f}"
