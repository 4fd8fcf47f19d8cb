"""The search for the options with the smallest error, within a number of evaluations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.fit.parameters import Parameters
from gpusimbench.evaluator.missing import Missing

METHOD = "COBYQA of SciPy (Ragonneau 2022), on the logarithms of the numbers"
"""What searches: trust regions with quadratic models, which need no gradient; few evaluations are enough for a few
numbers, and a rugged error is smoothed by the width of the region."""

_FIRST_RADIUS, _LAST_RADIUS = 0.5, 0.005  # of the region, in logarithms: a factor of 1.6, and of 0.5 %
_FAILED = 10.0  # error of options that cannot be recorded, in errors of the start


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
