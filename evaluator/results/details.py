"""Figures that belong to an estimate, by kind of metric; JSON has them under `extra`."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.json_values import entry, picked
from gpusimbench.evaluator.metrics.cotenants import Presence, Sign
from gpusimbench.evaluator.metrics.identity import SplitTree
from gpusimbench.evaluator.metrics.levels import Worst
from gpusimbench.evaluator.metrics.memory import Checkpoints
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.timed_work import Speeds
from gpusimbench.evaluator.statistics.permutation import Floor
from gpusimbench.evaluator.statistics.regimes import RegimeProbabilities

_OPTIONAL = {"optional": True}
"""Marks a field that JSON leaves out where it is None."""

_HIDDEN = {"hidden": True}
"""Marks a field that JSON never has."""


@dataclass(frozen=True)
class Details:
    """Details of an estimate of which nothing but the value is known."""

    @property
    def spoilt(self) -> bool:
        """Whether a run had a figure that cannot be used."""
        return False

    def record(self) -> dict[str, Any]:
        """What JSON has under `extra`; empty where there is nothing."""
        found: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if "hidden" in one.metadata or ("optional" in one.metadata and value is None):
                continue
            found |= {one.name: _exchanged(value)} if isinstance(value, Floor) else picked(self, one.name)
        return found


def _exchanged(found: Floor) -> dict[str, Any]:
    w1, energy = found.w1, found.energy
    return {
        **entry("w1", w1 and {
            "observed_cm": w1.observed,
            "floor_mean_cm": w1.floor_mean,
            "floor_q95_cm": w1.floor_q95,
            "p_value": w1.p_value,
            "permutations": w1.n_permutation,
            "seed": w1.seed,
        }),
        **entry("energy", energy and {
            "observed_cm": energy.v_statistic,
            "unbiased_cm": energy.u_statistic,
            "floor_mean_cm": energy.floor_mean,
            "p_value": energy.p_value,
            "permutations": energy.n_permutation,
        }),
    }  # fmt: skip


@dataclass(frozen=True)
class OverRuns(Details):
    """Details of a metric with one value a run.

    per_run  the values, in the unit of the metric
    """

    per_run: tuple[float, ...] | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class RunPresence:
    """Whether another process was on the device of a run, and what shows it."""

    run: int
    presence: Presence
    signs: tuple[Sign, ...]


@dataclass(frozen=True)
class Throughput(OverRuns):
    """Details of throughput.

    timing_covers  what lies between the clocks, in the words of the simulator
    co_tenants     by run; None where the simulator ran on the CPU
    speeds         by outcome; None where throughput is not shown to go with the outcome
    """

    timing_covers: str = ""
    co_tenants: tuple[RunPresence, ...] | None = None
    speeds: Speeds | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class SharedRun:
    """A run whose device another process used: what was read of device and process [byte], None where nothing was."""

    run: int
    increment_bytes: int | None
    process_bytes: int | None


@dataclass(frozen=True)
class ShrunkRun:
    """A run whose process held less in the timed phase than at the baseline."""

    run: int


@dataclass(frozen=True)
class Memory(OverRuns):
    """Details of a metric of memory.

    source             "device", "process", "allocator" or "host"
    checkpoints_bytes  of every run that was sampled
    runs_left_out      runs whose figure cannot be used
    """

    source: str = ""
    checkpoints_bytes: tuple[Checkpoints, ...] | None = field(default=None, metadata=_OPTIONAL)
    runs_left_out: tuple[SharedRun | ShrunkRun, ...] | None = field(default=None, metadata=_OPTIONAL)

    @property
    def spoilt(self) -> bool:
        """Whether a run had an increment to which another process added."""
        shared = [one for one in self.runs_left_out or () if isinstance(one, SharedRun)]
        return any(one.increment_bytes is not None and one.increment_bytes >= 0 for one in shared)


@dataclass(frozen=True)
class CaptureOverhead(OverRuns):
    """Of the capture's overhead: the share of its time that the engine waited for the disk."""

    stalled_share: float = 0.0


