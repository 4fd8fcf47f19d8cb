"""A value, or the reason why there is none: the one type for that through the evaluator."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Missing:
    """Stands where a value would, and says why it is not there.

    reason  a clause that a reader sees instead of the value, such as "no step was timed"
    """

    reason: str
