"""What gsb-check prints: a line for each file, and each finding with what to do, readable in 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.rules.facts import CONDITIONS, FACTS
from gpusimbench.evaluator.check.rules.findings import Checked, Finding, Report
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import Level, RuleSet, Scope
from gpusimbench.schemas.text import Block, block, line

_WIDTH = 80
_FILES = 5


def check_text(report: Report) -> Block:
    """The findings of each file, those of several files, and one line that sums them up."""
    lines: list[str] = []
    told: set[str] = set()  # what to do about a rule is said once
    for file in report.files:
        lines += _file(file, report, told)
    several = [finding for finding in report.findings if finding.of]
    for of in dict.fromkeys(finding.of for finding in several):
        lines += _wrapped(of, "")
        for finding in several:
            if finding.of == of:
                lines += _finding(finding, told)
                lines += _wrapped(f"in: {_names(finding)}", " " * 4)
    lines += _wrapped(_sum(report), "")
    return block(lines)


def _file(file: Checked, report: Report, told: set[str]) -> Iterator[str]:
    reason = f": {file.reason}" if file.reason and file.status != "unreadable" else ""
    yield from _wrapped(f"{file.path}: {file.status}{reason}; {file.held} rules hold", "")
    for finding in report.findings:
        if not finding.of and finding.files == (file.path,):
            yield from _finding(finding, told)
    unchecked = [one for one in report.unchecked if one.file == file.path]
    for reason in dict.fromkeys(one.reason for one in unchecked):
        rules = ", ".join(one.rule.id for one in unchecked if one.reason == reason)
        yield from _wrapped(f"not checked: {rules}: {reason}", "  ")


def _finding(finding: Finding, told: set[str]) -> Iterator[str]:
    rule = finding.rule
    yield from _wrapped(f"{rule.level.name} {rule.id}: {finding.found}", "  ")
    if rule.id not in told:
        told.add(rule.id)
        yield from _wrapped(rule.requires, " " * 4)
        yield from _wrapped(f"-> {rule.do}", " " * 4)


def _names(finding: Finding) -> str:
    more = f" and {len(finding.files) - _FILES} more" if len(finding.files) > _FILES else ""
    return ", ".join(path.name for path in finding.files[:_FILES]) + more


def _sum(report: Report) -> str:
    count = len(report.files)
    errors, warnings = report.count(Level.error), report.count(Level.warning)
    damaged = {path for finding in report.findings if finding.rule.damage for path in finding.files}
    found = f"{errors} error{'' if errors == 1 else 's'}, {warnings} warning{'' if warnings == 1 else 's'}"
    lost = f"; {len(damaged)} of them damaged" if damaged else ""
    asked = any(file.held for file in report.files) or report.findings or report.unchecked
    nothing = "" if asked else "; no rule applies to any file, so nothing was checked"
    return f"{count} file{'' if count == 1 else 's'}{lost}, rules {' and '.join(report.rule_sets)}: {found}{nothing}"


def _wrapped(text: str, indent: str) -> list[str]:
    one_line = line(" ".join(text.split()))
    return textwrap.wrap(
        one_line, _WIDTH, initial_indent=indent, subsequent_indent=indent + "    ", break_on_hyphens=False,
        break_long_words=False,
    )  # fmt: skip


def rules_text(rule_sets: Sequence[RuleSet]) -> Block:
    """Every rule of some sets: what it requires, why, what to do; then what rules can be made of."""
    lines: list[str] = []
    for rule_set in rule_sets:
        lines += [*_wrapped(f"{rule_set.name}: {rule_set.title}", ""), ""]
        for rule in rule_set.rules:
            limits = [*rule.when, *(["scene " + " or ".join(rule.scenes)] if rule.scenes else [])]
            only = f", if {' and '.join(limits)}" if limits else ""
            lines += _wrapped(f"{rule.id} ({rule.level.name}, {_scope(rule.of)}{only})", "  ")
            lines += [*_wrapped(rule.requires, " " * 6), *_wrapped(f"Why: {rule.why}", " " * 6)]
            lines += _wrapped(f"-> {rule.do}", " " * 6)
        lines.append("")
    return block(lines)


def vocabulary_text() -> Block:
    """What a file of rules can use: facts, requirements, conditions."""
    lines = ["facts of a file"]
    for name, fact in FACTS.items():
        meaning = Kind[name.removeprefix("problems.")].value if name.startswith("problems.") else fact.meaning
        lines += _wrapped(f"{name} ({fact.type.name}): {meaning}", "  ")
    lines += ["", "requirements of a file"]
    for name, predicate in FILE_PREDICATES.items():
        lines += _wrapped(f"{name}: {predicate.meaning.format('the argument')}", "  ")
    lines += ["", "requirements of a point or of all files"]
    for name, set_predicate in SET_PREDICATES.items():
        lines += _wrapped(f"{name}: {set_predicate.meaning.format('the argument')}", "  ")
    lines += ["", "conditions"]
    for name, (meaning, _) in CONDITIONS.items():
        lines += _wrapped(f"{name}: {meaning}", "  ")
    return block(lines)


def _scope(scope: Scope) -> str:
    return {Scope.file: "each file", Scope.point: "the runs of a point", Scope.set: "all files"}[scope]
