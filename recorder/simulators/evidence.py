"""What shows that steps did the work that they are timed for: contacts, rows, iterations, and what was dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.provenance import MISPLACED_CONTACTS as MISPLACED
from gpusimbench.schemas.provenance import Counter


@dataclass(frozen=True)
class Evidence:
    """Counts of some steps; a row is a step.

    counts    by the name of a Counter of the Description: shape [row, env]
    overflow  bitmasks, shape [row, env], as the Description's overflow_bits say; None where the engine has none
    """

    counts: dict[str, NDArray[np.integer]] = field(default_factory=dict)
    overflow: NDArray[np.uint32] | None = None

    def copy(self) -> Evidence:
        """The same in memory of its own: an engine may use what it gave again."""
        counts = {name: np.array(rows) for name, rows in self.counts.items()}
        return Evidence(counts, None if self.overflow is None else np.array(self.overflow))


def joined(parts: Sequence[Evidence]) -> Evidence | None:
    """Of steps that follow each other; None where there is none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    counts = {name: np.concatenate([part.counts[name] for part in parts]) for name in parts[0].counts}
    overflow = [part.overflow for part in parts if part.overflow is not None]
    return Evidence(counts, np.concatenate(overflow) if overflow else None)


CONTACTS = Counter("contacts", "contact points that the engine kept")
CONSTRAINT_ROWS = Counter("constraint_rows", "scalar constraints handed to the solver")
SOLVER_ITERATIONS = Counter("solver_iterations", "iterations that the constraint solver made")
AWAKE_BODIES = Counter("awake_bodies", "bodies that were simulated, not put to sleep")
CANDIDATE_PAIRS = Counter(
    "candidate_pairs", "pairs of shapes whose bounding spheres overlap, in the fullest collision function"
)
MISPLACED_CONTACTS = Counter(
    MISPLACED,
    "contacts outside of one of their two shapes: farther from its centre than twice its bounding radius plus the "
    "contact's own distance",
)
