"""The first part of an audit: which files can be trusted to be what was recorded."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.findings import Unchecked, check
from gpusimbench.evaluator.check.rules.rule import Severity, load_rules
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place

RULES = "integrity-1"


@dataclass(frozen=True)
class Check:
    """What became of checking files: findings by file, one sentence each.

    recordings  those that can be audited, each run once
    damaged     of each of the others; copies are named among the warnings of the file that is kept
    broken      broken rules of those that can be audited
    warnings    of those likewise
    """

    recordings: tuple[Recording, ...]
    damaged: dict[Place, tuple[str, ...]]
    broken: dict[Place, tuple[str, ...]]
    warnings: dict[Place, tuple[str, ...]]


def check_files(paths: Sequence[Place]) -> Check:
    """Hold files against the rules of RULES; those that are damaged or have lost data are set aside, and copies."""
    wanted = list(dict.fromkeys(paths))
    files = [examine(path) for path in each(wanted, "checking recordings", sizes(wanted))]
    report = check(files, [load_rules(RULES)])
    errors = [finding for finding in report.findings if finding.rule.level is Severity.error]
    found = [(path, f"{f.rule.id}: {f.found}") for f in errors if f.rule.damage for path in f.files]
    said = {path for path, _ in found}
    found += [(f.path, f.not_opened) for f in files if f.recording is None and f.path not in said]
    found += _unasked(report.unchecked, {path for path, _ in found})
    damaged = _by_file(found)
    whole = [f.recording for f in files if isinstance(f.recording, Recording) and f.path not in damaged]
    good, copies = _without_copies(whole)
    kept = {recording.path for recording in good}
    broken = [(path, f"{f.rule.id}: {f.found}") for f in errors for path in f.files if path in kept]
    warned = [f for f in report.findings if f.rule.level is Severity.warning]
    warnings = [(path, f"{f.rule.id}: {f.found}") for f in warned for path in f.files if path in kept]
    return Check(good, damaged, _by_file(broken), _by_file([*copies, *warnings]))


def _unasked(unchecked: Sequence[Unchecked], damaged: Set[Place]) -> list[tuple[Place, str]]:
    # of files that nothing else is known of, rules by what keeps them from being asked
    rules = gathered(
        ((u.file, u.reason), u.rule.id) for u in unchecked if u.rule.level is Severity.error and u.file not in damaged
    )
    return [(path, f"{', '.join(ids)} cannot be checked: {reason}") for (path, reason), ids in rules.items()]


def _without_copies(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[tuple[Place, str]]]:
    # files of one run with different contents are damaged by RULES, and so are those without a content hash
    kept: dict[str, Recording] = {}
    copies = []
    for recording in recordings:
        first = kept.setdefault(recording.content_hash, recording)
        if first is not recording:
            copies.append((first.path, f"{recording.path} is a copy of {first.path.name}; it counts once"))
    return tuple(kept.values()), copies


def _by_file(findings: Sequence[tuple[Place, str]]) -> dict[Place, tuple[str, ...]]:
    return {path: tuple(dict.fromkeys(sentences)) for path, sentences in gathered(findings).items()}
