"""What an evaluation finds: values with their meaning, before any presentation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.check.protocol import Unmet
from gpusimbench.evaluator.metrics.density import Density, HexGrid
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.fidelity import Fidelity
from gpusimbench.evaluator.results.timed_work import TimedWork
from gpusimbench.evaluator.results.validity import Validity
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.reader import Unreadable
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.spread import Spread
from gpusimbench.schemas.location import Place

if TYPE_CHECKING:
    from gpusimbench.evaluator.results.accumulation import Accumulation
    from gpusimbench.evaluator.results.determinism_cost import Family
    from gpusimbench.evaluator.results.ranking import Comparison
    from gpusimbench.evaluator.results.sweeps import Sweep

SCHEMA_VERSION = 1
"""Version of the JSON that ``gsb-eval --json`` prints."""


@dataclass(frozen=True)
class Metric:
    """One value of one group.

    name       as in the JSON
    value      None where it cannot be computed; `why_not` says why
    unit       SI or as the published definition has it; empty for counts and classes
    direction  "higher" or "lower" where that is better, "neither" where it is no merit
    method     how it was computed, in words
    exactness  "exact", "certified" (bounds in `extra`), "sampled" (seed in `extra`) or "none" without a value
    n          how many observations the value is a mean of, or counts
    sd         standard deviation over those, as published
    ci95       95 % interval
    why_not    why there is no value
    extra      figures that belong to the value: checkpoints, floors, per-run values
    """

    name: str
    value: float | None
    unit: str
    direction: str
    method: str
    exactness: str = "exact"
    n: int = 0
    sd: float | None = None
    ci95: tuple[float, float] | None = None
    why_not: str = ""
    extra: dict[str, Any] = field(default_factory=dict)


def not_computed(name: str, unit: str, direction: str, why: str) -> Metric:
    """A metric without a value, and the reason."""
    return Metric(name, None, unit, direction, method="", exactness="none", why_not=why)


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
    metrics          by name
    cloud            None where no states were recorded at the sample step
    parallel_matrix  C[e, e'] of the first complete run [cm], shape [env, env], or None
    run_matrix       W1 between runs [cm], shape [run, run], or None
    validity         contacts, buffers, overflow, actions
    fidelity         whether the states keep to mechanics
    notes            sentences that a reader must see beside the numbers
    spreads          of the complete runs
    timed            what its throughput was measured over
    """

    group: Group[Run]
    label: str
    metrics: dict[str, Metric]
    cloud: Cloud | None
    parallel_matrix: NDArray[np.float64] | None
    run_matrix: NDArray[np.float64] | None
    validity: Validity
    fidelity: Fidelity
    notes: tuple[str, ...]
    spreads: tuple[RunSpread, ...] = ()
    timed: TimedWork = TimedWork()


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
    """

    label: str
    path: Place
    run_id: str
    measured: bool
    scene: str
    positions: NDArray[np.float64]
    density: Density | None = None


@dataclass(frozen=True)
class Evaluation:
    """The result of evaluating a set of recordings.

    sample_time  simulated time at which positions are compared [s]
    results      one per group
    unreadable   files that could not be read, with their errors
    reference    None where there is none; `reference_note` says why, or where it came from
    sweeps       groups that differ in the number of environments alone
    accumulation how variability of sweeps goes with the number of environments
    comparison   of simulators: radar and guidelines
    maps         by scene; none for a scene whose positions were not recorded or lie too far apart
    price_list   what levels of determinism cost
    unmet        rules of the benchmark's protocol that the recordings do not meet
    notes        about the set as a whole
    """

    sample_time: float
    results: tuple[GroupResult, ...]
    unreadable: tuple[Unreadable, ...]
    reference: Reference | None
    reference_note: str
    sweeps: tuple[Sweep, ...]
    accumulation: tuple[Accumulation, ...]
    comparison: Comparison
    maps: dict[str, Map]
    notes: tuple[str, ...] = ()
    price_list: tuple[Family, ...] = ()
    unmet: Unmet = Unmet()
