"""Numbers of runs, one for each run: which are compared; the ratio of head to base, tested by dealing the runs anew."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compare.finding import Change, Finding, Question, Settings, either_way, judged, not_compared
from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.cost_metrics import GPU_MEMORY, process_peak
from gpusimbench.evaluator.results.group_runs import GroupRuns, Runs
from gpusimbench.evaluator.results.metric import Axis, Direction, Metric, each
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.exchange import Shift, compare_means, least_p
from gpusimbench.evaluator.statistics.jackknife import mean_of

_SHOWN = 24

Values = NDArray[np.float64]
_SPEED: Final = (Axis.THROUGHPUT, Axis.MEMORY, Axis.BUILD)
_OPTIONAL: Final = (Axis.VALIDITY, Axis.VARIABILITY)
"""Axes of which nothing is said where neither side has a number."""

_MOST = 1e100
"""A file may hold any number; the ratio of larger ones, or of those below its inverse, is none."""

_LEAST = {"B": 1e6, "s": 1e-3}
"""A smaller change of memory, or of a time to build or to compile (microseconds where nothing is compiled), matters to
nobody, however large it is in proportion."""


@dataclass(frozen=True)
class Schedule:
    """Runs of both sides in the order in which they were made.

    runs    in order
    head    whether each is of head
    blocks  number of the block of each: the shortest stretches that hold runs of both sides
    known   whether recordings say when they were made, in at least half as many seconds as there are runs, and not all
            in one: times are in whole seconds
    """

    runs: tuple[Run, ...]
    head: tuple[bool, ...]
    blocks: tuple[int, ...]
    known: bool

    @property
    def n(self) -> tuple[int, int]:
        """Runs of base and of head."""
        return len(self.head) - sum(self.head), sum(self.head)

    @property
    def interleaved(self) -> bool:
        """Whether blocks are short enough for drift to be nearly the same for their runs: four runs on average."""
        return self.known and len(set(self.blocks)) >= max(2, (min(self.n) + 1) // 2)

    @property
    def one_first(self) -> bool:
        """Whether every block began with the same side, so that a steady drift is left in the difference."""
        first = {self.head[self.blocks.index(block)] for block in self.blocks}
        return len(first) == 1

    @property
    def text(self) -> str:
        """The order as letters, A for base and B for head."""
        letters = "".join("B" if head else "A" for head in self.head)
        return letters if len(letters) <= _SHOWN else f"{letters[:_SHOWN]}..."

    def blocks_for(self, level: float) -> tuple[int, ...]:
        """The shortest blocks of neighbours within which a test can reach the level; one block where none can."""
        if not self.interleaved:
            return (0,) * len(self.head)
        blocks = self.blocks
        while max(blocks) and least_p(self.head, blocks) > level:
            blocks = tuple(block // 2 for block in blocks)
        return blocks


def schedule(base: Sequence[Run], head: Sequence[Run]) -> Schedule:
    """The order of some runs; those of one second are in the order of their run ids, which says nothing of the side."""
    tagged = [(run, False) for run in base] + [(run, True) for run in head]
    tagged.sort(key=lambda one: (one[0].provenance.created_utc, one[0].provenance.run_id))
    n_time = len({run.provenance.created_utc for run, _ in tagged})
    known = all(run.provenance.dated for run, _ in tagged) and n_time > 1 and 2 * n_time >= len(tagged)
    sides = tuple(side for _, side in tagged)
    return Schedule(tuple(run for run, _ in tagged), sides, neighbours(sides), known)


def neighbours(head: Sequence[bool]) -> tuple[int, ...]:
    """Blocks of a sequence: each ends with the first run by which it holds both sides; what is left joins the last."""
    blocks: list[int] = []
    block, seen = 0, set[bool]()
    for index, side in enumerate(head):
        blocks.append(block)
        seen.add(side)
        if len(seen) == 2 and len(set(head[index + 1 :])) == 2:
            block, seen = block + 1, set()
    return tuple(blocks)


def compare_numbers(
    metric: Metric, axis: Axis, base: GroupRuns, head: GroupRuns, settings: Settings, *, same_machine: bool
) -> Finding | Question | None:
    """A verdict that needs no statistics, a question, or None where neither side has anything to compare.

    Logarithms are compared, so that a factor counts the same up and down; the numbers themselves where one is zero.
    """
    estimates = [metric.estimate(side) for side in (base, head)]
    reasons = [one.value.reason for one in estimates if isinstance(one.value, Missing)]
    name, title = metric.name, metric.title
    if len(reasons) == 2 and axis in _OPTIONAL:
        return None
    if reasons:
        either = len(reasons) == 1 or not (base.runs and head.runs) or any(one.details.spoilt for one in estimates)
        return not_compared(axis, name, title, "; ".join(dict.fromkeys(reasons)), applies=either)
    if axis in _SPEED and not same_machine:
        return not_compared(axis, name, title, "base and head were recorded on different machines")
    of = {id(run): value for side in (base, head) for run, value in zip(side.runs, _values(metric, side), strict=True)}
    having = [[run for run in side.runs if not isinstance(of[id(run)], Missing)] for side in (base, head)]
    order = schedule(*having)
    values = np.array([of[id(run)] for run in order.runs], dtype=np.float64)
    if not ((values == 0) | ((values > 1 / _MOST) & (values < _MOST))).all():
        return not_compared(axis, name, title, "a run has a value that is negative, not finite or too large")
    second = np.array(order.head)
    one, other = values[~second], values[second]
    finding = Finding(
        axis, name, title, Change.SAME, metric.direction, metric.base_unit,
        base=mean_of(one), head=mean_of(other), ratio=_ratio(mean_of(one), mean_of(other)), n=order.n,
        method=metric.method,
    )  # fmt: skip
    if np.ptp(one) == 0.0 and np.ptp(other) == 0.0:
        before, after = one[0], other[0]
        if before == after:
            return replace(finding, note="the same in every run")
        if min(order.n) > 1:
            return replace(
                finding,
                change=judged(metric.direction, rises=after > before)
                if matters(metric, before, after, settings)
                else Change.SMALL,
                note=f"all runs of a side have this value; {_by_chance(order)}",
            )
    return _Asked(metric, order, values, finding, settings)


@dataclass(frozen=True)
class _Asked:
    """The test of one metric."""

    metric: Metric
    order: Schedule
    values: Values
    finding: Finding
    settings: Settings

    @property
    def least_p(self) -> float:
        """See Question."""
        return least_p(self.order.head, [0] * len(self.order.head))

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question; what is as large as matters is by the ends of the interval, not by its middle."""
        logs = bool((self.values > 0).all())
        # what the engine computes has no clock in it: such runs are exchanged with any other
        clocked = self.finding.axis is not Axis.VARIABILITY
        blocks = self.order.blocks_for(level) if clocked else (0,) * len(self.order.head)
        found = compare_means(
            np.log(self.values) if logs else self.values, self.order.head, blocks, confidence=0.95
        )  # fmt: skip
        second = np.array(self.order.head)
        one, other = self.values[~second], self.values[second]
        center = _geometric if logs else mean_of
        base, head = center(one), center(other)
        # within blocks of unequal sizes, the shift is no difference of these means: what was tested is shown
        ratio = math.exp(found.difference) if logs else _ratio(base, head)
        kind = "geometric means over runs" if logs else "means over runs"
        tested = replace(
            self.finding,
            base=base,
            head=head,
            ratio=ratio,
            p_value=found.p_value,
            least_p=found.least_p,
            test=f"{kind}; {_exchanged(found, blocks)}",
        )
        if found.low is None or found.high is None:
            return either_way(tested, falls=True, rises=True)
        low, high = (base * math.exp(end) if logs else base + end for end in (found.low, found.high))
        low_matters, high_matters = (matters(self.metric, base, end, self.settings) for end in (low, high))
        return either_way(
            replace(tested, ci95=(math.exp(found.low), math.exp(found.high)) if logs else None, bounded=True),
            falls=low < base and low_matters,
            rises=high > base and high_matters,
            beyond=(low > base and low_matters) or (high < base and high_matters),
        )


