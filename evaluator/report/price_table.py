"""What determinism costs, in a terminal: a row for each level."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.render.console import plain_table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.results.determinism_cost import NO_EFFECT, Cost, Family, Price
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import printable

SAME = "cannot be told apart from 1"

_TITLES = ("", "level", "distinct envs", "distinct runs", "throughput of default", "memory of default")


def print_prices(console: Console, families: Sequence[Family]) -> None:
    """All families in one table; below it why a level has no price, and what speaks against its runs."""
    if not families:
        return
    console.print("what determinism costs", style="bold")
    beside = timed.columns_within([[result.timed for result in of_family(family)] for family in families])
    table, remarks = plain_table(*_TITLES, *(column.title for column in beside)), list[str]()
    table.columns[1].no_wrap = True
    names = _names(families)
    for family, said in zip(families, names, strict=True):
        base = [(family.base, ("1", "1"))] if family.base else []
        levels = [(p.result, (_brief(p.speed), _brief(p.memory))) for p in family.prices]
        for index, (result, costs) in enumerate([*base, *levels]):
            name = said if index == 0 else ""
            distinct = [words.count_of(result.metrics[f"distinct_{of}"]) for of in ("envs", "runs")]
            cells = (name, result.group.key.determinism, *distinct, *costs, *timed.cells(beside, result.timed))
            table.add_row(*(Text(printable(cell)) for cell in cells))
            remarks += _remarks(said, result)
        for price in family.prices:
            remarks += [f"{said}, {price.level}: {line}" for line in _of_price(price)]
        lines = timed.remarks(of_family(family), named=lambda result: result.group.key.determinism)
        remarks += [f"{said}: {line}" for line in lines if line != timed.LEGEND]
    remarks.append(timed.LEGEND)
    console.print(table)
    for line in dict.fromkeys(remarks):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


def _of_price(price: Price) -> Iterator[str]:
    if why_not := price.speed.why_not:
        yield why_not if why_not == NO_EFFECT else f"no price: {words.shortened(why_not)}"
    for name, cost in (("throughput", price.speed), ("memory", price.memory)):
        if cost.undecided:
            yield f"{name} {SAME}: the interval contains it"


def of_family(family: Family) -> list[GroupResult]:
    """Its groups, the default first."""
    return [*([family.base] if family.base else []), *(price.result for price in family.prices)]


def family_name(family: Family) -> str:
    """The simulator, with the options that were given."""
    first = (family.base or family.prices[0].result).group
    given = ", ".join(f"{name}={value}" for name, value in first.recordings[0].configuration.options.items())
    return f"{first.key.simulator} [{given}]" if given else first.key.simulator


def _names(families: Sequence[Family]) -> list[str]:
    # scene and number of environments where a name alone would be two families'
    names = [family_name(family) for family in families]
    keys = [(family.base or family.prices[0].result).group.key for family in families]
    return [
        name if names.count(name) == 1 else f"{name}, {key.scene}, {key.n_env} envs"
        for name, key in zip(names, keys, strict=True)
    ]


def ratio(cost: Cost) -> str:
    """A cost with its interval, and whether it can be told apart from 1; a dash where there is none."""
    if cost.ratio is None:
        return "no effect here" if cost.why_not == NO_EFFECT else NONE
    if cost.ci95 is None:
        return f"{cost.ratio:.3g}"
    return f"{_brief(cost)}, {SAME}" if cost.undecided else _brief(cost)


def _brief(cost: Cost) -> str:
    # a terminal has little room: what cannot be told apart from 1 is said below the table
    if cost.ratio is None or cost.ci95 is None:
        return ratio(cost)
    return f"{cost.ratio:.3g} [{cost.ci95[0]:.3g}, {cost.ci95[1]:.3g}]"


def _remarks(name: str, result: GroupResult) -> list[str]:
    found = faults(result)
    wrong = "; ".join(part for part in (found.sunk, found.broken) if part)
    return [f"{name}, {result.group.key.determinism}: {wrong}"] if wrong else []
