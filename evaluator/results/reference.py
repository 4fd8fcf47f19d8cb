"""The positions that simulations are compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import Density
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses
from gpusimbench.schemas.location import Place


@dataclass(frozen=True)
class Reference:
    """The positions that simulations are compared with.

    label      what they are
    path       of the recording
    run_id     of the recording
    measured   True for real trials, False for another simulation
    scene      that they belong to
    positions  [m], shape [trial, item, 2]
    density    on the shared grid
    tosses     measured motions of a thrown cube; None where it has none
    """

    label: str
    path: Place
    run_id: str
    measured: bool
    scene: str
    positions: NDArray[np.float64]
    density: Density | None = None
    tosses: MeasuredTosses | None = None
