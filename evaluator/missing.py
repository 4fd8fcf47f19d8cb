"""A value, or the reason why there is none: the one type for that through the evaluator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeVar

_T = TypeVar("_T")


@dataclass(frozen=True)
class Missing:
    """Stands where a value would, and says why it is not there. It is false, as None is.

    reason  a clause that a reader sees instead of the value, such as "no step was timed"
    """

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def known(value: _T | Missing) -> _T | None:
    """The value; None where it is missing."""
    return None if isinstance(value, Missing) else value


def why_missing(value: object) -> str:
    """The reason why a value is not there; empty where it is."""
    return value.reason if isinstance(value, Missing) else ""
