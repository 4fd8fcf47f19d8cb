"""The first part of an audit: which files can be trusted to be what was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from evaluator.integrity import examine
from evaluator.recording import Recording
from evaluator.rules.findings import check
from evaluator.rules.rule import Level, load_rules

RULES = "integrity-1"


@dataclass(frozen=True)
class Check:
    """What became of checking files: findings by file, one sentence each.

    recordings  those that can be audited
    damaged     of each of the others
    broken      broken rules of those that can be audited
    warnings    of those likewise
    """

    recordings: tuple[Recording, ...]
    damaged: dict[Path, tuple[str, ...]]
    broken: dict[Path, tuple[str, ...]]
    warnings: dict[Path, tuple[str, ...]]


def check_files(paths: Sequence[Path]) -> Check:
    """Hold files against the rules of RULES; those that are damaged or have lost data are set aside."""
    files = [examine(path) for path in dict.fromkeys(paths)]
    report = check(files, [load_rules(RULES)])
    errors = [finding for finding in report.findings if finding.rule.level is Level.error]
    found = [(path, f"{f.rule.id}: {f.found}") for f in errors if f.rule.damage for path in f.files]
    unasked = [u for u in report.unchecked if u.rule.level is Level.error]
    found += [(u.file, f"{u.rule.id} cannot be checked: {u.reason}") for u in unasked]
    found += [(f.path, f.not_opened) for f in files if f.recording is None]
    damaged = _by_file(found)
    good = tuple(f.recording for f in files if f.recording is not None and f.path not in damaged)
    broken = [(path, f"{f.rule.id}: {f.found}") for f in errors for path in f.files if path not in damaged]
    warned = [f for f in report.findings if f.rule.level is Level.warning]
    warnings = [(path, f"{f.rule.id}: {f.found}") for f in warned for path in f.files if path not in damaged]
    return Check(good, damaged, _by_file(broken), _by_file(warnings))


def _by_file(findings: Sequence[tuple[Path, str]]) -> dict[Path, tuple[str, ...]]:
    found: dict[Path, list[str]] = {}
    for path, sentence in findings:
        found.setdefault(path, []).append(sentence)
    return {path: tuple(dict.fromkeys(sentences)) for path, sentences in found.items()}
