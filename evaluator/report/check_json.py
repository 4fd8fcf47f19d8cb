"""What gsb-check found, for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gpusimbench.evaluator.check.rules.findings import Report
from gpusimbench.evaluator.check.rules.rule import Rule, RuleSet
from gpusimbench.evaluator.json_values import dump, picked, plain
from gpusimbench.schemas import __version__

SCHEMA_VERSION = 1


def dump_check(report: Report) -> str:
    """A JSON document: files, findings, what could not be checked, the exit code."""
    return _dump({
        "rule_sets": list(report.rule_sets),
        "exit_code": int(report.exit_code),
        "files": [
            {"path": str(f.path), **picked(f, "what status reason"), "rules_held": f.held} for f in report.files
        ],
        "findings": [
            {
                "rule": finding.rule.id,
                "level": finding.rule.level.name,
                "damage": finding.rule.damage,
                "files": [str(path) for path in finding.files],
                **picked(finding, "of found"),
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
    document = {"schema_version": SCHEMA_VERSION, "gpusimbench": __version__, **record}
    return dump(document)
