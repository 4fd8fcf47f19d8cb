"""What rules can require of facts: a closed vocabulary. A rule file names a predicate and gives its argument; no more.

A predicate of files is asked of one file's value and answers with what was found where it does not hold. A predicate of
sets is asked of the values of several files and answers with the files that break it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gpusimbench.evaluator.check.rules.fact import FactType, Unknown
from gpusimbench.evaluator.check.rules.facts import FACTS
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import cut, few, first, plural

_SHOWN = 3
_NAMED = 6


@dataclass(frozen=True)
class FilePredicate:
    """A requirement of one file's fact.

    meaning   one sentence; {} stands for the argument
    types     of facts that it can be asked of
    accepts   whether the argument is one that it takes
    found     what breaks it, one sentence each, from value, argument and a way to other facts; empty where it holds
    """

    meaning: str
    types: tuple[FactType, ...]
    accepts: Callable[[Any], bool]
    found: Callable[[Any, Any, Callable[[str], Any]], tuple[str, ...]]


@dataclass(frozen=True)
class SetPredicate:
    """A requirement of a fact over several files; `found` gives sentences with the files that each is of."""

    meaning: str
    types: tuple[FactType, ...]
    accepts: Callable[[Any], bool]
    found: Callable[[Mapping[str, Any], Any, Callable[[str, str], Any]], tuple[tuple[str, tuple[str, ...]], ...]]


def _number(argument: Any) -> bool:
    return type(argument) in (int, float) and math.isfinite(argument)


def _true(argument: Any) -> bool:
    return argument is True


def _scalar(argument: Any) -> bool:
    return isinstance(argument, (str, bool)) or _number(argument)


def _scalars(argument: Any) -> bool:
    return isinstance(argument, list) and bool(argument) and all(map(_scalar, argument))


def _texts(argument: Any) -> bool:
    return isinstance(argument, list) and bool(argument) and all(isinstance(item, str) for item in argument)


def _fact(argument: Any) -> bool:
    return isinstance(argument, str) and argument in FACTS


def show(value: Any) -> str:
    """A value as a finding shows it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.9g}"
    return cut(str(value) if value != "" else "nothing", 80)


def _missing(value: tuple[str, ...], wanted: list[str]) -> str:
    return ", ".join(name for name in wanted if name not in value)


def _it_is(value: Any) -> str:
    return f"found {show(value)}"


def _unless(holds: bool, found: str) -> tuple[str, ...]:
    return () if holds else (found,)


_SCALARS = (FactType.flag, FactType.number, FactType.text)

FILE_PREDICATES: dict[str, FilePredicate] = {
    "empty": FilePredicate("there is none", (FactType.list,), _true, lambda value, _, __: tuple(value)),
    "present": FilePredicate(
        "it is recorded", (FactType.text, FactType.list, FactType.object), _true,
        lambda value, _, __: _unless(bool(value), "nothing is recorded"),
    ),
    "equals": FilePredicate(
        "it is {}", _SCALARS, _scalar, lambda value, wanted, _: _unless(value == wanted, _it_is(value))
    ),
    "one_of": FilePredicate(
        "it is one of {}", _SCALARS, _scalars, lambda value, wanted, _: _unless(value in wanted, _it_is(value))
    ),
    "at_least": FilePredicate(
        "it is at least {}", (FactType.number,), _number,
        lambda value, least, _: _unless(value >= least, _it_is(value)),
    ),
    "at_most": FilePredicate(
        "it is at most {}", (FactType.number,), _number,
        lambda value, most, _: _unless(value <= most, _it_is(value)),
    ),
    "power_of_two": FilePredicate(
        "it is a power of two", (FactType.number,), _true,
        lambda value, _, __: _unless(value == int(value) and int(value).bit_count() == 1, _it_is(value)),
    ),
    "has": FilePredicate(
        "it has {}", (FactType.list,), _texts,
        lambda value, wanted, _: _unless(not (missing := _missing(value, wanted)), f"missing: {missing}"),
    ),
    "same_as": FilePredicate(
        "it is the same as {}", _SCALARS, _fact,
        lambda value, name, other: _unless(value == other(name), f"found {show(value)}, not {show(other(name))}"),
    ),
}  # fmt: skip
"""Predicates of rules that apply to a file."""


