"""What a metric is: one declaration, from which every output takes its name, title, unit, direction and value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from typing import TypeVar

from gpusimbench.evaluator.metrics.radar import Axis as RadarAxis
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.details import Details, OverRuns
from gpusimbench.evaluator.results.group_runs import MEAN, NO_RUN, Aggregator, GroupRuns
from gpusimbench.evaluator.runs.run import Run

BYTES = {"GB": 1e9, "MB": 1e6}
"""Units of memory, in bytes."""

CLASSES = ("level", "type")
"""Units of values that only name a class."""


class Direction(StrEnum):
    """Which way is better."""

    HIGHER = "higher"
    LOWER = "lower"
    NEITHER = "neither"


class Axis(Enum):
    """What gsb-compare asks of a change; the value is its name as a gate."""

    THROUGHPUT = "throughput"
    MEMORY = "memory"
    BUILD = "build"
    PHYSICS = "physics"
    VALIDITY = "validity"
    VARIABILITY = "variability"
    DETERMINISM = "determinism"
    BITS = "bits"
    EPISODES = "episodes"
    LENGTHS = "lengths"


class Table(StrEnum):
    """Which table of a report has the metric as a column."""

    THROUGHPUT = "throughput"
    VARIABILITY = "variability"
    REALITY = "reality"


Values = Callable[[GroupRuns], Sequence[float | Missing]]


@dataclass(frozen=True)
class Metric:
    """The declaration of a metric.

    Either it has a value of each run and an aggregate over them, or `of_group` makes the estimate.

    name       in JSON, Parquet and messages
    title      for people
    unit       SI or as the published definition has it; empty for counts and classes
    direction  which way is better
    docs       what docs/metrics.md says of it, with its formula (Markdown)
    method     its formula in one line, without the aggregate
    published  whether the definition is that of GPUSimBench, and no addition of this project
    table      of the report that has it as a column
    values     one for each run of the group, in `base_unit`; None where it is a metric of the group alone
    aggregate  over those
    remark     what an estimate's method says behind the aggregate
    details    of an estimate over runs
    of_group   the estimate for a group, or why it has no value
    interval   what the estimate's 95 % interval is; empty where it has none
    optional   tables leave it out where no group has a value, without a reason
    axis       of gsb-compare that it belongs to; None where sets of runs are not compared by it
    radar      axis of the radar that it is drawn on
    """

    name: str
    title: str
    unit: str
    direction: Direction
    docs: str
    method: str = ""
    published: bool = False
    table: Table = Table.THROUGHPUT
    values: Values | None = None
    aggregate: Aggregator = MEAN
    remark: str = ""
    details: Callable[[GroupRuns], OverRuns] = lambda _: OverRuns()
    of_group: Callable[[Metric, GroupRuns], Estimate | Missing] | None = None
    interval: str = ""
    optional: bool = False
    axis: Axis | None = None
    radar: RadarAxis | None = None

    @property
    def per_unit(self) -> float:
        """How many of `base_unit` the unit is."""
        return BYTES.get(self.unit, 1.0)

    @property
    def base_unit(self) -> str:
        """The unit of `values`: "B" for memory, else that of the metric."""
        return "B" if self.unit in BYTES else self.unit

    @property
    def titled(self) -> str:
        """Title with unit, as a table's heading."""
        return f"{self.title} [{self.unit}]" if self.unit and self.unit not in CLASSES else self.title

    @property
    def has_interval(self) -> str:
        """What the 95 % interval is; empty where estimates have none."""
        return self.interval or (self.aggregate.interval if self.of_group is None else "")

    def estimate(self, group: GroupRuns) -> Estimate:
        """Its value for a group, computed once."""
        if self.name not in group.known:
            made = self.of_group(self, group) if self.of_group else over_runs(self, group)
            group.known[self.name] = missing(self, made.reason) if isinstance(made, Missing) else made
        found: Estimate = group.known[self.name]
        return found


_D = TypeVar("_D", bound=Details)


@dataclass(frozen=True)
class Estimate:
    """A metric's value for one group.

    value      or why there is none
    method     how it was computed, in words
    exactness  "exact", "certified" (bounds in the details), "sampled" (seed in the details) or "none" without a value
    n          how many observations the value is a mean of, or counts
    sd         standard deviation over those, as published
    ci95       95 % interval, or why there is none; None where the metric has none
    details    figures that belong to the value
    """

    metric: Metric
    value: float | Missing
    method: str = ""
    exactness: str = "exact"
    n: int = 0
    sd: float | None = None
    ci95: tuple[float, float] | Missing | None = None
    details: Details = Details()

    @property
    def name(self) -> str:
        """The name of the metric."""
        return self.metric.name

    @property
    def unit(self) -> str:
        """The unit of the metric."""
        return self.metric.unit

    def of(self, kind: type[_D]) -> _D:
        """The details of a kind; those without a figure where it has none of that kind."""
        return self.details if isinstance(self.details, kind) else kind()


def missing(metric: Metric, why_not: str, details: Details | None = None) -> Estimate:
    """An estimate without a value, and the reason."""
    return Estimate(metric, Missing(why_not), exactness="none", details=details or Details())


def each(of_run: Callable[[Run], float | Missing]) -> Values:
    """The values of all runs of a group, by a function of one run."""
    return lambda group: [of_run(run) for run in group.runs]


def over_runs(metric: Metric, group: GroupRuns, method: str = "") -> Estimate:
    """The aggregate of the values of runs; those without a value are left out, and give the reason where none has one.

    method  in place of the metric's, where it depends on the runs
    """
    values = metric.values(group) if metric.values else []
    known = [value / metric.per_unit for value in values if not isinstance(value, Missing)]
    if not known:
        return missing(metric, next((v.reason for v in values if isinstance(v, Missing)), NO_RUN))
    found = metric.aggregate.of(known)
    scale = f"; 1 {metric.unit} = {metric.per_unit:.0e} B" if metric.unit in BYTES else ""
    how = f"{method or metric.method}, {metric.aggregate.name} over runs{metric.remark}{scale}"
    return Estimate(
        metric,
        found.value,
        method=f"{how}; interval: {found.method}" if found.method else how,
        n=len(known),
        sd=found.sd,
        ci95=found.ci95,
        details=replace(metric.details(group), per_run=tuple(known)),
    )
