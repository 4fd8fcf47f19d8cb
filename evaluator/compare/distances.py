"""Distances between all runs of both sides: what two questions about where bodies and joints end are asked of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.variability import run_to_run_variability
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.joint_metrics import joint_spaces, run_distances
from gpusimbench.evaluator.results.sampled import positions
from gpusimbench.evaluator.runs.outcome import positional


@dataclass(frozen=True)
class Distances:
    """Distances between runs, those of base first.

    matrix     shape [run, run]
    unit       of it: "cm" or "rad"
    n          runs of base and of head
    exact      whether they are no upper bounds
    alike      of each side, whether all its runs are bit-identical at the sample step
    same       whether base's first run is head's first, bit by bit
    """

    matrix: NDArray[np.float64]
    unit: str
    n: tuple[int, int]
    exact: bool
    alike: tuple[bool, bool]
    same: bool

    @property
    def head(self) -> list[bool]:
        """Whether each run is of head."""
        return [False] * self.n[0] + [True] * self.n[1]

    def within(self) -> tuple[float | None, float | None]:
        """Mean distance between runs of base, and between runs of head; None of a single run."""
        of_base, of_head = slice(0, self.n[0]), slice(self.n[0], None)
        return _mean(self.matrix[of_base, of_base]), _mean(self.matrix[of_head, of_head])


def distances(base: Runs, head: Runs, work: Work) -> Distances | Missing | None:
    """W1 between runs [cm]; None where no states were captured."""
    one, why = positions(base)
    other, why_head = positions(head)
    if one is None or other is None:
        captured = any("capture" in r.configuration.phases for r in (*base, *head))
        return Missing(why or why_head) if captured else None
    if one.shape[1:] != other.shape[1:]:
        return Missing("the runs have different numbers of environments or bodies")
    try:
        found = run_to_run_variability(np.concatenate([one, other]), work.map)
    except ValueError as error:
        return Missing(str(error))
    if found.matrix_cm is None:
        return Missing("too many large runs to compute all distances")
    alike = [len({run.tobytes() for run in side}) == 1 for side in (one, other)]
    return Distances(
        found.matrix_cm,
        "cm",
        (len(one), len(other)),
        found.exactness == "exact",
        (alike[0], alike[1]),
        one[0].tobytes() == other[0].tobytes(),
    )


def joint_distances(base: Runs, head: Runs, unit: str) -> Distances | Missing | None:
    """Distances in joint space between runs; None where neither side recorded joints of the unit.

    unit  "rad" for joints that turn, "cm" for joints that slide
    """
    spaces = [joint_spaces(runs, unit) for runs in (base, head)]
    if all(isinstance(side, Missing) for side in spaces):
        return None
    both = joint_spaces((*base, *head), unit)
    if why_not := next((side for side in (*spaces, both) if isinstance(side, Missing)), None):
        return why_not
    assert not isinstance(both, Missing)
    bits = [(s.coordinates.tobytes(), s.balls.tobytes()) for s in both]
    sides = bits[: len(base)], bits[len(base) :]
    return Distances(
        run_distances(both, unit),
        unit,
        (len(base), len(head)),
        True,
        (len(set(sides[0])) == 1, len(set(sides[1])) == 1),
        sides[0][0] == sides[1][0],
    )


def has_positions(base: Runs, head: Runs) -> bool:
    """Whether there is anything to decide: a run that recorded positions of bodies, or a side without a run."""
    return any(positional(run.fields) for run in (*base, *head)) or not (base and head)


def _mean(matrix: NDArray[np.float64]) -> float | None:
    runs = len(matrix)
    return float(matrix.sum()) / (runs * (runs - 1)) if runs > 1 else None
