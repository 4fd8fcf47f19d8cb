"""How much moves: counted by the recorder itself, of the states that an engine returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import Counter

SLOWEST = 0.01
"""Speed from which a joint or a body moves [m/s, rad/s]. Of a Panda that follows random targets on MuJoCo C, 7.0 of 7
joints are faster, on average over 64 environments; of one that holds its first target, 0.1 after 11 s."""

MOVING = Counter(
    "moving", f"joints and bodies that move faster than {SLOWEST:g} m/s or {SLOWEST:g} rad/s, counted by gsb-record"
)

_VELOCITIES = ("qvel", "linear_velocity", "angular_velocity")


def moving(fields: Sequence[StateField], state: States) -> NDArray[np.int64] | None:
    """Joints and bodies of each environment of which any velocity is above SLOWEST, [env]; None without velocities.

    state  one array [env, item, width] per field; a speed that is not finite counts as moving
    """
    fast: dict[str, NDArray[np.bool_]] = {}
    for field, array in zip(fields, state, strict=True):
        if field.field in _VELOCITIES:
            found = ~(np.linalg.norm(array.astype(np.float64), axis=2) <= SLOWEST)
            fast[field.group] = fast[field.group] | found if field.group in fast else found
    if not fast:
        return None
    return np.asarray(np.sum([of.sum(axis=1) for of in fast.values()], axis=0, dtype=np.int64))


def with_motion(evidence: Evidence | None, fields: Sequence[StateField], state: States) -> Evidence | None:
    """What an engine counted of its last step, with what moves in the state after it."""
    count = moving(fields, state)
    if count is None:
        return evidence
    evidence = evidence or Evidence()
    return replace(evidence, counts={**evidence.counts, MOVING.name: count[None]})
