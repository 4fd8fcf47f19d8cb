"""Rules as data: a versioned set in a TOML file. Nothing in it is executed."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.check.rules.facts import CONDITIONS, FACTS
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import did_you_mean

PROTOCOL = "protocol-2"
"""The newest version of the benchmark's protocol: what is asked for where no version is named."""

DEFAULT = ("integrity-1", "recorders-1")
"""Rule sets that are for any recording: what is asked for where none is named."""

SHIPPED = (*DEFAULT, "protocol-1", PROTOCOL)
"""Rule sets that come with the package."""

_MAX_BYTES = 1 << 20


class Severity(Enum):
    """What a broken rule means."""

    error = "the command ends with another code than 0"
    warning = "something to know"


class Scope(Enum):
    """What a rule is asked of."""

    file = "each file"
    point = "the runs of one simulator, scene, number of environments, options and level of determinism"
    set = "all files together"


@dataclass(frozen=True)
class Rule:
    """One rule.

    id         unique within its set
    level      error or warning
    of         what it is asked of
    fact       name of the fact
    predicate  name of what is required of it, and `argument`
    when       conditions that a file has to meet for the rule to apply
    scenes     names of the scenes that it applies to; empty: all
    damage     a file that breaks it is damaged or has lost data
    requires   one sentence
    broken     one sentence: what is wrong where the rule is broken; empty: what is found says so by itself
    why        one sentence
    do         what to do where it is broken
    """

    id: str
    level: Severity
    of: Scope
    fact: str
    predicate: str
    argument: Any
    when: tuple[str, ...]
    scenes: tuple[str, ...]
    damage: bool
    requires: str
    broken: str
    why: str
    do: str


@dataclass(frozen=True)
class RuleSet:
    """A versioned set of rules; what a version of a name requires never changes."""

    name: str
    title: str
    rules: tuple[Rule, ...]


def load_rules(name: str) -> RuleSet:
    """A shipped set by name, or one from a file. UsageError where there is none, or where it says what no rule can."""
    if name in SHIPPED:
        return parse_rules(
            (files("gpusimbench.evaluator.check.rules") / f"{name}.toml").read_text(encoding="utf-8"), name
        )
    path = Path(name)
    try:
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
        text = data.decode("utf-8")
    except OSError as error:
        shipped, hint = ", ".join(SHIPPED), did_you_mean(name, SHIPPED)
        raise UsageError(f"'{name}' is no rule set ({shipped}), and no file of rules: {error.strerror}{hint}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path} is not a text file in UTF-8") from None
    if len(data) > _MAX_BYTES:
        raise UsageError(f"{path} is larger than a file of rules can be, {_MAX_BYTES} bytes")
    return parse_rules(text, str(path))


def parse_rules(text: str, source: str) -> RuleSet:
    """Rules from TOML; UsageError names the first thing that is wrong."""
    try:
        record = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UsageError(f"{source} is not TOML: {error}") from None
    try:
        _only(record, {"name", "title", "rules", "extends", "without"}, "the rule set")
        rules = tuple(_rule(one, number) for number, one in enumerate(_list(record, "rules"), start=1))
        if len({rule.id for rule in rules}) < len(rules):
            raise UsageError("two rules have the same id")
        return RuleSet(_text(record, "name"), _text(record, "title"), _extended(record, rules))
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from None


def _extended(record: dict[str, Any], rules: tuple[Rule, ...]) -> tuple[Rule, ...]:
    # the rules of the set that this set extends, each replaced by the rule here that has its id; then those here
    without = [_text({"without": name}, "without") for name in _list(record, "without")]
    if "extends" not in record:
        if without:
            raise UsageError("without is of a rule set that extends another")
        return rules
    base = load_rules(_one_of(record, "extends", SHIPPED)).rules
    if unknown := sorted(set(without) - {rule.id for rule in base}):
        raise UsageError(f"without names {unknown[0]}, which {record['extends']} does not have")
    here = {rule.id: rule for rule in rules}
    kept = tuple(here.pop(rule.id, rule) for rule in base if rule.id not in without)
    return (*kept, *here.values())


_KEYS = {"id", "level", "of", "fact", "must", "when", "scenes", "damage", "requires", "broken", "why", "do"}


def _rule(record: Any, number: int) -> Rule:
    if not isinstance(record, dict):
        raise UsageError(f"rule {number} is not a table")
    try:
        _only(record, _KEYS, "a rule")
        scope = Scope[_one_of(record, "of", [scope.name for scope in Scope], "file")]
        predicates: dict[str, Any] = dict(FILE_PREDICATES if scope is Scope.file else SET_PREDICATES)
        fact = _one_of(record, "fact", FACTS)
        must = record.get("must")
        if not isinstance(must, dict) or len(must) != 1:
            raise UsageError("must has exactly one requirement, such as { at_least = 10 }")
        ((name, argument),) = must.items()
        if name not in predicates:
            raise UsageError(f"'{name}' is nothing that can be required of {scope.value}; {', '.join(predicates)} are")
        if FACTS[fact].type not in predicates[name].types:
            raise UsageError(f"{name} cannot be required of {fact}, which is a {FACTS[fact].type.name}")
        if not predicates[name].accepts(argument):
            raise UsageError(f"{name} does not take {argument!r}")
        return Rule(
            id=_text(record, "id"),
            level=Severity[_one_of(record, "level", [level.name for level in Severity])],
            of=scope,
            fact=fact,
            predicate=name,
            argument=argument,
            when=tuple(_one_of({"when": c}, "when", CONDITIONS) for c in _list(record, "when")),
            scenes=tuple(_text({"scenes": scene}, "scenes") for scene in _list(record, "scenes")),
            damage=_flag(record, "damage"),
            requires=_text(record, "requires"),
            broken=_text(record, "broken") if "broken" in record else "",
            why=_text(record, "why"),
            do=_text(record, "do"),
        )
    except UsageError as error:
        raise UsageError(f"rule {record.get('id', number)}: {error}") from None


def _only(record: dict[str, Any], keys: set[str], what: str) -> None:
    if unknown := sorted(record.keys() - keys):
        raise UsageError(f"{what} has no {unknown[0]}; it has {', '.join(sorted(keys))}")


def _text(record: dict[str, Any], key: str) -> str:
    value = record.get(key)
    if not isinstance(value, str) or not value:
        raise UsageError(f"{key} is a text, not {value!r}")
    return value


def _list(record: dict[str, Any], key: str) -> list[Any]:
    value = record.get(key, [])
    if not isinstance(value, list):
        raise UsageError(f"{key} is a list, not {value!r}")
    return value


def _flag(record: dict[str, Any], key: str) -> bool:
    value = record.get(key, False)
    if not isinstance(value, bool):
        raise UsageError(f"{key} is true or false, not {value!r}")
    return value


def _one_of(record: dict[str, Any], key: str, known: Any, default: str | None = None) -> str:
    value = record.get(key, default)
    if not isinstance(value, str) or value not in known:
        raise UsageError(f"{key} is one of {', '.join(known)}, not {value!r}")
    return value
