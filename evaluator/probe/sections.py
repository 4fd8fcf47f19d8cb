"""What gsb-probe says: how many answers are as hoped for, and a line a question."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.metrics.levels import MAX_ULP, TOLERANCE_M, Level
from gpusimbench.evaluator.probe.arms import Arms
from gpusimbench.evaluator.probe.pairs import Found
from gpusimbench.evaluator.probe.questions import Answer, Finding
from gpusimbench.evaluator.render.document import Block, Cell, Document, Item, Items, Section, Tone, key_of, table

_TONES = {Answer.YES: Tone.GOOD, Answer.NO: Tone.BAD, Answer.OPEN: Tone.WARNING, Answer.NOT_ASKED: Tone.QUIET}
_UNITS = {"m": (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9)),
          "rad": (("rad", 1.0), ("mrad", 1e-3), ("urad", 1e-6), ("nrad", 1e-9))}  # fmt: skip

Probed = tuple[Arms, Sequence[Finding]]


def probe_document(probed: Sequence[Probed], *, every: bool = False) -> Document:
    """A section for each simulator and level; with `every`, also what was held against what, and by which files."""
    several = len(probed) > 1
    found = [_section(number, arms, findings, every, several) for number, (arms, findings) in enumerate(probed)]
    return Document("", tuple(found))


def name_of(arms: Arms) -> str:
    """Simulator, version, level, device."""
    key = arms.key
    level = "" if key.determinism == "default" else f", determinism {key.determinism}"
    options = "" if key.options == "{}" else f", {key.options}"
    return f"{key.simulator} {key.version}{level}{options} on {key.device}, {key.scene}"


def verdict_of(findings: Sequence[Finding]) -> str:
    """One sentence: how many answers are yes, and which are no."""
    asked = [one for one in findings if one.answer is not Answer.NOT_ASKED]
    yes = [one for one in asked if one.answer is Answer.YES]
    said = f"{len(yes)} of {len(asked)} answers are yes" if asked else "nothing was asked"
    parts = [said]
    for answer in (Answer.NO, Answer.OPEN):
        if titles := [one.title for one in findings if one.answer is answer]:
            parts.append(f"{answer.value}: {', '.join(titles)}")
    return "; ".join(parts)


def _section(number: int, arms: Arms, findings: Sequence[Finding], every: bool, several: bool) -> Section:
    rows = [_row(finding) for finding in findings]
    blocks: list[Block] = [table(f"probe-{number}", "", ("question", "answer", "evidence"), rows)]
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
        return finding.why
    said = _found(finding.found)
    return f"{said}; {finding.why}" if finding.why else said


def _found(found: Found) -> str:
    pairs = f"{found.pairs} pair{'' if found.pairs == 1 else 's'}"
    if found.level is Level.BIT_IDENTICAL:
        return f"bit-identical: {pairs}, {found.steps} step{'' if found.steps == 1 else 's'}"
    parts = [f"from step {found.first_step}, {found.differing} of {pairs}"]
    if found.first is not None:
        first = found.first
        where = f"env {first.env_a}, {first.item} {first.field.partition('/')[2]} {first.component}"
        parts.append(f"first by {first.ulp:,} ULP ({where})")
        if found.max_distance:
            parts.append(f"{_amount(found.max_distance, found.unit)} apart at step {found.at_step}")
        if found.level is not Level.DIFFERENT:
            limits = {Level.WITHIN_ULP: f"{MAX_ULP:g} ULP", Level.WITHIN_TOLERANCE: _amount(TOLERANCE_M, found.unit)}
            parts.append(f"never beyond {limits[found.level]}")
    return "; ".join(parts)


def _amount(value: float, unit: str) -> str:
    for name, size in _UNITS[unit]:
        if value >= size:
            return f"{value / size:.3g} {name}"
    return f"{value:.3g} {unit}"
