"""Claims that can be true, false or not compared: what was never looked at is neither yes nor no."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


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
