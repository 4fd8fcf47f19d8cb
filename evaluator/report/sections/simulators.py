"""Each simulator by itself: what it is, what each of its groups did, and what speaks against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Block, Cell, Column, Facts, Item, Section, facts, items, key_of
from gpusimbench.evaluator.render.numbers import ranked
from gpusimbench.evaluator.report.sections.divergence import onset
from gpusimbench.evaluator.report.sections.rows import Reasons, column_of, of_groups, ordered
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.verdicts import QUESTIONS, TO_REFERENCE, usual
from gpusimbench.evaluator.results.cost_metrics import FPS, ranked_throughput
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_ENVS
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import plural


def section(source: Source) -> Section | None:
    """A folded part for each simulator."""
    parts = tuple(_simulator(source, *one) for one in ordered(source.evaluation.results, "simulator").items())
    if not parts:
        return None
    return Section("each", "Each simulator", parts, plural(len(parts), "simulator"), folded=True)


def _simulator(source: Source, name: str, results: list[GroupResult]) -> Section:
    questions = [*QUESTIONS, *([TO_REFERENCE] if source.evaluation.reference else [])]
    said = "; ".join(f"{one.title}: {one.answer(results).text}" for one in questions)
    return Section(
        key_of("simulator", name), name, tuple(_blocks(source, results)), said, folded=True, facets={"simulator": name}
    )


def _blocks(source: Source, results: list[GroupResult]) -> Iterator[Block]:
    yield _facts(results)
    shown = [r for r in usual(results) if r in source.shown]
    reasons = Reasons()
    questions = [*QUESTIONS, *([TO_REFERENCE] if source.evaluation.reference else [])]
    answers = [(Column(q.title, q.meaning), lambda r, q=q: q.answer([r])) for q in questions]
    if shown:
        key = key_of("groups", shown[0].group.key.simulator)
        columns = [*answers, column_of(FPS, reasons)]
        yield of_groups(source, key, "Groups", shown, columns, reasons, more=lambda r: _remarks(r))
    lines = []
    if hidden := [r for r in results if r in source.hidden]:
        sizes = sorted({r.group.key.n_env for r in hidden})
        fastest = max(hidden, key=lambda r: ranked_throughput(r.metrics[FPS.name]))
        speed = ranked(fastest.metrics[FPS.name]).text
        said = f"{plural(len(hidden), 'group')} of sweeps, {sizes[0]:,} to {sizes[-1]:,} envs"
        said = f"{said}; fastest: {speed} {FPS.unit} at {plural(fastest.group.key.n_env, 'env', spec=',')}: see scaling"
        lines.append(Item(said, link="scaling"))
    if probed := len([r for r in results if r in source.shown]) - len(shown):
        said = f"{plural(probed, 'group')} of runs that only gsb-probe needs: see what results depend on"
        lines.append(Item(said, link="probed" if source.evaluation.probed else ""))
    if lines:
        yield items(*lines)


def _remarks(result: GroupResult) -> Iterator[Block]:
    """What speaks against a group, when it comes apart, and how it was run unlike others."""
    said = [str(faults(result)), _apart(result), *result.footnotes]
    if found := [one for one in said if one]:
        yield items(*found)


def _apart(result: GroupResult) -> str:
    """From when on environments and runs differ; empty where neither is known to."""
    if isinstance(result.metrics[DISTINCT_ENVS.name].value, Missing):
        return ""
    found = onset(result)
    parts = (("environments", found.envs), ("runs", found.runs))
    return "; ".join(f"{what} differ from {said} on" for what, said in parts if said.startswith("step"))


def _facts(results: Sequence[GroupResult]) -> Facts:
    keys = [r.group.key for r in results]
    runs = sum(len(r.group.recordings) for r in results)
    return facts(
        ("versions", _listed(key.version for key in keys)),
        ("devices", _listed(key.device for key in keys)),
        ("scenes", _listed(key.scene for key in keys)),
        ("levels of determinism", _listed(key.determinism for key in keys)),
        ("recordings", Cell(str(runs), float(runs), link="recordings")),
    )


def _listed(values: Iterator[str] | Sequence[str]) -> str:
    # a device's name has commas of its own
    return "; ".join(dict.fromkeys(value or "not stated" for value in values))
