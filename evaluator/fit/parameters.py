"""Options as numbers that an optimiser can move, and back as the text that gsb-record takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.errors import UsageError

WIDEST = 10.0
"""A number is fitted between its start divided by this and its start times this."""

_TYPES = ("float", "str")  # of options that numbers are in; a whole number or a word cannot be moved a little


@dataclass(frozen=True)
class Parameters:
    """Options that are fitted. A point is one number for each number of each option: the logarithm of its factor.

    start  numbers of each option that the search begins with, none of them zero
    """

    start: Mapping[str, tuple[float, ...]]

    @property
    def size(self) -> int:
        """Numbers of a point."""
        return sum(map(len, self.start.values()))

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Of a point."""
        return [(-math.log(WIDEST), math.log(WIDEST))] * self.size

    def options(self, point: Sequence[float] | NDArray[np.float64]) -> dict[str, str]:
        """The options at a point, rounded to five digits: what is recorded is what is printed."""
        left = iter(point)
        return {
            name: " ".join(f"{number * math.exp(next(left)):.5g}" for number in numbers)
            for name, numbers in self.start.items()
        }


def parameters(
    names: Sequence[str], known: Sequence[Mapping[str, object]], given: Mapping[str, str], scene: Mapping[str, float]
) -> Parameters:
    """The options of these names, which begin as given, or else as the simulator or the scene has them.

    known  the simulator's options, as gsb-record --list NAME --json has them
    given  values of options, as text
    scene  what the scene has of its own

    UsageError for an option that is not there, or is not made of numbers that can be fitted.
    """
    options = {str(option["name"]): option for option in known}
    start = {}
    for name in dict.fromkeys(names):
        if name not in options and name not in scene:
            has = (
                *scene,
                *(n for n, option in options.items() if option["type"] in _TYPES and _numbers(option["default"])),
            )
            raise UsageError(f"'{name}' cannot be fitted; the simulator has: {', '.join(has)}{did_you_mean(name, has)}")
        known_value = scene[name] if name in scene else options[name]["default"]
        value = given.get(name, known_value)
        numbers = _numbers(value)
        if not numbers or (name in options and options[name]["type"] not in _TYPES):
            raise UsageError(f"option '{name}' is '{value}', which cannot be fitted: only numbers with fractions can")
        if 0.0 in numbers:
            raise UsageError(
                f"option '{name}' is '{value}', and a zero cannot be fitted, because numbers are moved by factors: "
                f"give another start with --option {name}=VALUE"
            )
        start[name] = numbers
    return Parameters(start)


def _numbers(value: object) -> tuple[float, ...]:
    """The numbers that a value consists of; none where it consists of anything else."""
    try:
        found = tuple(float(word) for word in str(value).split())
    except ValueError:
        return ()
    return found if all(map(math.isfinite, found)) else ()