def _by_chance(order: Schedule) -> str:
    """How often two values that fell to runs whatever their side would part them like this."""
    chance = least_p(order.head, [0] * len(order.head))
    return f"random exchange of runs separates them like this in {chance:.2g} of all cases"


def _exchanged(found: Shift, blocks: tuple[int, ...]) -> str:
    count = len(set(blocks))
    within = f"within {count} blocks of neighbours in time" if count > 1 else "with any other"
    return f"permutation test, runs exchanged {within} ({found.ways}); the interval inverts the test"


def _values(metric: Metric, side: GroupRuns) -> Sequence[float | Missing]:
    return metric.values(side) if metric.values else ()


def matters(metric: Metric, base: float, head: float, settings: Settings) -> bool:
    """Whether two values of a metric, in its base unit, are apart by more than what counts."""
    unit = metric.base_unit
    least = settings.least_outcome(unit) if unit in ("cm", "rad") else _LEAST.get(unit, 0.0)
    return settings.matters(base, head) and abs(head - base) >= least


def _geometric(values: Values) -> float:
    return math.exp(mean_of(np.log(values)))


def _ratio(base: float, head: float) -> float | None:
    return head / base if base > 0 else None


def contacts_of(run: Run) -> float | Missing:
    """Contacts of an environment at a step: of the timed phase, or else of the captured steps."""
    counts = run.counts
    found = next(
        (counts[phase]["contacts"] for phase in ("timed", "capture") if "contacts" in counts.get(phase, {})), None
    )
    return found.mean if found else Missing("contacts were not counted")


CONTACTS = Metric(
    "contacts", "contacts of an env", "", Direction.NEITHER,
    "contacts of an environment at a counted step; mean over runs",
    method="mean over environments and counted steps", values=each(contacts_of), axis=Axis.VALIDITY,
)  # fmt: skip


def compared_by(axis: Axis, base: Runs, head: Runs) -> Iterator[Metric]:
    """The metrics of an axis that have a number of each run; GPU memory by the one that both sides have."""
    other_sources = {*GPU_MEMORY} - {_gpu_memory_by(base, head)}
    for metric in (*METRICS.values(), CONTACTS):
        if metric.axis is axis and metric.values is not None and metric.name not in other_sources:
            yield metric


def _gpu_memory_by(base: Runs, head: Runs) -> str:
    """The metric by which GPU memory is compared: of one source on both sides.

    The increment of the whole device, as published; where another process was on the device in a run, what NVML
    attributed to the runs' own processes, if all runs have it.
    """
    device, process = GPU_MEMORY
    runs = (*base, *head)
    shared = any(run.cotenants.presence is Presence.SOME for run in runs)
    return process if shared and all(process_peak(run) is not None for run in runs) else device
