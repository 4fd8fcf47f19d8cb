"""What determinism costs: each level of an engine beside the default of the same configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Column,
    Item,
    Section,
    Table,
    Text,
    Tone,
)
from gpusimbench.evaluator.render.numbers import NONE, bounds
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, of_groups, to_compare
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.determinism_cost import NO_EFFECT, Cost, Family, Price
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_ENVS, DISTINCT_RUNS, identical
from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import cut, plural

SAME = "cannot be told apart from 1"

_HOW = (
    "Groups that are equal but for the level of determinism: what each level repeats bit by bit, whether its steps did "
    "their work, and what it costs in comparison with the default. A level that sets nothing on this device, or whose "
    "runs are INVALID, has no price. Below 1 is slower, or smaller. Intervals are of 95 %."
)


def section(source: Source) -> Section | None:
    """None where no two groups differ in determinism alone."""
    families = source.evaluation.price_list
    if not families:
        return None
    results = [result for family in families for result in of_family(family)]
    blocks: list[Block] = [Text(_HOW), _table(source, families, results)]
    told = [(family, timed.remarks(of_family(family), named=lambda r: r.group.key.determinism)) for family in families]
    if remarks := [Item(family_name(one), items=tuple(map(Item, lines))) for one, lines in told if lines]:
        blocks.append(to_compare("prices", remarks))
    prices = sum(known(price.speed.ratio) is not None for family in families for price in family.prices)
    said = f"{plural(prices, 'level')} with a price, of {plural(len(families), 'configuration')}"
    return Section("prices", "What determinism costs", tuple(blocks), said, folded=True)


def _table(source: Source, families: Sequence[Family], results: Sequence[GroupResult]) -> Table:
    """The levels of every configuration, the default first."""
    reasons = Reasons()
    prices = {price.result.label: price for family in families for price in family.prices}

    def cost(result: GroupResult, of: str) -> Cell:
        price = prices.get(result.label)
        found = _cost(getattr(price, of), reasons) if price else Cell("1", 1.0)
        return replace(found, notes=(*found.notes, *_differs(result, price))) if of == "speed" else found

    columns: list[tuple[Column, Written]] = [
        (Column(DISTINCT_ENVS.title), lambda r: _bits(r, DISTINCT_ENVS, reasons)),
        (Column(DISTINCT_RUNS.title), lambda r: _bits(r, DISTINCT_RUNS, reasons)),
        (Column("throughput / that of the default"), lambda r: cost(r, "speed")),
        (Column("memory / that of the default"), lambda r: cost(r, "memory")),
        (Column("what speaks against it"), _against),
    ]
    return of_groups(source, "prices-of-levels", "Levels of each configuration", results, columns, reasons)


def _differs(result: GroupResult, price: Price | None) -> Iterator[str]:
    """What the level sets, and what was timed."""
    yield from (cut(one, 120) for one in price.differs) if price else ("the default",)
    yield from (f"{column.title}: {text}" for column in timed.ALL if (text := column.cell(result.timed)) != NONE)


def _against(result: GroupResult) -> Cell:
    against = str(faults(result))
    return Cell(against, tone=Tone.BAD) if against else Cell("nothing" if result.group.complete else NONE)


def _bits(result: GroupResult, metric: Metric, reasons: Reasons) -> Cell:
    found = result.metrics[metric.name]
    holds = identical(found)
    said = words.count_of(found)
    if said == NONE:
        return reasons.cell(holds.why_not)
    tone = Tone.PLAIN if holds.holds is None else Tone.GOOD if holds.holds else Tone.BAD
    return Cell(said, notes=words.timed_notes(found), tone=tone)


def _cost(found: Cost, reasons: Reasons) -> Cell:
    if isinstance(found.ratio, Missing):
        return reasons.cell(found.ratio.reason)
    span = bounds(found.ci95, "{:.3g}".format) if found.ci95 else ""
    notes = (SAME,) if found.undecided else (no_interval,) if (no_interval := why_missing(found.ci95)) else ()
    return Cell(f"x {found.ratio:.3g}", found.ratio, found.ci95 or None, span, notes)


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
    if isinstance(cost.ratio, Missing):
        return "no effect here" if cost.ratio.reason == NO_EFFECT else NONE
    if not cost.ci95:
        return f"{cost.ratio:.3g}"
    return f"{_brief(cost)}, {SAME}" if cost.undecided else _brief(cost)


def _brief(cost: Cost) -> str:
    if isinstance(cost.ratio, Missing) or not cost.ci95:
        return ratio(cost)
    return f"{cost.ratio:.3g} {bounds(cost.ci95, '{:.3g}'.format)}"