@dataclass(frozen=True)
class Drawn:
    """Environments that were drawn, where a run has too many: how many, and a 95 % interval [cm] of each run."""

    envs: int
    seed: int
    intervals_cm: tuple[tuple[float, float] | None, ...]


@dataclass(frozen=True)
class BetweenEnvs(OverRuns):
    """Details of W1 between environments.

    distinct_at_sample_step  bitwise different environments of each run
    sampled                  None where all environments were compared
    matrix_of                place of the run whose matrix is kept, among the runs that `distinct_envs` compares; or why
                             there is no matrix, or no such place
    matrix_cm                W1 between the environments of that run [cm], shape [env, env]
    """

    distinct_at_sample_step: tuple[int, ...] = ()
    sampled: Drawn | None = field(default=None, metadata=_OPTIONAL)
    matrix_of: int | Missing | None = field(default=None, metadata=_OPTIONAL)
    matrix_cm: NDArray[np.float64] | None = field(default=None, metadata=_HIDDEN, compare=False)


@dataclass(frozen=True)
class BetweenRuns(Details):
    """Details of W1 between runs.

    n_run                 runs
    permutation_test      of the first two runs
    bounds_cm             that enclose the value where it is not exact
    run_indices, classes  indices of the runs in the order of the matrix, and their classes by bits
    matrix_cm             W1 between runs [cm], shape [run, run]; None where not all pairs were computed
    """

    n_run: int = 0
    permutation_test: Floor = Floor()
    bounds_cm: tuple[float, float] | None = field(default=None, metadata=_OPTIONAL)
    run_indices: tuple[int, ...] | None = field(default=None, metadata=_OPTIONAL)
    classes: tuple[int, ...] | None = field(default=None, metadata=_OPTIONAL)
    matrix_cm: NDArray[np.float64] | None = field(default=None, metadata=_HIDDEN, compare=False)


@dataclass(frozen=True)
class JointsBetweenEnvs(OverRuns):
    """Of a distance in joint space between environments: how many joints it is the root mean square of."""

    joints: int = 0


@dataclass(frozen=True)
class JointsBetweenRuns(Details):
    """Of distances in joint space between runs; see BetweenRuns."""

    n_run: int = 0
    joints: int = 0


@dataclass(frozen=True)
class ToReference(OverRuns):
    """Details of W1 to the reference.

    reference         what it is
    measured          whether it is real trials
    permutation_test  of the first run and the reference
    extension         what goes beyond the published definition
    bounds_cm         that enclose the value where it is not exact
    """

    reference: str = ""
    measured: bool = False
    permutation_test: Floor = Floor()
    extension: str | None = field(default=None, metadata=_OPTIONAL)
    bounds_cm: tuple[float, float] | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class OverTosses(OverRuns):
    """Details of an error of a thrown cube.

    tosses          that were compared
    tracking_floor  the same error of a cube in free fall before its first contact, in the unit of the metric; None
                    where there is no such thing
    per_toss        the values, mean over runs, in the order of the tosses
    numbers         of these tosses in their set
    rows            of a local error: rows after each setting to a measured state; None of other errors
    """

    tosses: int = 0
    tracking_floor: float | None = field(default=None, metadata=_OPTIONAL)
    rows: int | None = field(default=None, metadata=_OPTIONAL)
    per_toss: tuple[float, ...] = field(default=(), metadata=_HIDDEN)
    numbers: tuple[int, ...] = field(default=(), metadata=_HIDDEN)


@dataclass(frozen=True)
class OverTime:
    """How many are distinct, at the steps where a count changes: at that very step, and by all steps up to it."""

    step: tuple[int, ...]
    at_step: tuple[int, ...]
    histories: tuple[int, ...]


