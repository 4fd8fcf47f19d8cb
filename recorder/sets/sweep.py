"""A sweep over numbers of environments: which runs are to be made, when it ends, and what came out.

Nothing is read or written here. A sweep is a rule over what is known of its runs so far, wherever that comes from: made
a moment ago or found in a folder. So one that was cut short goes on where it stopped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from gpusimbench.schemas.configuration import MAX_ENVS
from gpusimbench.schemas.errors import UsageError

CERTAIN = ("DEVICE_MEMORY", "HOST_MEMORY", "BUFFER", "REFUSED", "TIMEOUT")
"""Causes that meet every run of the same configuration: one such failure need not be repeated."""

_RANGE = re.compile(r"([0-9]{1,18})\.\.([0-9]{1,18})(?::([0-9]{1,18}))?")


class SweepRun(NamedTuple):
    """A run's place in a sweep."""

    n_env: int
    run_index: int


@dataclass(frozen=True)
class Outcome:
    """How a run of a sweep ended.

    status  complete, failed, invalid or incomplete
    cause   a name of gsb.v1.Cause, or empty
    reason  empty when complete
    """

    status: str
    cause: str = ""
    reason: str = ""

    @property
    def good(self) -> bool:
        """Whether the run is one that counts."""
        return self.status == "complete"


Outcomes = Mapping[SweepRun, Outcome]


def parse_points(text: str) -> tuple[int, ...]:
    """The numbers of environments that "A..B" or "A..B:F" means, ascending: A times powers of F (2), and B.

    UsageError where A, B and F are not powers of two, or not in order.
    """
    match = _RANGE.fullmatch(text)
    if not match:
        raise UsageError(f"--sweep wants A..B or A..B:FACTOR, such as 1..131072 or 1..131072:4, not '{text}'")
    first, last, factor = int(match[1]), int(match[2]), int(match[3] or 2)
    for number in (first, last):
        if not _is_power_of_two(number):
            raise UsageError(f"--sweep goes from a power of two to a power of two; {number} is none")
    if factor < 2 or not _is_power_of_two(factor):
        raise UsageError(f"--sweep multiplies by a power of two from 2 on, not by {factor}")
    if first > last:
        raise UsageError(f"--sweep goes upwards: {first} is more than {last}")
    if last > MAX_ENVS:
        raise UsageError(f"--sweep ends at {MAX_ENVS} at most, not at {last}")
    points = []
    while first < last:
        points.append(first)
        first *= factor
    return (*points, last)


def _is_power_of_two(number: int) -> bool:
    return number > 0 and not number & (number - 1)


@dataclass(frozen=True)
class Sweep:
    """The plan of a sweep.

    points  numbers of environments, ascending
    runs    independent runs at each
    """

    points: tuple[int, ...]
    runs: int

    def __contains__(self, place: SweepRun) -> bool:
        return place.n_env in self.points and place.run_index < self.runs

    def next_places(self, known: Outcomes) -> list[SweepRun]:
        """The runs to be made next, all of one point, in order; empty when the sweep is over."""
        return self.missing(self.reached(known)[-1], known)

    def reached(self, known: Outcomes) -> tuple[int, ...]:
        """The points that the sweep has come to: up to the first with runs to be made, or at which every run fails."""
        for number, n_env in enumerate(self.points, start=1):
            if self.missing(n_env, known) or not self._sustained(n_env, known):
                return self.points[:number]
        return self.points

    def missing(self, n_env: int, known: Outcomes) -> list[SweepRun]:
        """The runs of a point that are to be made still, in order."""
        return [] if self.cut_short(n_env, known) else self._unknown(n_env, known)

    def cut_short(self, n_env: int, known: Outcomes) -> int:
        """How many runs of a point need not be made, since its first showed that they fail as well."""
        first = known.get(SweepRun(n_env, 0))
        if first is None or first.good or first.cause not in CERTAIN or self._sustained(n_env, known):
            return 0
        return len(self._unknown(n_env, known))

    def n_env_max(self, known: Outcomes) -> int | None:
        """The largest number of environments at which a run is complete; None when there is none."""
        return max((n_env for n_env in self.reached(known) if self._sustained(n_env, known)), default=None)

    def stopped(self, known: Outcomes) -> str:
        """Why the sweep went no further, once it is over."""
        last = self.reached(known)[-1]
        if self._sustained(last, known):
            return f"{last} is the end of the sweep"
        return f"failed at {last}: {self.at(last, known)[0].reason}"

    def failed_below_the_last(self, known: Outcomes) -> dict[int, int]:
        """How many runs failed at each point before the last: there, a failure is the limit that a sweep is after."""
        failures = {
            n_env: sum(not outcome.good for outcome in self.at(n_env, known)) for n_env in self.reached(known)[:-1]
        }
        return {n_env: count for n_env, count in failures.items() if count}

    def at(self, n_env: int, known: Outcomes) -> list[Outcome]:
        """What is known of a point, in the order of its runs."""
        places = (SweepRun(n_env, index) for index in range(self.runs))
        return [known[place] for place in places if place in known]

    def _unknown(self, n_env: int, known: Outcomes) -> list[SweepRun]:
        return [place for index in range(self.runs) if (place := SweepRun(n_env, index)) not in known]

    def _sustained(self, n_env: int, known: Outcomes) -> bool:
        return any(outcome.good for outcome in self.at(n_env, known))
