"""How many cubes of a run went through the floor or the board, from its states alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusimbench.evaluator.metrics.lost_cubes import Sinking, may_have_sunk
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import radius_of, supports_of
from gpusimbench.evaluator.runs.outcome import OutcomeArray, outcome_of
from gpusimbench.evaluator.runs.positions import in_env_frame, no_states

_ROW_BYTES = 16 << 20  # of positions read at a time


@dataclass(frozen=True)
class Sunk:
    """Cubes that went through what should have held them up, by the last captured step.

    per_env     cubes in each environment
    cubes       that an environment has
    last_step   that they were followed to
    first_step  at which the first was through; None where none was
    """

    per_env: tuple[int, ...]
    cubes: int
    last_step: int
    first_step: int | None


def count_sunk(recording: Recording) -> Sunk | Missing:
    """Count the sunk cubes of each environment; Missing says why they cannot be counted."""
    fields = outcome_of(recording)
    if isinstance(fields, Missing):
        return fields
    if "size" in recording.configuration.varied:
        return Missing("sizes of bodies differ from environment to environment (--vary)")
    array = OutcomeArray(recording, fields)
    if len(array) < 2:
        return no_states(recording)
    supports = supports_of(recording)
    if not supports:
        return Missing("scene.json describes no level surface (a fixed plane or box) that bodies could go through")
    last = in_env_frame(recording, array.field, array.at_step(int(array.steps[-1])))
    if last.shape[-1] < 3:
        return Missing("heights were not recorded")
    n_env, cubes = last.shape[:2]
    last_step = int(array.steps[-1])
    radius = max(radius_of(recording, field.group) for field in fields)
    if not may_have_sunk(last, supports, radius):
        return Sunk((0,) * n_env, cubes, last_step, None)
    following = Sinking(in_env_frame(recording, array.field, array.at_step(int(array.steps[0]))), supports, radius)
    count = max(1, _ROW_BYTES // last.nbytes)
    for begin in range(1, len(array), count):
        for row in array.read(slice(begin, begin + count)):
            following.feed(in_env_frame(recording, array.field, row))
    found = following.sank
    first = int(array.steps[following.since[found].min()]) if found.any() else None
    return Sunk(tuple(np.count_nonzero(found, axis=1).tolist()), cubes, last_step, first)