def _all_same(values: Mapping[str, Any], _: Any, __: Any) -> tuple[tuple[str, tuple[str, ...]], ...]:
    if all(isinstance(value, dict) for value in values.values()):
        names = dict.fromkeys(name for value in values.values() for name in value)
        by_name = [
            _different({file: value.get(name, "unset") for file, value in values.items()}, f"{name} is ")
            for name in names
        ]
        findings = [finding for one in by_name for finding in one]
        if not findings:
            return ()
        told = "; ".join(first([found for found, _ in findings], _NAMED, " differ"))
        return ((told, tuple(dict.fromkeys(file for _, odd in findings for file in odd))),)
    return _different(values, "found ")


def _different(values: Mapping[str, Any], what: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    files = gathered((repr(value), file) for file, value in values.items())
    if len(files) < 2:
        return ()
    usual = max(files, key=lambda key: len(files[key]))
    shown = [f"{show(values[found[0]])} in {plural(len(found), 'file')}" for found in files.values()]
    odd = tuple(file for key, found in files.items() if key != usual for file in found)
    return ((f"{what}{few(shown, _SHOWN, ' values')}", odd),)


def _all_distinct(values: Mapping[str, Any], _: Any, __: Any) -> tuple[tuple[str, tuple[str, ...]], ...]:
    files = gathered((repr(value), file) for file, value in values.items())
    return tuple(
        (f"{len(found)} files have {show(values[found[0]])}", tuple(found))
        for found in files.values()
        if len(found) > 1
    )


def _true_in(values: Mapping[str, Any], least: int, _: Any) -> tuple[tuple[str, tuple[str, ...]], ...]:
    count = sum(bool(value) for value in values.values())
    said = f"{count} of {plural(len(values), 'file')} counted, {least} are needed"
    return () if count >= least else ((said, tuple(values)),)


def _by_key(
    values: Mapping[str, Any], name: str, other: Callable[[str, str], Any]
) -> Iterator[tuple[Any, dict[str, Any]]]:
    # the values of files that have the same value of another fact, with that value
    by_key: dict[str, dict[str, Any]] = {}
    keys: dict[str, Any] = {}
    for file, value in values.items():
        if not isinstance(key := other(file, name), Unknown):
            by_key.setdefault(repr(key), {})[file] = value
            keys[repr(key)] = key
    return ((keys[key], found) for key, found in by_key.items())


def _determined_by(
    values: Mapping[str, Any], name: str, other: Callable[[str, str], Any]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple(
        (f"{len(found)} files with one {name} have different ones", tuple(found))
        for _, found in _by_key(values, name, other)
        if len({repr(value) for value in found.values()}) > 1
    )


def _same_for_each(
    values: Mapping[str, Any], name: str, other: Callable[[str, str], Any]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple(
        finding
        for key, found in _by_key(values, name, other)
        for finding in _different(found, f"of {name} {show(key)}: ")
    )


_ANY = tuple(FactType)

SET_PREDICATES: dict[str, SetPredicate] = {
    "all_same": SetPredicate("it is the same in all files", _ANY, _true, _all_same),
    "all_distinct": SetPredicate("no two files have the same", _SCALARS, _true, _all_distinct),
    "true_in": SetPredicate("so in at least {} files", (FactType.flag,), lambda a: type(a) is int and a >= 1, _true_in),
    "determined_by": SetPredicate("files with the same {} have the same", _SCALARS, _fact, _determined_by),
    "same_for_each": SetPredicate(
        "files with the same {} have the same; those that stand out break it", _SCALARS, _fact, _same_for_each
    ),
}
"""Predicates of rules that apply to several files."""
