"""Rules asked of files: what is broken, what could not be asked, what the command's exit code is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.rules.fact import Unknown
from gpusimbench.evaluator.check.rules.facts import FACTS, applies, fact_of, point_of
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import Rule, RuleSet, Scope, Severity
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.text import plural


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
