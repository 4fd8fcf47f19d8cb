"""Split tree: which samples left which others, and when, as classes of equal histories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.identity import DistinctOverTime

MAX_BRANCHES = 64
"""Branches that are kept; of more, those that left first."""

MAX_MEMBERS = 16
"""Members of a branch that are named."""


@dataclass(frozen=True)
class Branch:
    """A class of samples with one history, from the step at which it left the branch that it was part of.

    Where a class falls apart, the part with its lowest sample goes on as the same branch, and every other part is a
    branch of its own.

    sample   lowest of its samples, which names it
    parent   place in the tree of the branch that it left; None for the first
    step     first step at which it differs from its parent; the first step that was recorded, for the first
    left     samples that left together
    stayed   samples that are still in it at the end: what is left of it by later splits
    members  the lowest of those that stayed, at most MAX_MEMBERS
    """

    sample: int
    parent: int | None
    step: int
    left: int
    stayed: int
    members: tuple[int, ...]


@dataclass(frozen=True)
class SplitTree:
    """All branches in order of step, then sample.

    branches    the first of them is the one with sample 0
    not_kept    branches that left after those that are kept
    first_step  first recorded step
    last_step   last recorded step
    """

    branches: tuple[Branch, ...]
    not_kept: int
    first_step: int
    last_step: int


def split_tree(steps: npt.NDArray[np.int64], counted: DistinctOverTime) -> SplitTree:
    """The tree of some counted samples.

    Args:
        steps: of the rows that were counted, shape [row].
    """
    first, last = (int(steps[0]), int(steps[-1])) if len(steps) else (0, 0)
    kept = counted.departures[: MAX_BRANCHES - 1]
    # of a kept branch, a parent left before it, so it is kept as well
    place = {0: 0, **{int(sample): at for at, (_, sample, _, _) in enumerate(kept, start=1)}}
    root = _branch(counted, 0, None, first, len(counted.classes))
    others = [
        _branch(counted, int(sample), place[int(parent)], int(steps[row]), int(left))
        for row, sample, parent, left in kept
    ]
    return SplitTree((root, *others), len(counted.departures) - len(kept), first, last)


def _branch(counted: DistinctOverTime, sample: int, parent: int | None, step: int, left: int) -> Branch:
    alike = np.flatnonzero(counted.classes == counted.classes[sample])
    return Branch(sample, parent, step, left, len(alike), tuple(alike[:MAX_MEMBERS].tolist()))
