"""Rules asked of files: what is broken, what could not be asked, what the command's exit code is; and which rules of
the benchmark's protocol recordings do not meet: the errors of ``gsb-check --protocol``.

For the protocol, rules of one file are asked while the file is open. Rules of a point and of the whole set are asked of
what is left of the files then. Copies count once before that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.integrity.problem import Problems
from gpusimbench.evaluator.check.rules.fact import Unknown
from gpusimbench.evaluator.check.rules.facts import FACTS, applies, fact_of, point_of
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import PROTOCOL, Rule, RuleSet, Scope, Severity, load_rules
from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.text import plural

OF_THROUGHPUT = (
    "own-start", "window-begin", "window-begin-of-a-toss", "timed-steps", "window-end", "window-end-of-a-toss",
    "timed-seconds", "work-evidence", "declared-evidence", "contacts-at-the-end", "not-frozen", "actions-go-on",
)  # fmt: skip
"""Rules on the timed window and on evidence of work: a throughput whose recordings break such a rule is no merit.
Throughputs of different windows are ranked apart anyway."""

_SCENE = "scene"  # the rule that the scene is one of the benchmark's


@dataclass(frozen=True)
class BrokenRule:
    """A broken rule.

    files  that break it: one, or for rules of several files those that stand out
    of     what the rule was asked of, in words; empty for one file
    found  what was found, one sentence
    """

    rule: Rule
    files: tuple[Place, ...]
    of: str
    found: str


@dataclass(frozen=True)
class Unchecked:
    """A rule that could not be asked of a file, and why."""

    rule: Rule
    file: Place
    reason: str


@dataclass(frozen=True)
class Checked:
    """One file: what it is, and how many rules were asked of it alone.

    status  by its own word; "unreadable" where it cannot be opened
    held    rules that hold
    """

    path: Place
    status: str
    reason: str
    what: str
    held: int


@dataclass(frozen=True)
class Report:
    """What came out of checking files.

    rule_sets  names of the sets that were asked
    """

    rule_sets: tuple[str, ...]
    files: tuple[Checked, ...]
    findings: tuple[BrokenRule, ...]
    unchecked: tuple[Unchecked, ...]

    def count(self, level: Severity) -> int:
        """Findings of a level."""
        return sum(finding.rule.level is level for finding in self.findings)

    @property
    def exit_code(self) -> ExitCode:
        """3 where a file is damaged or cannot be asked, else 4 where an error is found, else 0."""
        errors = [finding.rule for finding in self.findings if finding.rule.level is Severity.error]
        if any(rule.damage for rule in errors) or any(u.rule.level is Severity.error for u in self.unchecked):
            return ExitCode.DATA_LOST
        return ExitCode.GATE_FAILED if errors else ExitCode.OK


def check(files: Sequence[Integrity], rule_sets: Sequence[RuleSet]) -> Report:
    """Ask every rule of every file, point and the set."""
    findings: list[BrokenRule] = []
    unchecked: list[Unchecked] = []
    held = dict.fromkeys(range(len(files)), 0)
    rules = [rule for rule_set in rule_sets for rule in rule_set.rules]
    for index, file in enumerate(files):
        for rule in rules:
            if rule.of is Scope.file:
                answer = _ask(rule, file)
                held[index] += answer == ()
                findings += [
                    BrokenRule(rule, (file.path,), "", found) for found in answer or () if isinstance(found, str)
                ]
                unchecked += [Unchecked(rule, file.path, u.reason) for u in answer or () if isinstance(u, Unknown)]
    for rule in rules:
        if rule.of is Scope.set:
            findings += _ask_set(rule, files, "all files")
        elif rule.of is Scope.point:
            for name, members in points(files):
                findings += _ask_set(rule, members, name)
    return Report(
        tuple(rule_set.name for rule_set in rule_sets),
        tuple(_checked(file, held[index]) for index, file in enumerate(files)),
        tuple(findings),
        tuple(unchecked),
    )


def _ask(rule: Rule, file: Integrity) -> tuple[str | Unknown, ...] | None:
    """What breaks the rule, nothing where it holds, None where it does not apply."""
    relevant = _relevant(rule, file)
    if isinstance(relevant, Unknown):
        return (relevant,)
    if not relevant:
        return None
    value = fact_of(rule.fact, file)
    if isinstance(value, Unknown):
        return (value,)
    try:
        found = FILE_PREDICATES[rule.predicate].found(value, rule.argument, lambda name: _required(fact_of(name, file)))
        unit = FACTS[rule.fact].unit
        return tuple(f"{said} {unit}" for said in found) if unit else found
    except _NotKnown as error:
        return (Unknown(str(error)),)


class _NotKnown(Exception):
    pass


def _required(value: Any) -> Any:
    if isinstance(value, Unknown):
        raise _NotKnown(value.reason)
    return value


def _relevant(rule: Rule, file: Integrity) -> bool | Unknown:
    for condition in rule.when:
        met = applies(condition, file)
        if met is not True:
            return met
    if not rule.scenes:
        return True
    scene = fact_of("scene", file)
    return scene if isinstance(scene, Unknown) else scene in rule.scenes


def _ask_set(rule: Rule, files: Sequence[Integrity], of: str) -> Iterator[BrokenRule]:
    # what one file cannot tell is told by the rules of that file
    asked = [file for file in files if _relevant(rule, file) is True]
    values = {str(index): fact_of(rule.fact, file) for index, file in enumerate(asked)}
    values = {key: value for key, value in values.items() if not isinstance(value, Unknown)}
    if not values:
        return
    predicate = SET_PREDICATES[rule.predicate]
    for found, keys in predicate.found(values, rule.argument, lambda key, name: fact_of(name, asked[int(key)])):
        yield BrokenRule(rule, tuple(asked[int(key)].path for key in keys), of, found)


def points(files: Sequence[Integrity]) -> Iterable[tuple[str, list[Integrity]]]:
    """Runs of each point, with its name; the point at which a sweep ended, where no run is complete, is none."""
    members = gathered((key, file) for file in files if (key := point_of(file)) is not None)
    reached = {key for key, runs in members.items() if any(fact_of("complete", run) is True for run in runs)}
    for key, runs in members.items():
        simulator, scene, n_env, options, determinism = key
        below = any(_same_but_smaller(other, key) for other in reached)
        if key in reached or not below:
            chosen = [] if options == "{}" else [options]
            chosen += [] if determinism == "default" else [f"determinism {determinism}"]
            yield ", ".join([f"{simulator}, {scene}, {plural(int(n_env), 'environment')}", *chosen]), runs


def _same_but_smaller(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    return (one[:2], one[3:]) == (other[:2], other[3:]) and int(one[2]) < int(other[2])


def _checked(file: Integrity, held: int) -> Checked:
    status, reason = "unreadable", file.not_opened
    if file.recording is not None:
        status, reason = file.recording.status, file.recording.reason
    what = ""
    if file.provenance is not None:
        c = file.provenance.configuration
        what = f"{c.simulator} {c.scene} n={c.n_env} run {c.run_index}"
    return Checked(file.path, status, reason, what, held)


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
