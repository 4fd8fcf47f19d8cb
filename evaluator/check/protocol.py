"""Which rules of the benchmark's protocol recordings do not meet: the errors of ``gsb-check --protocol``.

Rules of one file are asked while the file is open. Rules of a point and of the whole set are asked of what is left of
the files then. Copies count once before anything is asked here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.integrity.problem import Problems
from gpusimbench.evaluator.check.rules.findings import check, points
from gpusimbench.evaluator.check.rules.rule import PROTOCOL, RuleSet, Scope, Severity, load_rules
from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.run import Run

OF_THROUGHPUT = (
    "own-start", "window-begin", "window-begin-of-a-toss", "timed-steps", "window-end", "window-end-of-a-toss",
    "timed-seconds", "work-evidence", "declared-evidence", "contacts-at-the-end", "not-frozen", "actions-go-on",
)  # fmt: skip
"""Rules on the timed window and on evidence of work: a throughput whose recordings break such a rule is no merit.
Throughputs of different windows are ranked apart anyway."""

_SCENE = "scene"  # the rule that the scene is one of the benchmark's


@dataclass(frozen=True)
class Unmet:
    """Rules that some recordings do not meet.

    findings  by rule, how many files or points break it
    """

    findings: Mapping[str, int] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Findings of all rules, as ``gsb-check --protocol`` counts errors."""
        return sum(self.findings.values())

    @property
    def of_throughput(self) -> str:
        """Why a throughput of these recordings is no merit, in words; empty where nothing speaks against it."""
        wrong = [sentence.rstrip(".") for rule, sentence in _sentences().items() if rule in self.findings]
        text = "; ".join(f"{sentence[0].lower()}{sentence[1:]}" for sentence in wrong)
        return f"{PROTOCOL} not met: {text}" if text else ""


def unmet_by_file(recording: Recording) -> tuple[str, ...]:
    """The rules that an open recording breaks by itself."""
    found = check([_shell(recording)], [_rules(Scope.file)]).findings
    return tuple(finding.rule.id for finding in found)


class Protocol:
    """The rules that a set of recordings does not meet, for the whole set and for groups of it.

    whole      of the recordings whose scenes are the benchmark's
    elsewhere  names of the other scenes, for which the protocol is not made
    """

    def __init__(self, recordings: Sequence[Run]) -> None:
        shells = [_shell(one) for one in recordings]
        by_point = Counter((f.of, f.rule.id) for f in check(shells, [_rules(Scope.point)]).findings)
        run_ids = {id(shell): one.provenance.run_id for shell, one in zip(shells, recordings, strict=True)}
        self._points = [
            (
                frozenset(run_ids[id(shell)] for shell in members),
                {r: n for (of, r), n in by_point.items() if of == name},
            )
            for name, members in points(shells)
        ]
        names = {one.path: one.provenance.run_id for one in recordings}
        self._points += [
            (frozenset(names[path] for path in finding.files), {finding.rule.id: 1})
            for finding in check(shells, [_rules(Scope.set)]).findings
        ]
        self.whole = self.of(one for one in recordings if _SCENE not in one.unmet)
        self.elsewhere = tuple(dict.fromkeys(one.configuration.scene for one in recordings if _SCENE in one.unmet))

    def of(self, recordings: Iterable[Run]) -> Unmet:
        """What some of the recordings do not meet: rules of each file, and of the points that they belong to."""
        found = list(recordings)
        run_ids = {one.provenance.run_id for one in found}
        count = Counter(rule for one in found for rule in one.unmet)
        for members, findings in self._points:
            if members & run_ids:
                count.update(findings)
        return Unmet(dict(count))


@cache
def _sentences() -> dict[str, str]:
    broken = {rule.id: rule.broken for rule in load_rules(PROTOCOL).rules}
    return {rule: broken[rule] for rule in OF_THROUGHPUT}


@cache
def _rules(scope: Scope) -> RuleSet:
    everything = load_rules(PROTOCOL)
    return replace(everything, rules=tuple(r for r in everything.rules if r.of is scope and r.level is Severity.error))


def _shell(recording: Described) -> Integrity:
    # the evaluation has verified the file; nothing of it is looked at again
    return Integrity(
        path=recording.path, problems=Problems(), recording=recording, not_opened="", scan=None,
        provenance=recording.provenance, simulation=recording.simulation, end=None, complete=False,
    )  # fmt: skip
