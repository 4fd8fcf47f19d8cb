"""Throughput that goes with the outcome of a run: a range of each outcome, where a mean over all would hide it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.statistics.permutation import ALPHA, p_value, ranges_of

_NAMED = 6  # outcomes that a sentence names


@dataclass(frozen=True)
class Speed:
    """Throughput of the runs with one outcome: how many runs, the slowest and the fastest [env-steps/s]."""

    runs: int
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
    p_value   of statistics.outcomes, at most its ALPHA
    """

    outcomes: tuple[Speed, ...]
    p_value: float

    @property
    def slowest(self) -> str:
        """What every run reaches."""
        return f"{self.outcomes[0].said} env-steps/s in the slowest of {len(self.outcomes)} outcomes"

    @property
    def ranges(self) -> str:
        """Runs and range of each outcome."""
        said = [f"{one.runs} run{'s' if one.runs > 1 else ''} at {one.said}" for one in self.outcomes]
        more = len(said) - _NAMED
        return ", ".join(said if more < 2 else [*said[:_NAMED], f"and {more} outcomes more"])

    def note(self, mean: float) -> str:
        """What a reader of the mean [env-steps/s] must know."""
        inside = any(one.low <= mean <= one.high for one in self.outcomes)
        of_mean = "the mean is over all of them" if inside else "the mean describes none of them"
        return f"throughput goes with the outcome (p = {self.p_value:.2g}): {self.ranges} env-steps/s; {of_mean}"


def speeds_of(throughputs: Sequence[float], outcomes: Sequence[int]) -> Speeds | None:
    """By outcome; None where throughputs [env-steps/s], one a run, are not shown to go with it."""
    p = p_value(throughputs, outcomes) if throughputs else 1.0
    return Speeds(tuple(Speed(*one) for one in ranges_of(throughputs, outcomes)), p) if p <= ALPHA else None
