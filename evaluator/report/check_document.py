"""What gsb-check says: the verdict, then each file that has findings with what to do, then how many files have none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.rules.facts import CONDITIONS, FACTS
from gpusimbench.evaluator.check.rules.findings import Checked, Finding, Report
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import Level, RuleSet, Scope
from gpusimbench.evaluator.render.document import Block, Document, Facts, Item, Items, Section, Text, Tone, facts, items

_FILES = 5
_TONES = {Level.error: Tone.BAD, Level.warning: Tone.WARNING}
_COMPLETE = "complete"


def check_document(report: Report, *, every: bool = False) -> Document:
    """The verdict, the findings of each file and of several files; with `every`, files without findings too."""
    every = every or len(report.files) == 1
    told: set[str] = set()  # what to do about a rule is said once
    files = [_file(file, report, told) for file in report.files if every or _remarkable(file, report)]
    several = [finding for finding in report.findings if finding.of]
    for of in dict.fromkeys(finding.of for finding in several):
        files.append(Item(of, items=tuple(_finding(finding, told) for finding in several if finding.of == of)))
    blocks: list[Block] = [_verdict(report), Items(tuple(files))]
    fine = sum(not _remarkable(file, report) for file in report.files)
    if fine and not every:
        blocks.append(Text(f"files without findings: {fine} (listed with --all)", Tone.QUIET))
    return Document("", tuple(blocks))


def _remarkable(file: Checked, report: Report) -> bool:
    found = any(not finding.of and finding.files == (file.path,) for finding in report.findings)
    return found or file.status != _COMPLETE or any(one.file == file.path for one in report.unchecked)


def _file(file: Checked, report: Report, told: set[str]) -> Item:
    reason = f": {_joined(file.reason)}" if file.reason and file.status != "unreadable" else ""
    said = [
        _finding(finding, told)
        for finding in report.findings
        if not finding.of and finding.files == (file.path,)
    ]  # fmt: skip
    unchecked = [one for one in report.unchecked if one.file == file.path]
    for why in dict.fromkeys(one.reason for one in unchecked):
        rules = ", ".join(one.rule.id for one in unchecked if one.reason == why)
        said.append(Item(f"not checked: {rules}: {_joined(why)}", Tone.WARNING))
    return Item(f"{file.path}: {file.status}{reason}; {file.held} rules hold", items=tuple(said))


def _finding(finding: Finding, told: set[str]) -> Item:
    rule = finding.rule
    below = [] if rule.id in told else [Item(_joined(rule.requires)), Item(f"-> {_joined(rule.do)}")]
    told.add(rule.id)
    if finding.of:
        below.append(Item(f"in: {_names(finding)}"))
    return Item(f"{rule.level.name} {rule.id}: {_joined(finding.found)}", _TONES[rule.level], tuple(below))


def _names(finding: Finding) -> str:
    more = f" and {len(finding.files) - _FILES} more" if len(finding.files) > _FILES else ""
    return ", ".join(path.name for path in finding.files[:_FILES]) + more


def _verdict(report: Report) -> Text:
    count = len(report.files)
    errors, warnings = report.count(Level.error), report.count(Level.warning)
    damaged = {path for finding in report.findings if finding.rule.damage for path in finding.files}
    found = f"{errors} error{'' if errors == 1 else 's'}, {warnings} warning{'' if warnings == 1 else 's'}"
    lost = f"; {len(damaged)} of them damaged" if damaged else ""
    asked = any(file.held for file in report.files) or report.findings or report.unchecked
    nothing = "" if asked else "; no rule applies to any file, so nothing was checked"
    bad = errors or report.exit_code
    tone = Tone.BAD if bad else Tone.WARNING if warnings or not asked else Tone.GOOD
    files = f"{count} file{'' if count == 1 else 's'}"
    return Text(f"{files}{lost}, rules {' and '.join(report.rule_sets)}: {found}{nothing}", tone)


def rules_document(rule_sets: Sequence[RuleSet]) -> Document:
    """Every rule of some sets: what it requires, why, what to do; then what rules can be made of."""
    sections = [
        Section(rule_set.name, rule_set.name, (_rules(rule_set),), summary=rule_set.title) for rule_set in rule_sets
    ]
    vocabulary = [
        Section(title.replace(" ", "-"), title, (meanings,))
        for title, meanings in (
            ("facts of a file", facts(*_facts())),
            ("requirements of a file", _meanings({n: p.meaning for n, p in FILE_PREDICATES.items()})),
            ("requirements of a point or of all files", _meanings({n: p.meaning for n, p in SET_PREDICATES.items()})),
            ("conditions", _meanings({name: meaning for name, (meaning, _) in CONDITIONS.items()})),
        )
    ]
    return Document("", (*sections, *vocabulary))


def _rules(rule_set: RuleSet) -> Items:
    made = []
    for rule in rule_set.rules:
        limits = [*rule.when, *(["scene " + " or ".join(rule.scenes)] if rule.scenes else [])]
        only = f", if {' and '.join(limits)}" if limits else ""
        said = tuple(map(Item, map(_joined, (rule.requires, f"Why: {rule.why}", f"-> {rule.do}"))))
        made.append(Item(f"{rule.id} ({rule.level.name}, {_scope(rule.of)}{only})", items=said))
    return items(*made)


def _facts() -> Iterator[tuple[str, str]]:
    for name, fact in FACTS.items():
        meaning = Kind[name.removeprefix("problems.")].value if name.startswith("problems.") else fact.meaning
        yield f"{name} ({fact.type.name})", meaning


def _meanings(meanings: dict[str, str]) -> Facts:
    return facts(*((name, meaning.format("the argument")) for name, meaning in meanings.items()))


def _joined(text: str) -> str:
    """A text of several lines, as files of rules have, on one."""
    return " ".join(text.split())


def _scope(scope: Scope) -> str:
    return {Scope.file: "each file", Scope.point: "the runs of a point", Scope.set: "all files"}[scope]
