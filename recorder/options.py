"""Options of a simulator: text from the command line to a frozen dataclass."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any, get_type_hints

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import did_you_mean

_BOOLEANS = {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}


def split_options(pairs: Iterable[str]) -> dict[str, str]:
    """["name=value", ...] as a dictionary; UsageError for another form and for a name that is given twice."""
    options: dict[str, str] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise UsageError(f"--option wants NAME=VALUE, not '{pair}'")
        name = name.strip().replace("-", "_")
        if name in options:
            raise UsageError(f"--option {name} is given twice: {options[name]} and {value.strip()}")
        options[name] = value.strip()
    return options


def parse_options(simulator: str, kind: type, given: Mapping[str, str]) -> Any:
    """An instance of the dataclass `kind`; UsageError names the option that is unknown or has no such value."""
    hints = get_type_hints(kind)
    known = {f.name: hints[f.name] for f in fields(kind)}
    values: dict[str, Any] = {}
    for name, text in given.items():
        if name not in known:
            has = f"{', '.join(known) or 'none'}{did_you_mean(name, known)}"
            raise UsageError(f"simulator '{simulator}' has no option '{name}'; it has: {has}")
        try:
            values[name] = _BOOLEANS[text.lower()] if known[name] is bool else known[name](text)
        except (ValueError, KeyError):
            raise UsageError(
                f"option '{name}' of simulator '{simulator}' is a {known[name].__name__}, not '{text}'"
            ) from None
    try:
        return kind(**values)
    except ValueError as error:
        raise UsageError(f"simulator '{simulator}': {error}") from None


def names_of(kind: type) -> tuple[str, ...]:
    """Names of the options of a dataclass."""
    return tuple(field.name for field in fields(kind))


def one_of(name: str, value: Any, allowed: tuple[Any, ...]) -> None:
    """ValueError where an option has none of the values that it may have."""
    if value not in allowed:
        known = list(map(str, allowed))
        raise ValueError(f"{name} is one of {', '.join(known)}, not '{value}'{did_you_mean(str(value), known)}")


Rule = tuple[Callable[[Any], bool], str]
"""Whether a value may be an option's, and what it has to be, in words."""

AT_LEAST_1: Rule = (lambda value: value >= 1, "at least 1")
FROM_0: Rule = (lambda value: 0 <= value < math.inf, "a number from 0 on")
ABOVE_0: Rule = (lambda value: 0 < value < math.inf, "a number above 0")
NOT_NEGATIVE: Rule = (lambda value: value >= 0, "0 or a positive number")
MEASURED: Rule = (lambda value: value >= 0, "0 (measured) or a positive number")


def require(options: Any, rule: Rule, *names: str) -> None:
    """ValueError for the first of these options whose value is against the rule."""
    holds, said = rule
    for name in names:
        if not holds(value := getattr(options, name)):
            raise ValueError(f"{name} is {said}, not {value}")


def meanings(kind: type) -> dict[str, str]:
    """What each option of a dataclass means, from the tables in its docstring and those of its bases.

    A row is a name, or several with commas between, two blanks, and the meaning, which may go on in lines below. A name
    that ends in "..." stands for all options that begin so.
    """
    names = [field.name for field in fields(kind)]
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        text = inspect.cleandoc(base.__dict__.get("__doc__") or "")
        for row in re.finditer(r"^(\w+(?:\.\.\.)?(?:, \w+)*) {2,}(\S.*(?:\n {2,}\S.*)*)", text, re.MULTILINE):
            meaning = " ".join(row[2].split())
            for name in row[1].split(", "):
                stem = name.removesuffix("...")
                found.update((n, meaning) for n in names if n == name or (stem != name and n.startswith(stem)))
    return found
