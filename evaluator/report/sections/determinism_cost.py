"""What determinism costs: each level of an engine beside the default of the same configuration."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.render.document import (
    EMPTY,
    Block,
    Cell,
    Row,
    Section,
    Table,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.rows import Reasons, facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.determinism_cost import NO_EFFECT, Cost, Family, Price
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_ENVS, DISTINCT_RUNS, identical
from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.result import GroupResult

SAME = "cannot be told apart from 1"

_HOW = (
    "Groups that are equal but for the level of determinism: what each level repeats bit by bit, whether its steps did "
    "their work, and what it costs in comparison with the default. A level that sets nothing on this device, or whose "
    "runs are INVALID, has no price. Below 1 is slower, or smaller. Intervals are of 95 %."
)

_TITLES = (
    "level", DISTINCT_ENVS.title, DISTINCT_RUNS.title, "throughput of the default's", "memory of the default's",
    "what speaks against it",
)  # fmt: skip


def section(source: Source) -> Section | None:
    """None where no two groups differ in determinism alone."""
    families = source.evaluation.price_list
    if not families:
        return None
    blocks: list[Block] = [Text(_HOW)]
    for number, family in enumerate(families):
        blocks.append(_table(number, family))
        if lines := timed.remarks(of_family(family), named=lambda result: result.group.key.determinism):
            blocks.append(items(*lines))
    prices = sum(price.speed.ratio is not None for family in families for price in family.prices)
    said = f"{plural(prices, 'level')} with a price, of {plural(len(families), 'configuration')}"
    return Section("prices", "What determinism costs", tuple(blocks), said, folded=True)


def _table(number: int, family: Family) -> Table:
    reasons, groups = Reasons(), of_family(family)
    prices = {price.result.label: price for price in family.prices}
    columns = timed.columns(result.timed for result in groups)
    key = groups[0].group.key
    caption = f"{family_name(family)}, {key.scene}, {key.n_env} envs, {key.device or 'no device'}"
    rows = [_row(result, prices.get(result.label), columns, reasons) for result in groups]
    titles = (*_TITLES, *(column.title for column in columns))
    return table(key_of("prices", number, caption), caption, titles, rows, reasons.legend)


def _row(result: GroupResult, price: Price | None, columns: Sequence[timed.Column], reasons: Reasons) -> Row:
    against = str(faults(result))
    fault = Cell(against, tone=Tone.BAD) if against else Cell("no fault found" if result.group.complete else NONE)
    differs = tuple(words.shortened(one, 120) for one in price.differs) if price else ("the default",)
    return Row(
        (
            Cell(result.group.key.determinism, notes=differs),
            _bits(result, DISTINCT_ENVS, reasons),
            _bits(result, DISTINCT_RUNS, reasons),
            _cost(price.speed, reasons) if price else Cell("1", 1.0),
            _cost(price.memory, reasons) if price else Cell("1", 1.0),
            fault,
            *map(Cell, timed.cells(columns, result.timed)),
        ),
        facets(result),
    )


def _bits(result: GroupResult, metric: Metric, reasons: Reasons) -> Cell:
    found = result.metrics[metric.name]
    holds = identical(found)
    said = words.count_of(found)
    if said == NONE:
        return reasons.cell(holds.why_not)
    return Cell(said, tone=Tone.PLAIN if holds.holds is None else Tone.GOOD if holds.holds else Tone.BAD)


def _cost(found: Cost, reasons: Reasons) -> Cell:
    if found.ratio is None:
        return reasons.cell(found.why_not) if found.why_not else EMPTY
    bounds = f"[{found.ci95[0]:.3g}, {found.ci95[1]:.3g}]" if found.ci95 else ""
    notes = (SAME,) if found.undecided else (found.no_interval,) if not found.ci95 and found.no_interval else ()
    return Cell(f"x {found.ratio:.3g}", found.ratio, found.ci95, bounds, notes)


def of_family(family: Family) -> list[GroupResult]:
    """Its groups, the default first."""
    return [*([family.base] if family.base else []), *(price.result for price in family.prices)]


def family_name(family: Family) -> str:
    """The simulator, with the options that were given."""
    first = (family.base or family.prices[0].result).group
    given = ", ".join(f"{name}={value}" for name, value in first.recordings[0].configuration.options.items())
    return f"{first.key.simulator} [{given}]" if given else first.key.simulator


def ratio(cost: Cost) -> str:
    """A cost with its interval, and whether it can be told apart from 1; a dash where there is none."""
    if cost.ratio is None:
        return "no effect here" if cost.why_not == NO_EFFECT else NONE
    if cost.ci95 is None:
        return f"{cost.ratio:.3g}"
    return f"{_brief(cost)}, {SAME}" if cost.undecided else _brief(cost)


def _brief(cost: Cost) -> str:
    if cost.ratio is None or cost.ci95 is None:
        return ratio(cost)
    return f"{cost.ratio:.3g} [{cost.ci95[0]:.3g}, {cost.ci95[1]:.3g}]"
