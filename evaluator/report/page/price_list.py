"""What determinism costs: every level beside the default of the same configuration."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.report.price_table import SAME, family_name, of_family
from gpusimbench.evaluator.results.determinism_cost import Cost, Family, Price
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.result import GroupResult


@dataclass(frozen=True)
class Row:
    """One group of a family; `price` is None for the default itself."""

    result: GroupResult
    price: Price | None
    faults: Faults


def section(source: Source) -> Section | None:
    """None where no two groups differ in determinism alone."""
    families = source.evaluation.price_list
    if not families:
        return None
    context = {"families": [(_name(f), _rows(f), _columns(f), _remarks(f)) for f in families], "cost": cost}
    return Section("prices", "What determinism costs", context, link="Price list")


def _name(family: Family) -> str:
    key = (family.base or family.prices[0].result).group.key
    return f"{family_name(family)}, {key.scene}, {key.n_env} envs, {key.device or 'no device'}"


def _rows(family: Family) -> list[Row]:
    base = [Row(family.base, None, faults(family.base))] if family.base else []
    return [*base, *(Row(p.result, p, faults(p.result)) for p in family.prices)]


def _columns(family: Family) -> tuple[timed.Column, ...]:
    return timed.columns(result.timed for result in of_family(family))


def _remarks(family: Family) -> list[str]:
    return timed.remarks(of_family(family), named=lambda result: result.group.key.determinism)


def cost(found: Cost) -> tuple[str, str]:
    """A ratio and its interval, in three digits."""
    if found.ratio is None:
        return "", found.why_not
    value = f"× {found.ratio:.3g}"
    if found.ci95 is None:
        return value, found.no_interval
    low, high = found.ci95
    return value, f"[{low:.3g}, {high:.3g}]{f' {SAME}' if found.undecided else ''}"
