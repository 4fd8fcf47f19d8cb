"""A value, or the reason why there is none; and claims that are true, false or were not compared, with the reason."""

from __future__ import annotations

from collections.abc import Iterable
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


@dataclass(frozen=True)
class Claim:
    """Whether something holds.

    holds    None where it was not compared, and `why_not` says why
    """

    holds: bool | None
    why_not: str = ""

    @property
    def yes(self) -> bool:
        """Whether it was compared and holds: the one that a sentence may be made of."""
        return self.holds is True


def every(parts: Iterable[Claim | bool | None], why_not: str = "nothing was compared") -> Claim:
    """Whether all parts hold: no where one does not, and not compared where one was not, or where there are none."""
    found = [part if isinstance(part, Claim) else Claim(part, "" if part is not None else why_not) for part in parts]
    if any(part.holds is False for part in found):
        return Claim(False)
    if reasons := [part.why_not or why_not for part in found if part.holds is None]:
        return Claim(None, "; ".join(dict.fromkeys(reasons)))
    return Claim(True) if found else Claim(None, why_not)
