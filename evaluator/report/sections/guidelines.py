"""Which group for which need, each pick with its rule and the figures that decided."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.metrics.guidelines import Guideline
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Cell, Section, Text, Tone, table
from gpusimbench.evaluator.report.source import Source
from gpusimbench.schemas.text import few, plural

_HOW = (
    "Each pick follows from its rule and from these recordings, and from nothing else. INVALID runs, bodies that went "
    "through the floor, broken checks of mechanics and broken laws in closed form, in any scene, bar a pick, however "
    "good its figures are."
)
_NAMED = 6


def section(source: Source) -> Section | None:
    """None where fewer than two simulators ran under the same conditions."""
    found = source.evaluation.comparison.guidelines
    if not found:
        return None
    shown = table(
        "guidelines",
        "The best simulator for each need",
        ["need, and the rule", "recommended, and the next best", "best first", "not recommended"],
        [(_need(one), _pick(one), _ranking(one), _others(one)) for one in found],
    )
    picked = sum(bool(one.pick) for one in found)
    said = f"a simulator is named for {picked or 'none'} of {plural(len(found), 'need')}"
    return Section("guidelines", "The best simulator for each need", (Text(_HOW), shown), said, folded=True)


def _need(one: Guideline) -> Cell:
    return Cell(one.need, notes=(one.rule,))


def _pick(one: Guideline) -> Cell:
    if isinstance(one.pick, Missing):
        return Cell("none", notes=(one.pick.reason,), tone=Tone.QUIET)
    following = (
        f"next: {one.runner_up}" if one.runner_up else f"no other {'is ranked' if one.unranked else 'qualifies'}"
    )
    return Cell(one.pick, notes=(following,), tone=Tone.GOOD)


def _ranking(one: Guideline) -> Cell:
    if not one.ranking:
        return Cell("-", tone=Tone.QUIET)
    first, *others = (f"{place}. {said}" for place, said in enumerate(one.ranking, start=1))
    return Cell(first, notes=tuple(others))


def _others(one: Guideline) -> Cell:
    first, *others = (*_not_picked(one), "-")
    return Cell(first, notes=tuple(others[:-1]), tone=Tone.QUIET)


def _not_picked(one: Guideline) -> Iterator[str]:
    yield from (f"qualifies too, not ranked: {said}" for said in one.unranked)
    for title, names in (("do not qualify", one.disqualified), ("lack a figure", one.unmeasured)):
        if names:
            yield f"{title}: {few(names, _NAMED)}"
    for said in one.barred:
        yield f"barred: {said}"
