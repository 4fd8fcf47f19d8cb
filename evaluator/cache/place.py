"""Where results are kept, and which classes they are made of."""

from __future__ import annotations

import os
from pathlib import Path

from evaluator.cache.codec import Codec
from evaluator.cache.store import Store
from evaluator.histories import Histories
from evaluator.metrics.alignment import Gap, GapTo
from evaluator.metrics.board import Board
from evaluator.metrics.cotenants import CoTenants, Sign
from evaluator.metrics.divergence import GrowthFit
from evaluator.metrics.levels import Level, Verdict, Worst
from evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from evaluator.metrics.split_tree import Branch, SplitTree
from evaluator.metrics.variability import ParallelVariability
from evaluator.missing import Missing
from evaluator.physics.facts import Check, Measured, PhysicsFacts
from evaluator.positions import Positions
from evaluator.reading import Reader
from evaluator.run_data import RunData
from evaluator.sharing.dataset.checkup import Checkup
from evaluator.sinking import Sunk
from evaluator.spread import Spread
from evaluator.stamp import Stamp
from evaluator.statistics.jackknife import Interval
from evaluator.statistics.matched import MatchedPoint
from evaluator.statistics.matched import Variability as MatchedVariability
from evaluator.step_evidence import ActionStream
from evaluator.summary import BitSummary, CountSummary, OverflowSummary, Summary
from evaluator.transport.pair import Transport
from evaluator.transport.small import SummaryBlock
from schemas.configuration import RunConfiguration
from schemas.fields import StateField
from schemas.provenance import Buffer, Counter, Deviation, OverflowBit, Provenance, ReplayOf, Simulation
from schemas.trial_units import UnitDoubt

_CLASSES = (
    Summary, CountSummary, BitSummary, OverflowSummary, ActionStream, Board, RunConfiguration, Provenance, ReplayOf,
    Simulation, Deviation, StateField, Buffer, Counter, OverflowBit, RunData, Histories, Positions, Checkpoints, Sunk,
    GpuMemory, Listing, CoTenants, Sign,
    Stamp, Reader, SplitTree, Branch, Spread, GrowthFit, Verdict, Worst, Level, PhysicsFacts,
    Measured, Missing, Check, ParallelVariability, Transport, Gap, GapTo, SummaryBlock,
    MatchedPoint, MatchedVariability, Interval, Checkup, UnitDoubt,
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