@dataclass(frozen=True)
class DistinctEnvs(Details):
    """Details of the number of bitwise distinct environments.

    per_run                how many in each run
    classes                of the environments of each run, numbered in order of first appearance
    first_difference_step  in any run; None where no environments differ, and of timed steps
    over_time              of the run with the most
    tree                   which left which, in the first run
    without_hashes         complete runs without state hashes
    timed_steps            steps of the timed phase that were compared, where no states were captured
    """

    per_run: tuple[int, ...] = ()
    classes: tuple[tuple[int, ...], ...] = ()
    first_difference_step: int | None = None
    over_time: OverTime | None = field(default=None, metadata=_OPTIONAL)
    tree: SplitTree | None = field(default=None, metadata=_OPTIONAL)
    without_hashes: int | None = field(default=None, metadata=_OPTIONAL)
    timed_steps: tuple[int, ...] | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class DistinctRuns(Details):
    """Details of the number of bitwise distinct runs; see DistinctEnvs.

    classes      of the runs
    run_indices  their indices
    """

    classes: tuple[int, ...] = ()
    first_difference_step: int | None = None
    run_indices: tuple[int, ...] = ()
    over_time: OverTime | None = field(default=None, metadata=_OPTIONAL)
    tree: SplitTree | None = field(default=None, metadata=_OPTIONAL)
    without_hashes: int | None = field(default=None, metadata=_OPTIONAL)
    timed_steps: tuple[int, ...] | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class Changed(Details):
    """Of capturing that may have changed the states: in how many runs they differ, of how many."""

    differ: int = 0
    of: int = 0


@dataclass(frozen=True)
class Equality(Details):
    """Of a level of equality; see levels.Verdict. `run` has the index of the run whose environments these are."""

    text: str = ""
    note: str = ""
    order: str = ""
    max_ulp: float = 0.0
    tolerance_m: float = 0.0
    worst_ulp: float | None = None
    worst: Worst | None = None
    run: int | None = field(default=None, metadata=_OPTIONAL)


@dataclass(frozen=True)
class SpreadCurve:
    """How far environments lie apart at the recorded steps: root mean square and largest distance [m]."""

    step: tuple[int, ...]
    rms_m: tuple[float | None, ...]
    largest_m: tuple[float | None, ...]


@dataclass(frozen=True)
class AngleCurve:
    """The same of hinges [rad], where there are no bodies."""

    step: tuple[int, ...]
    rms_rad: tuple[float | None, ...]
    largest_rad: tuple[float | None, ...]


@dataclass(frozen=True)
class Growth(OverRuns):
    """Of the rate at which distances grow, by run: doubling times [s], R squared, window of the fit [s].

    curve  of one of the runs
    """

    doubling_time_s: tuple[float | None, ...] = ()
    r_squared: tuple[float, ...] = ()
    window_s: tuple[tuple[float, float], ...] = ()
    curve: SpreadCurve | AngleCurve | None = None


@dataclass(frozen=True)
class OffTheBoard(Details):
    """Of bodies off the board: how many of how many in all, by run, and environments with any."""

    total: int = 0
    of: int = 0
    per_run: tuple[int, ...] = ()
    envs_with_any: int = 0


@dataclass(frozen=True)
class SunkCubes(Details):
    """Details of cubes that sank.

    total, of   of all runs
    cubes       of an environment
    per_run     how many
    last_step   that they were followed to
    first_step  at which the first was through; None where none was
    """

    total: int = 0
    of: int = 0
    cubes: int = 0
    per_run: tuple[int, ...] = ()
    last_step: int = 0
    first_step: int | None = None


@dataclass(frozen=True)
class PublishedType(Details):
    """Details of the published type.

    resampled  how it would come out again; `decided_by` are indices of runs as they were recorded
    """

    resampled: RegimeProbabilities | Missing | None = None

    def record(self) -> dict[str, Any]:
        """The probabilities, or why there are none."""
        found = self.resampled
        if not found:
            return {} if found is None else entry("probabilities", found)
        names = "decided_by agreement distinct run_differs_below parallel_below"
        return {
            **entry("probabilities", found.probabilities),
            "n_run": found.runs,
            **picked(found, names),
            "resampling": found.method,
            **picked(found, "draws seed"),
        }
