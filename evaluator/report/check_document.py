"""What gsb-check says: the verdict, then each broken rule once, with what it requires and what to do; also as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.rules.fact import FactType
from gpusimbench.evaluator.check.rules.facts import CONDITIONS, FACTS
from gpusimbench.evaluator.check.rules.findings import BrokenRule, Checked, Report
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import Rule, RuleSet, Scope, Severity
from gpusimbench.evaluator.json_values import document_of, dump, picked, plain
from gpusimbench.evaluator.render.document import Block, Document, Facts, Item, Items, Section, Text, Tone, facts, items
from gpusimbench.schemas import __version__
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.text import plural

_NAMES = 3
"""Files that are named; of more, the number is said."""

_RULES = 4
"""Rules that are named as not checked; of more, the number is said."""

_TONES = {Severity.error: Tone.BAD, Severity.warning: Tone.WARNING}
_COMPLETE = "complete"
_DAMAGES = {"recording": ("cannot be read", "cannot be read"), "no-dropouts": ("has lost data", "have lost data")}
_DAMAGED = ("is damaged", "are damaged")
"""What a file is that breaks a rule on damage, by the rule's id; of one file and of several."""


def check_document(report: Report, *, every: bool = False) -> Document:
    """The verdict, then an item for each broken rule; with `every`, all findings of every file instead."""
    if every:
        return Document("", (_verdict(report), _by_file(report)))
    listed = [*_by_rule(report), *_not_complete(report), *_not_checked(report)]
    blocks: list[Block] = [_verdict(report), Items(tuple(listed))]
    if len(report.files) == 1:
        held = report.files[0].held
        status = f"the run is {_COMPLETE}; " if report.files[0].status == _COMPLETE else ""
        blocks.append(Text(f"{status}{plural(held, 'rule')} met", Tone.QUIET))
    elif fine := sum(not _remarkable(file, report) for file in report.files):
        blocks.append(Text(f"{plural(fine, 'file')} without findings", Tone.QUIET))
    if listed and (len(report.files) > 1 or len({one.rule.id for one in report.findings}) < len(report.findings)):
        blocks.append(Text("--all lists every finding of every file", Tone.QUIET))
    return Document("", tuple(blocks))


def _verdict(report: Report) -> Text:
    errors, warnings = report.count(Severity.error), report.count(Severity.warning)
    counts = f"{plural(errors, 'error')}, {plural(warnings, 'warning')}"
    rules = f"(rules: {' and '.join(report.rule_sets)})"
    if report.exit_code:
        return Text(f"FAILED: {_wrong(report)}: {counts} {rules}", Tone.BAD)
    files = _names([file.path for file in report.files], report, named=1)
    if not (any(file.held for file in report.files) or report.findings or report.unchecked):
        return Text(f"NOTHING CHECKED: no rule applies to {files} {rules}", Tone.WARNING)
    ended = sum(file.status != _COMPLETE for file in report.files)
    more = f"; {plural(ended, 'run')} not complete" if ended else ""
    if warnings:
        return Text(f"PASSED: no error in {files}, {plural(warnings, 'warning')}{more} {rules}", Tone.WARNING)
    return Text(f"PASSED: no error and no warning in {files}{more} {rules}", Tone.WARNING if ended else Tone.GOOD)


def _wrong(report: Report) -> str:
    """How many files are damaged, and how many others break a rule."""
    errors = [finding for finding in report.findings if finding.rule.level is Severity.error]
    what: dict[Place, tuple[str, str]] = {}
    for finding in errors:
        if finding.rule.damage:
            said = _DAMAGES.get(finding.rule.id, _DAMAGED)
            for path in finding.files:
                what[path] = said if what.get(path, said) == said else _DAMAGED
    for one in report.unchecked:
        if one.rule.level is Severity.error:
            what.setdefault(one.file, ("cannot be checked", "cannot be checked"))
    for finding in errors:
        for path in finding.files:
            what.setdefault(path, ("breaks rules", "break rules"))
    parts = []
    for said in dict.fromkeys(what.values()):
        files = [path for path, found in what.items() if found == said]
        if len(report.files) == 1:
            parts.append(f"{files[0].name} {said[0]}")
        else:
            whole = len(files) == len(report.files)
            of = (
                _all(report)
                if whole
                else str(len(files))
                if parts
                else f"{len(files)} of {plural(len(report.files), 'file')}"
            )
            names = f" ({_names(files, report)})" if len(files) <= _NAMES and not whole else ""
            parts.append(f"{of} {said[len(files) > 1]}{names}")
    return ", ".join(parts)


def _by_rule(report: Report) -> Iterator[Item]:
    """An item for each broken rule: the first finding, how many more there are, and in which files."""
    rules: dict[tuple[str, str], list[BrokenRule]] = {}
    for finding in report.findings:
        kind = finding.found if FACTS[finding.rule.fact].apart else ""
        rules.setdefault((finding.rule.id, kind), []).append(finding)
    for findings in sorted(rules.values(), key=lambda found: (found[0].rule.level.name, not found[0].rule.damage)):
        first, rule = findings[0], findings[0].rule
        others = sum(finding.found != first.found for finding in findings)
        more = f"; and {plural(others, 'more finding')} of this rule" if others else ""
        files = list(dict.fromkeys(path for finding in findings for path in finding.files))
        where = f" ({_names(files, report)})" if len(report.files) > 1 else ""
        below = _advice(rule)
        if first.of:
            points = len({finding.of for finding in findings})
            below.insert(0, Item(f"in {first.of}{f', and in {points - 1} more' if points > 1 else ''}"))
        yield Item(f"{_heading(first)}{more}{where}", _TONES[rule.level], tuple(below))


