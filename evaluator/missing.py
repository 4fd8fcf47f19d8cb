"""A value, or the reason why there is none: the one type for that through the evaluator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

_T = TypeVar("_T")


@dataclass(frozen=True)
class Missing:
    """Stands where a value would, and says why it is not there.

    reason  a clause that a reader sees instead of the value, such as "no step was timed"
    """

    reason: str


def known(value: _T | Missing) -> _T | None:
    """The value; None where it is missing."""
    return None if isinstance(value, Missing) else value


def reason_of(value: object) -> str:
    """Why a value is missing; empty where it is there."""
    return value.reason if isinstance(value, Missing) else ""
