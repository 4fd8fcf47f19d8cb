"""What was found for one group, before any presentation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import Density, HexGrid
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.canonical import Law, Unmeasured
from gpusimbench.evaluator.results.fidelity import Fidelity
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.timed_work import TimedWork
from gpusimbench.evaluator.results.validity import Validity
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.spread import Spread


@dataclass(frozen=True)
class Cloud:
    """Planar positions of the items of a group at the sample step, in the env's own frame.

    positions  [m], shape [run, env, item, 2]
    density    over all runs and environments, on the grid shared by all clouds of a scene
    marginals  counts along x and y on shared edges
    """

    positions: NDArray[np.float64]
    density: Density
    marginals: tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class RunSpread:
    """How the environments of one run moved apart.

    run      its index
    spread   distances between them
    """

    run: int
    spread: Spread | Missing


@dataclass(frozen=True)
class GroupResult:
    """All that was found for one group.

    group            the recordings and what they share
    label            unique within the evaluation
    metrics          estimates, by the name of their metric
    cloud            None where no states were recorded at the sample step
    validity         contacts, buffers, overflow, actions
    fidelity         whether the states keep to mechanics
    laws             of motions that are known in closed form, or why they could not be measured
    notes            sentences that a reader must see beside the numbers
    doubts           those of the notes that speak against the numbers of this group even among many groups: growth with
                     the steps, known errors of its recorder
    footnotes        on its label: protocol and environment variables that differ from the others of its scene
    spreads          of the complete runs
    timed            what its throughput was measured over
    """

    group: Group[Run]
    label: str
    metrics: dict[str, Estimate]
    cloud: Cloud | None
    validity: Validity
    fidelity: Fidelity
    notes: tuple[str, ...]
    spreads: tuple[RunSpread, ...] = ()
    timed: TimedWork = TimedWork()
    footnotes: tuple[str, ...] = ()
    laws: tuple[Law | Unmeasured, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Map:
    """What all density maps of one scene share.

    grid       of hexagonal bins
    edges      of the marginals' bins along x and y [m]
    max_count  largest count of any bin: the upper end of the colour scale
    """

    grid: HexGrid
    edges: tuple[NDArray[np.float64], NDArray[np.float64]]
    max_count: int