def _not_complete(report: Report) -> Iterator[Item]:
    """Runs that did not end as they should, by how they ended."""
    ends = gathered(
        ((file.status, _joined(file.reason)), file.path)
        for file in report.files
        if file.status not in (_COMPLETE, "unreadable")
    )
    for (status, reason), files in ends.items():
        where = f" ({_names(files, report)})" if len(report.files) > 1 else ""
        yield Item(f"the run is {status}{f': {reason}' if reason else ''}{where}", Tone.WARNING)


def _not_checked(report: Report) -> Iterator[Item]:
    """Rules that could not be asked, by the reason."""
    reasons = gathered((one.reason, one) for one in report.unchecked)
    for reason, found in reasons.items():
        ids = dict.fromkeys(one.rule.id for one in found)
        rules = ", ".join(ids) if len(ids) <= _RULES else plural(len(ids), "rule")
        where = f" ({_names([one.file for one in found], report)})" if len(report.files) > 1 else ""
        yield Item(f"not checked: {rules}: {_joined(reason)}{where}", Tone.WARNING)


def _names(files: Sequence[Place], report: Report, named: int = _NAMES) -> str:
    """The names of a few files, or how many of all they are."""
    distinct = list(dict.fromkeys(files))
    if len(distinct) <= named:
        return ", ".join(path.name for path in distinct)
    if len(distinct) == len(report.files):
        return _all(report) if named > 1 else plural(len(distinct), "file")
    return f"{len(distinct)} of {len(report.files)} files"


def _all(report: Report) -> str:
    return f"all {len(report.files)} files"


def _by_file(report: Report) -> Items:
    """Every file with its findings, then the findings of several files."""
    told: set[str] = set()  # what to do about a rule is said once
    files = [_file(file, report, told) for file in report.files]
    several = [finding for finding in report.findings if finding.of]
    for of in dict.fromkeys(finding.of for finding in several):
        files.append(Item(of, items=tuple(_finding(finding, told) for finding in several if finding.of == of)))
    return Items(tuple(files))


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
    return Item(f"{file.path}: {file.status}{reason}; {plural(file.held, 'rule')} met", items=tuple(said))


def _finding(finding: BrokenRule, told: set[str]) -> Item:
    rule = finding.rule
    below = [] if rule.id in told else _advice(rule)
    told.add(rule.id)
    if finding.of:
        below.append(Item(f"in: {', '.join(path.name for path in finding.files)}"))
    return Item(_heading(finding), _TONES[rule.level], tuple(below))


def _advice(rule: Rule) -> list[Item]:
    """What is required, where the heading does not say what is wrong, and what to do."""
    required = [] if rule.broken else [Item(f"Required: {_joined(rule.requires)}")]
    return [*required, Item(f"Fix: {_joined(rule.do)}")]


def _heading(finding: BrokenRule) -> str:
    """What is wrong, and what was found; of a fact that is true or false the first says both."""
    rule, found = finding.rule, _joined(finding.found)
    if rule.broken:
        what = _joined(rule.broken).rstrip(".")
        found = what if FACTS[rule.fact].type is FactType.flag and rule.of is Scope.file else f"{what}; {found}"
    return f"{rule.level.name} {rule.id}: {found}"


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
        said = tuple(map(Item, map(_joined, (rule.requires, f"Why: {rule.why}", f"Fix: {rule.do}"))))
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


def dump_check(report: Report) -> str:
    """A JSON document: files, findings, what could not be checked, the exit code."""
    return _dump({
        "rule_sets": list(report.rule_sets),
        "exit_code": int(report.exit_code),
        "files": [
            {"file": str(f.path), **picked(f, "what status reason"), "rules_held": f.held} for f in report.files
        ],
        "findings": [
            {
                "rule": finding.rule.id,
                "level": finding.rule.level.name,
                "damage": finding.rule.damage,
                "files": [str(path) for path in finding.files],
                "set": finding.of,
                **picked(finding, "found"),
                **picked(finding.rule, "requires do"),
            }
            for finding in report.findings
        ],
        "unchecked": [{"rule": u.rule.id, "file": str(u.file), "reason": u.reason} for u in report.unchecked],
    })  # fmt: skip


def dump_rules(rule_sets: Sequence[RuleSet]) -> str:
    """A JSON document of rules."""
    return _dump({
        "rule_sets": [
            {"name": s.name, "title": s.title, "rules": [_rule(rule) for rule in s.rules]} for s in rule_sets
        ]
    })  # fmt: skip


def _rule(rule: Rule) -> dict[str, Any]:
    return {
        "id": rule.id,
        "level": rule.level.name,
        "of": rule.of.name,
        "fact": rule.fact,
        "must": {rule.predicate: plain(rule.argument)},
        **picked(rule, "when scenes damage requires why do"),
    }


def _dump(record: dict[str, Any]) -> str:
    return dump(document_of({"gpusimbench": __version__, **record}))
