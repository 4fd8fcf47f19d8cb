"""What results depend on, as gsb-probe asks: how many answers are as hoped for, and a line a question."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.metrics.levels import MAX_ULP, TOLERANCE_M, EqualityLevel
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.probe.arms import Arms, name_of
from gpusimbench.evaluator.probe.finding import Answer, Finding, verdict_of
from gpusimbench.evaluator.probe.pairs import Found
from gpusimbench.evaluator.probe.questions import Probed
from gpusimbench.evaluator.render.document import Block, Cell, Document, Item, Items, Section, Text, Tone, key_of, table
from gpusimbench.evaluator.render.numbers import scaled, ulps
from gpusimbench.evaluator.report.sections.determinism_cost import ratio
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.determinism_cost import Family
from gpusimbench.schemas.text import plural

_TONES = {Answer.YES: Tone.GOOD, Answer.NO: Tone.BAD, Answer.OPEN: Tone.WARNING, Answer.NOT_ASKED: Tone.QUIET}


_METHOD = (
    "Short runs that differ in one thing alone are compared bit by bit. Open: runs of the same configuration differ, "
    "too, so that nothing can be said of the cause. The answer no is no defect to the last question, and to those "
    "about the device, mirrored states, turned states and identical bodies."
)


def section(source: Source) -> Section | None:
    """None where no run was treated as gsb-probe does."""
    asked = source.evaluation.probed
    if not asked:
        return None
    parts = [_section(number, *one, price="", every=False, several=True) for number, one in enumerate(asked)]
    said = plural(len(asked), "configuration")
    return Section("probed", "What results depend on", (Text(_METHOD), *parts), f"{said} probed", folded=True)


def depends(asked: Sequence[Probed], key: str) -> Cell:
    """The answers to one question of several configurations of a simulator, as one cell: "no" where any is."""
    found = [(one, finding) for one in asked for finding in one.findings if finding.key == key]
    for answer in (Answer.NO, Answer.YES, Answer.OPEN):
        if those := [(one, finding) for one, finding in found if finding.answer is answer]:
            levels = dict.fromkeys(one.arms.key.determinism for one, _ in those)
            notes = [f"at {', '.join(levels)}", *(finding.detail for _, finding in those if finding.detail)]
            return Cell(answer.value, notes=tuple(notes[:2]), tone=_TONES[answer])
    return Cell("not asked", tone=Tone.QUIET)


def probe_document(probed: Sequence[Probed], prices: Sequence[Family], *, every: bool = False) -> Document:
    """A section for each simulator and level, with what the level costs.

    every  also what was held against what, and by which files
    """
    several = len(probed) > 1
    found = [
        _section(number, arms, findings, _price(arms, prices), every, several)
        for number, (arms, findings) in enumerate(probed)
    ]
    return Document("", tuple(found))


def _price(arms: Arms, prices: Sequence[Family]) -> str:
    """What the level costs, in a sentence; empty where it was not clocked, or is the default."""
    for price in (price for family in prices for price in family.prices):
        own, key = price.result.group.recordings[0].configuration, arms.key
        same = (own.simulator, own.scene, own.options) == (key.simulator, key.scene, key.parsed_options)
        if same and price.level == key.determinism and price.result.group.key.device == key.device:
            said = why_missing(price.speed.ratio) or ratio(price.speed)
            return (
                f"Throughput with {plural(own.n_env, 'environment', spec=',')}, relative to the default level: {said}."
            )
    return ""


def _section(number: int, arms: Arms, findings: Sequence[Finding], price: str, every: bool, several: bool) -> Section:
    rows = [_row(finding) for finding in findings]
    blocks: list[Block] = [table(f"probe-{number}", "", ("question", "answer", "evidence"), rows)]
    if price:
        blocks.append(Text(price))
    if every:
        blocks.append(Items(tuple(_compared(finding) for finding in findings if finding.found is not None)))
    title = name_of(arms)
    return Section(key_of("probe", number, title), title, tuple(blocks), verdict_of(findings), folded=several)


def _row(finding: Finding) -> list[Cell | str]:
    answer = Cell(finding.answer.value, tone=_TONES[finding.answer])
    return [finding.title, answer, evidence(finding)]


def _compared(finding: Finding) -> Item:
    assert finding.found is not None
    files = dict.fromkeys(path.name for path in finding.found.files)
    return Item(f"{finding.title}: {finding.compared}", items=tuple(Item(name) for name in files))


def evidence(finding: Finding) -> str:
    """What the answer stands on, in a few words."""
    if finding.found is None:
        return finding.reason
    return "; ".join(filter(None, (_difference(finding.found), finding.detail, finding.reason)))


def _difference(found: Found) -> str:
    pairs = plural(found.pairs, "pair")
    if found.level is EqualityLevel.BIT_IDENTICAL:
        return f"bit-identical: {pairs}, {plural(found.steps, 'step')}"
    parts = [f"from step {found.first_step}, {found.differing} of {pairs}"]
    if found.first is not None:
        first = found.first
        where = f"env {first.env_a}, {first.item} {first.field.partition('/')[2]} {first.component}"
        how = "opposite signs" if first.signs_differ else f"{ulps(first.ulp)} ULP"
        late = f"{how} at step {first.step}, the first recorded state"
        parts.append(f"first by {how} ({where})" if first.step == found.first_step else f"{late} ({where})")
        if found.max_distance:
            parts.append(f"{scaled(found.max_distance, found.unit)} apart at step {found.at_step}")
        if found.level is not EqualityLevel.DIFFERENT:
            limits = {
                EqualityLevel.WITHIN_ULP: f"{MAX_ULP:g} ULP",
                EqualityLevel.WITHIN_TOLERANCE: scaled(TOLERANCE_M, found.unit),
            }
            parts.append(f"never beyond {limits[found.level]}")
    return "; ".join(parts)
