"""The search by halves for the first release that differs, among releases of which some may not be judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """Between which releases the change lies, as indices.

    same       the last that is known to be like the first of all
    different  the first that is known to differ; None: the last of all does not
    skipped    releases between them that could not be judged
    """

    same: int
    different: int | None
    skipped: tuple[int, ...] = ()


def most(count: int) -> int:
    """How many of so many releases are recorded at most, where all can be judged: ceil(log2(count)) + 2."""
    return (count - 1).bit_length() + 2


def search(count: int, judge: Callable[[int], bool | None]) -> Bounds:
    """Find two neighbours of which the one is like release 0 and the other is not.

    count  of releases, at least 2
    judge  whether a release differs from release 0; None where that cannot be told. It is asked of the last release
           first, never of release 0, and never twice

    Where releases change back and forth, this is one of the changes. Where the last release cannot be judged, it is
    among the skipped, and nothing is known to differ.
    """
    last = count - 1
    verdict = judge(last)
    if not verdict:
        return Bounds(last, None) if verdict is False else Bounds(0, None, (last,))
    low, high = 0, last
    skipped: set[int] = set()
    while left := [i for i in range(low + 1, high) if i not in skipped]:
        middle = min(left, key=lambda i: abs(2 * i - low - high))
        verdict = judge(middle)
        if verdict is None:
            skipped.add(middle)
        elif verdict:
            high = middle
        else:
            low = middle
    return Bounds(low, high, tuple(i for i in sorted(skipped) if low < i < high))
