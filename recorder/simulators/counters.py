"""What adapters count, under names that all of them share."""

from __future__ import annotations

from gpusimbench.schemas.provenance import Counter

CONTACTS = Counter("contacts", "contact points that the engine kept")
CONSTRAINT_ROWS = Counter("constraint_rows", "scalar constraints handed to the solver")
SOLVER_ITERATIONS = Counter("solver_iterations", "iterations that the constraint solver made")
AWAKE_BODIES = Counter("awake_bodies", "bodies that were simulated, not put to sleep")
CANDIDATE_PAIRS = Counter(
    "candidate_pairs", "pairs of shapes whose bounding spheres overlap, in the fullest collision function"
)
