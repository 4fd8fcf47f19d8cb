"""The search for the options with the smallest error: options as numbers, within a number of evaluations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import did_you_mean

WIDEST = 10.0
"""A number is fitted between its start divided by this and its start times this."""

_TYPES = ("float", "str")  # of options that numbers are in; a whole number or a word cannot be moved a little

METHOD = "COBYQA of SciPy (Ragonneau 2022), on the logarithms of the numbers"
"""What searches: trust regions with quadratic models, which need no gradient; few evaluations are enough for a few
numbers, and a rugged error is smoothed by the width of the region."""

_FIRST_RADIUS, _LAST_RADIUS = 0.5, 0.005  # of the region, in logarithms: a factor of 1.6, and of 0.5 %
_FAILED = 10.0  # error of options that cannot be recorded, in errors of the start


@dataclass(frozen=True)
class Parameters:
    """Options that are fitted. A point is one number for each number of each option: the logarithm of its factor.

    start  numbers of each option that the search begins with, none of them zero
    """

    start: Mapping[str, tuple[float, ...]]

    @property
    def size(self) -> int:
        """How many numbers a point has."""
        return sum(map(len, self.start.values()))

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """The least and the largest value of each number of a point."""
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


@dataclass(frozen=True)
class Evaluation:
    """An evaluation: the options, and the error [cm] or why there is none."""

    options: Mapping[str, str]
    error: float | Missing


def search(
    parameters: Parameters, evaluate: Callable[[Mapping[str, str]], float | Missing], budget: int
) -> tuple[Evaluation, ...]:
    """All evaluations, in order; the first is of the start. Options that come again are not evaluated again.

    evaluate  gives the error of options
    budget    evaluations at most

    The search ends early where the start has no error to improve.
    """
    from scipy.optimize import minimize

    made: dict[tuple[str, ...], Evaluation] = {}

    def error(point: NDArray[np.float64]) -> float:
        options = parameters.options(point)
        key = tuple(options.values())
        if key not in made:
            if len(made) >= budget:
                raise StopIteration
            made[key] = Evaluation(options, evaluate(options))
        found, first = made[key].error, next(iter(made.values())).error
        return _FAILED * (1.0 if isinstance(first, Missing) else first) if isinstance(found, Missing) else found

    start = np.zeros(parameters.size)
    try:
        error(start)
        if isinstance(next(iter(made.values())).error, Missing):
            return tuple(made.values())
        minimize(
            error,
            start,
            method="COBYQA",
            bounds=parameters.bounds,
            options={
                "maxfev": 10 * budget + 100,  # points that come again cost nothing
                "initial_tr_radius": _FIRST_RADIUS,
                "final_tr_radius": _LAST_RADIUS,
            },
        )
    except StopIteration:
        pass
    return tuple(made.values())


def best_of(evaluations: tuple[Evaluation, ...]) -> Evaluation | None:
    """The evaluation with the smallest error, the first of equals; None where no options have one."""
    whole = [one for one in evaluations if not isinstance(one.error, Missing)]
    return min(whole, key=lambda one: one.error if not isinstance(one.error, Missing) else np.inf, default=None)
