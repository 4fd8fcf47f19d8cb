"""What determinism costs, in a terminal: a row for each level."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from evaluator.price_list import Cost, Family
from evaluator.report import words
from evaluator.report.console import plain_table
from evaluator.report.numbers import NONE
from evaluator.report.text import printable
from evaluator.results import GroupResult, Metric
from evaluator.soundness import faults

_TITLES = ("", "level", "distinct envs", "distinct runs", "throughput of default", "memory of default")


def print_prices(console: Console, families: Sequence[Family]) -> None:
    """All families in one table; below it why a level has no price, and what speaks against its runs."""
    if not families:
        return
    console.print("what determinism costs", style="bold")
    table, remarks = plain_table(*_TITLES), list[str]()
    names = _names(families)
    for family, said in zip(families, names, strict=True):
        base = [(family.base, ("1", "1"))] if family.base else []
        levels = [(p.result, (ratio(p.speed), ratio(p.memory))) for p in family.prices]
        for index, (result, costs) in enumerate([*base, *levels]):
            name = said if index == 0 else ""
            distinct = [_of(result.metrics[f"distinct_{of}"]) for of in ("envs", "runs")]
            cells = (name, result.group.key.determinism, *distinct, *costs)
            table.add_row(*(Text(printable(cell)) for cell in cells))
            remarks += _remarks(said, result)
        remarks += [
            f"{said}, {p.level}: no price: {words.shortened(p.speed.why_not)}" for p in family.prices if p.speed.why_not
        ]
    console.print(table)
    for line in dict.fromkeys(remarks):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


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
    """A cost with its interval; a dash where there is none."""
    if cost.ratio is None:
        return NONE
    if cost.ci95 is None:
        return f"{cost.ratio:.3g}"
    return f"{cost.ratio:.3g} [{cost.ci95[0]:.3g}, {cost.ci95[1]:.3g}]"


def _of(metric: Metric) -> str:
    return NONE if metric.value is None else f"{metric.value:.0f} of {metric.n}"


def _remarks(name: str, result: GroupResult) -> list[str]:
    found = faults(result)
    wrong = "; ".join(part for part in (found.sunk, found.broken) if part)
    return [f"{name}, {result.group.key.determinism}: {wrong}"] if wrong else []
