"""What gsb-check finds in one recording, in few words."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.findings import Report, check
from gpusimbench.evaluator.check.rules.rule import PROTOCOL, Level, Scope, load_rules
from gpusimbench.schemas.location import Place

INTEGRITY = "integrity-1"

WHOLE, BROKEN, DAMAGED = "whole", "broken", "damaged"
"""Outcomes: every rule of INTEGRITY holds; one is broken; the file is damaged, or a rule could not be asked."""


@dataclass(frozen=True)
class Checkup:
    """One file, held against the rules. All of it was read: every CRC, every digest, the content hash.

    outcome       WHOLE, BROKEN or DAMAGED
    content_hash  of the recording, that of its content unless the outcome is DAMAGED; empty without an end record
    findings      "rule: what was found", of broken rules of INTEGRITY and of those that could not be asked
    warnings      of rules of INTEGRITY that are no requirement
    deviations    of broken rules of PROTOCOL that one file can break by itself
    """

    outcome: str
    content_hash: str
    findings: tuple[str, ...]
    warnings: tuple[str, ...]
    deviations: tuple[str, ...]


def check_up(path: Place, name: str = "") -> Checkup:
    """Check one file, which findings call by its name where it has one; nothing is raised for what it holds."""
    file = examine(path)
    integrity = check([file], [load_rules(INTEGRITY)])
    protocol = check([file], [load_rules(PROTOCOL)])
    findings = _told(integrity, Level.error)
    unasked = [u for u in integrity.unchecked if u.rule.level is Level.error]
    if not findings:
        findings = [f"{u.rule.id}: not checked, {u.reason}" for u in unasked]
    if name:
        findings = [finding.replace(str(path), name) for finding in findings]
    damaged = unasked or any(f.rule.damage for f in integrity.findings if f.rule.level is Level.error)
    alone = [f"{f.rule.id}: {f.found}" for f in protocol.findings if f.rule.of is Scope.file]
    return Checkup(
        outcome=DAMAGED if damaged else BROKEN if findings else WHOLE,
        content_hash="" if file.end is None else str(file.end.content_hash),
        findings=tuple(dict.fromkeys(findings)),
        warnings=tuple(_told(integrity, Level.warning)),
        deviations=tuple(alone),
    )


def _told(report: Report, level: Level) -> list[str]:
    return [f"{finding.rule.id}: {finding.found}" for finding in report.findings if finding.rule.level is level]
