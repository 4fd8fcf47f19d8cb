"""What a throughput is a throughput of: which steps of the scene, how long, with which settings of the solver.

Two throughputs can be compared where both were timed over the same steps: at other steps the scene has other contacts.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from gpusimbench.evaluator.check.rules.findings import Unmet
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.known_errors import options_in_force
from gpusimbench.evaluator.runs.groups import Group, GroupKey
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.permutation import ALPHA, p_value, ranges_of
from gpusimbench.schemas.configuration import deciding
from gpusimbench.schemas.gathering import gathered

_T = TypeVar("_T")

SHORT_S = 1.0
"""A timed phase below this [s] is marked: a pause of the system or a change of clocks is a large part of it."""

SETTINGS = {
    "cone": ("cone", "friction_cone"),
    "iterations": ("iterations", "solver_iterations", "position_iterations"),
    "tolerance": ("tolerance",),
}
"""Settings of a solver that decide how much work a step is, each with its names among the options of engines."""

_NAMED = 6  # outcomes that a sentence names


@dataclass(frozen=True, order=True)
class Window:
    """Timed steps of the scene.

    first  steps made before the first timed one
    last   the last timed step
    """

    first: int
    last: int

    @property
    def steps(self) -> int:
        """Timed steps."""
        return self.last - self.first


@dataclass(frozen=True)
class TimedWork:
    """What the throughput of a group was measured over.

    windows   of its runs, each once; empty where none was timed
    seconds   shortest and longest timed phase of its runs [s]; None where none was timed
    settings  by name of SETTINGS, the value in force as text; empty where the engine states none
    unmet     rules of the protocol that its recordings do not meet
    """

    windows: tuple[Window, ...] = ()
    seconds: tuple[float, float] | None = None
    settings: dict[str, str] = field(default_factory=dict)
    unmet: Unmet = Unmet()

    @property
    def said(self) -> str:
        """The timed steps in words."""
        return " and ".join(f"steps {w.first:,} to {w.last:,}" for w in self.windows) or "no steps"

    @property
    def short(self) -> bool:
        """Whether the timed phase of a run took less than SHORT_S."""
        return self.seconds is not None and self.seconds[0] < SHORT_S

    @property
    def unreliable(self) -> bool:
        """Whether a run was timed for less than the protocol asks, in seconds or in steps."""
        return self.short or "timed-steps" in self.unmet.findings


def timed_work(group: Group[Run], runs: Sequence[Run], unmet: Unmet) -> TimedWork:
    """The timed work of a group: with its complete runs and the rules that its recordings do not meet."""
    firsts = [run.timed_from for run in runs if not isinstance(run.timed_from, Missing)]
    windows = {Window(first, first + group.key.timed_steps) for first in firsts}
    seconds = [run.elapsed_s for run in runs if not isinstance(run.elapsed_s, Missing)]
    return TimedWork(
        tuple(sorted(windows)), (min(seconds), max(seconds)) if seconds else None, _settings(group), unmet
    )  # fmt: skip


def window_key(key: GroupKey, work: TimedWork) -> tuple[Hashable, ...]:
    """What throughputs of one scene have to share to be compared.

    The timed steps, the scene's description, how long a step is [s], and the settings that states depend on, such as
    how environments begin.
    """
    return work.windows, key.scene_hash, key.dt, deciding(key.settings)


def most_common(windows: Sequence[Hashable]) -> Hashable:
    """The one that most have; of several, the first."""
    return max(dict.fromkeys(windows), key=windows.count)


def largest_comparable(
    items: Sequence[_T],
    key: Callable[[_T], GroupKey],
    conditions: Callable[[_T], Hashable],
    merit: Callable[[_T], int] = lambda _: 0,
) -> list[_T]:
    """Those of the conditions that most of them share, if at least two simulators do; of several, those of merit.

    Runs that were left alone come before runs with --initial, --vary or --intervene, of which there may be more.
    """
    alike = gathered((conditions(item), item) for item in items)
    shared = [found for found in alike.values() if len({key(item).simulator for item in found}) > 1]

    def rank(found: list[_T]) -> tuple[bool, int, int]:
        return not deciding(key(found[0]).settings), len(found), sum(map(merit, found))

    return max(shared, key=rank, default=[])


def differing_settings(works: Iterable[TimedWork]) -> bool:
    """Whether solvers of some rows were set differently."""
    return len({tuple(work.settings.items()) for work in works if work.windows}) > 1


def _settings(group: Group[Run]) -> dict[str, str]:
    built = (run for run in group.recordings if run.simulation)
    options = next(map(options_in_force, built), group.key.parsed_options)
    return {
        name: next((_text(options[n]) for n in names if options.get(n) is not None), "")
        for name, names in SETTINGS.items()
    }


def _text(value: Any) -> str:
    # a tolerance in float32 is the one that was asked for
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Speed:
    """Throughput of the runs with one outcome: how many runs, the slowest and the fastest [env-steps/s]."""

    n_run: int
    low: float
    high: float

    @property
    def said(self) -> str:
        """The range in words."""
        low, high = (f"{value:,.0f}" if value >= 100 else f"{value:.3g}" for value in (self.low, self.high))
        return low if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class Speeds:
    """Throughputs by outcome, where they go with the outcome.

    outcomes  runs that are bit-identical, the slowest first
    p_value   of statistics.permutation, at most its ALPHA
    """

    outcomes: tuple[Speed, ...]
    p_value: float

    @property
    def slowest(self) -> str:
        """The throughput that every run reaches, in words."""
        return f"{self.outcomes[0].said} env-steps/s in the slowest of {len(self.outcomes)} outcomes"

    @property
    def ranges(self) -> str:
        """Runs and range of each outcome."""
        said = [f"{one.n_run} run{'s' if one.n_run > 1 else ''} at {one.said}" for one in self.outcomes]
        more = len(said) - _NAMED
        return ", ".join(said if more < 2 else [*said[:_NAMED], f"and {more} outcomes more"])

    def note(self, mean: float) -> str:
        """What a reader of the mean [env-steps/s] must know."""
        inside = any(one.low <= mean <= one.high for one in self.outcomes)
        of_mean = "the mean is over all of them" if inside else "the mean describes none of them"
        return f"throughput goes with the outcome (p = {self.p_value:.2g}): {self.ranges} env-steps/s; {of_mean}"


def speeds_of(throughputs: Sequence[float], outcomes: Sequence[int]) -> Speeds | None:
    """Speeds by outcome; None where throughputs [env-steps/s], one a run, are not shown to go with it."""
    p = p_value(throughputs, outcomes) if throughputs else 1.0
    return Speeds(tuple(Speed(*one) for one in ranges_of(throughputs, outcomes)), p) if p <= ALPHA else None
