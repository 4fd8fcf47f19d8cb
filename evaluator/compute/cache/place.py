"""Where results are kept, and which classes they are made of."""

from __future__ import annotations

import os
from pathlib import Path

from gpusimbench.evaluator.compute.cache.codec import Codec
from gpusimbench.evaluator.compute.cache.store import Store
from gpusimbench.evaluator.metrics.alignment import Gap, GapTo
from gpusimbench.evaluator.metrics.board import Board
from gpusimbench.evaluator.metrics.cotenants import CoTenants, Sign
from gpusimbench.evaluator.metrics.divergence import GrowthFit
from gpusimbench.evaluator.metrics.levels import Level, Verdict, Worst
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from gpusimbench.evaluator.metrics.split_tree import Branch, SplitTree
from gpusimbench.evaluator.metrics.variability import ParallelVariability
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.stamp import Stamp
from gpusimbench.evaluator.read.step_evidence import ActionStream
from gpusimbench.evaluator.runs.physics.facts import Check, Measured, PhysicsFacts
from gpusimbench.evaluator.runs.positions import Positions
from gpusimbench.evaluator.runs.reading import Reader
from gpusimbench.evaluator.runs.run_data import RunData
from gpusimbench.evaluator.runs.sinking import Sunk
from gpusimbench.evaluator.runs.spread import Spread
from gpusimbench.evaluator.runs.state_hashes import Histories
from gpusimbench.evaluator.runs.summary import BitSummary, CountSummary, OverflowSummary, Summary
from gpusimbench.evaluator.share.dataset.checkup import Checkup
from gpusimbench.evaluator.statistics.energy import EnergyDistance
from gpusimbench.evaluator.statistics.floor import Floor
from gpusimbench.evaluator.statistics.jackknife import Interval
from gpusimbench.evaluator.statistics.matched import MatchedPoint
from gpusimbench.evaluator.statistics.matched import Variability as MatchedVariability
from gpusimbench.evaluator.statistics.permutation import PermutationFloor
from gpusimbench.evaluator.transport.pair import Transport
from gpusimbench.evaluator.transport.small import SummaryBlock
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import Buffer, Counter, Deviation, OverflowBit, Provenance, ReplayOf, Simulation
from gpusimbench.schemas.trial_units import UnitDoubt

_CLASSES = (
    Summary, CountSummary, BitSummary, OverflowSummary, ActionStream, Board, RunConfiguration, Provenance, ReplayOf,
    Simulation, Deviation, StateField, Buffer, Counter, OverflowBit, RunData, Histories, Positions, Checkpoints, Sunk,
    GpuMemory, Listing, CoTenants, Sign,
    Stamp, Reader, SplitTree, Branch, Spread, GrowthFit, Verdict, Worst, Level, PhysicsFacts,
    Measured, Missing, Check, ParallelVariability, Transport, Gap, GapTo, SummaryBlock,
    MatchedPoint, MatchedVariability, Interval, Checkup, UnitDoubt, Floor, PermutationFloor, EnergyDistance,
)  # fmt: skip


def default_folder() -> Path | None:
    """GSB_CACHE, or gpusimbench in the user's folder of caches (XDG Base Directory Specification); None without one."""
    if given := os.environ.get("GSB_CACHE"):
        return Path(given)
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(home) if home else Path.home() / ".cache") / "gpusimbench"
    except RuntimeError:  # of a user that nobody knows, as in many a container
        return None


def open_store(folder: Path) -> Store:
    """The store in a folder."""
    return Store(folder, Codec(*_CLASSES))
