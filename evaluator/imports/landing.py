"""How a model comes to the ground on an engine, beside how it does on MuJoCo C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.imported import Drop

WINDOW_S = 0.1
"""Over which the force is averaged, at the end of the drop [s]."""


@dataclass(frozen=True)
class Landing:
    """What came of a drop.

    time     of the first recorded step at which a shape reaches into one that does not move [s]; Missing without any
    height   of the centre of mass then [m]
    carried  share of the weight that the ground carries, on average over the last WINDOW_S of the drop
    """

    time: float | Missing
    height: float | Missing
    carried: float | Missing


@dataclass(frozen=True)
class Landings:
    """Of MuJoCo C and of an engine, from the same state, both without controls and for the same time.

    duration  of the drop [s]
    """

    duration: float
    reference: Landing
    engine: Landing


def landings(reference: Drop, engine: Drop) -> Landings | Missing:
    """Both landings; Missing where the drops have other times."""
    if len(reference.time) != len(engine.time) or not np.allclose(reference.time, engine.time):
        return Missing("the drops have other time steps")
    return Landings(float(reference.time[-1]), _landing(reference), _landing(engine))


def _landing(drop: Drop) -> Landing:
    # the momentum changes by what carries the model, less its weight
    last = len(drop.time) - 1
    first = int(np.searchsorted(drop.time, drop.time[-1] - WINDOW_S - 1e-9))
    gained = (drop.momentum[last] - drop.momentum[first]) / (drop.time[last] - drop.time[first])
    share = float(1 + gained / drop.weight)
    carried = share if np.isfinite(share) else Missing("states are not finite")
    touching = np.flatnonzero(drop.contact)
    if not touching.size:
        none = Missing("nothing touches the ground")
        return Landing(none, none, carried)
    return Landing(float(drop.time[touching[0]]), float(drop.height[touching[0]]), carried)
