"""Options of a simulator: text from the command line to a frozen dataclass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, get_type_hints

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.suggestion import did_you_mean

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
