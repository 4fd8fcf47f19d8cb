"""What remains of a recording once its file is closed: small, picklable, bounded. Metrics read nothing else."""

from __future__ import annotations

from dataclasses import dataclass, field

from gpusimbench.evaluator.metrics.cotenants import CoTenants
from gpusimbench.evaluator.metrics.levels import AxisVerdict
from gpusimbench.evaluator.metrics.lost_cubes import Board
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.addresses import Stamp
from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.read.episodes import EpisodeCounts
from gpusimbench.evaluator.read.evidence import ActionStream
from gpusimbench.evaluator.read.failing import Failing
from gpusimbench.evaluator.runs.growth import Course
from gpusimbench.evaluator.runs.physics.depth import Sunk
from gpusimbench.evaluator.runs.physics.facts import PhysicsFacts
from gpusimbench.evaluator.runs.positions import JointSample, Positions
from gpusimbench.evaluator.runs.spread import Spread
from gpusimbench.evaluator.runs.state_hashes import ArrayHistory, Histories
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import Provenance, Simulation
from gpusimbench.schemas.trial_units import UnitDoubt

NOT_MEASURED = Missing("the run did not complete, or lost data")


@dataclass(frozen=True)
class CountSummary:
    """One counter of one phase, over its rows.

    mean          over environments and rows
    p95           95th percentile over environments, mean over rows
    max           of any environment at any row
    fullest_mean  largest mean over environments at any row
    rows          steps that were counted
    """

    mean: float
    p95: float
    max: float
    fullest_mean: float
    rows: int


@dataclass(frozen=True)
class BitSummary:
    """One overflow bit of one phase.

    rows        recorded steps at which it fired
    first_step  the first of them
    envs        most environments with any bit at one of them
    """

    bit: int
    rows: int
    first_step: int
    envs: int


@dataclass(frozen=True)
class OverflowSummary:
    """The bits of a phase that fired; `spread` says that a row stands for all steps since the row before."""

    bits: tuple[BitSummary, ...]
    spread: bool


@dataclass(frozen=True)
class Run(Described):
    """One recording, read and closed: what it says of itself, and what was measured in it.

    Of every recording, with attributes as `Recording` has them:

    counts          by phase and name
    overflows       by phase; a phase that tells nothing is left out
    action_streams  what each phase applied, by phase
    failing         environments that failed, where the states of these alone were kept
    board           of the scene; None without one, and where its description cannot be read
    named_time      sample time that the scene names [s]; None where it names none
    unmet           rules of the benchmark's protocol that the file breaks by itself
    stamp           of the file before it was read, where it was read

    Measured, of a run that is complete and lost no data; of others these are Missing, `compile_s` is empty and
    `reached` false:

    elapsed_s   of the timed phase, all windows together [s]
    timed_steps  that took so long: those of a window, as often as the window was timed
    gpu         memory of the device that steps [byte]; Missing also where the simulator ran on the CPU
    host        memory of the process [byte]
    allocator   peak of the engine's own device allocator up to the end of the timed phase [byte]
    build_s     import of the engine, loading, allocation [s]
    compile_s   compilation of what the timed phase runs, and of what the capture phase runs [s], by phase; what was not
                clocked is left out
    capture_s   from the first step of the capture to the last one's state on the host [s]
    stalled_s   part of that in which the engine stood still until states were written [s]
    histories   of the captured states by bits
    timed_histories  the same of the states that the timed phase hashed, where none were captured
    observed    whether timed and captured states agree, by the hashes of steps that timed and capture phase both passed
    positions   of the bodies of the outcome at the sample step
    joints      at the sample step
    reached     whether the sample step was recorded at all, whatever the states are
    doubt       what speaks against the unit of real trials; None where nothing does, and of simulations
    equality    of the environments, by bits and at the sample step
    spread      how the environments move apart
    sunk        cubes that went through the floor
    physics     how far the states keep to mechanics
    timed_from  steps of the scene that were made before the first timed one
    cotenants   other processes on that device, as far as the recordings it was read with tell
    episodes    of the environments of a task, counted
    course      of the timed phase, from its begin to its end
    arrays      of the program, by name; empty where it hashed none
    """

    path: Place
    status: str
    reason: str
    cause: str
    content_hash: str
    provenance: Provenance
    simulation: Simulation | None
    dropouts: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()
    counts: dict[str, dict[str, CountSummary]] = field(default_factory=dict)
    overflows: dict[str, OverflowSummary] = field(default_factory=dict)
    action_streams: dict[str, ActionStream] = field(default_factory=dict)
    failing: Failing | None = None
    board: Board | None = None
    named_time: float | None = None
    unmet: tuple[str, ...] = ()
    stamp: Stamp | Missing = Missing("the file was not read for good")
    elapsed_s: float | Missing = NOT_MEASURED
    timed_steps: int | Missing = NOT_MEASURED
    gpu: GpuMemory | Missing = NOT_MEASURED
    host: Checkpoints | Missing = NOT_MEASURED
    allocator: int | Missing = NOT_MEASURED
    build_s: float | Missing = NOT_MEASURED
    compile_s: dict[str, float] = field(default_factory=dict)
    capture_s: float | Missing = NOT_MEASURED
    stalled_s: float | Missing = NOT_MEASURED
    histories: Histories | Missing = NOT_MEASURED
    timed_histories: Histories | Missing = NOT_MEASURED
    observed: bool | Missing = NOT_MEASURED
    positions: Positions | Missing = NOT_MEASURED
    joints: JointSample | Missing = NOT_MEASURED
    reached: bool = False
    doubt: UnitDoubt | None = None
    equality: AxisVerdict | Missing = NOT_MEASURED
    spread: Spread | Missing = NOT_MEASURED
    sunk: Sunk | Missing = NOT_MEASURED
    physics: PhysicsFacts = PhysicsFacts("", 0, (), NOT_MEASURED)
    timed_from: int | Missing = NOT_MEASURED
    cotenants: CoTenants = CoTenants()
    episodes: EpisodeCounts | Missing = NOT_MEASURED
    course: Course | Missing = NOT_MEASURED
    arrays: dict[str, ArrayHistory] = field(default_factory=dict)

    @property
    def acted(self) -> bool:
        """Whether actions were applied; those of a phase without states are known by their generator alone."""
        return bool(self.action_names or self.action_streams)
