"""Short words for what a table's cell has room for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import median

from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.metrics.levels import EqualityLevel
from gpusimbench.evaluator.metrics.memory import MemoryModel
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.render.numbers import NONE, distance, length, mean_sd, scaled
from gpusimbench.evaluator.results.details import (
    BetweenRuns,
    CaptureOverhead,
    DistinctEnvs,
    DistinctRuns,
    Equality,
    Growth,
    PublishedType,
    Throughput,
    ToReference,
)
from gpusimbench.evaluator.results.identity_metrics import identical
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.validity import BufferUse, Counted, OverflowSeen, Validity
from gpusimbench.evaluator.runs.groups import Group, shown_status
from gpusimbench.evaluator.statistics.permutation import Floor
from gpusimbench.evaluator.statistics.regimes import RegimeProbabilities
from gpusimbench.schemas.text import bound, percent, plural


def trouble(group: Group[Described]) -> str:
    """Runs that are not complete, by how they ended: "2 INVALID (buffer), 1 failed"; empty where all are complete."""
    found: dict[str, int] = {}
    for recording in group.recordings:
        if not recording.usable:
            what = "lost data" if recording.status == "complete" else shown_status(recording)
            found[what] = found.get(what, 0) + 1
    return ", ".join(f"{count} {what}" for what, count in found.items())


def count(value: float) -> str:
    """A count, or a mean of counts: whole numbers as such, others in four digits at least."""
    return f"{value:,.0f}" if value == round(value) or value >= 1000 else f"{value:.4g}"


def counted(found: Counted | None) -> str:
    """Mean and maximum of a counter."""
    return f"{count(found.mean)} / {count(found.max)}" if found else NONE


_NOT_TOLD = "not told"


def share(use: BufferUse) -> str:
    """How much of a buffer was needed."""
    return percent(use.share) if use.share is not None else _NOT_TOLD


def overflow(validity: Validity) -> str:
    """The bits that fired; a dash where the engine does not tell, and not "none" where some runs do not."""
    if validity.overflow is None:
        return NONE
    none = "none" if validity.overflow_told.yes else f"none known: {validity.overflow_told.why_not}"
    return "; ".join(fired(seen) for seen in validity.overflow) or none


def fired(seen: OverflowSeen) -> str:
    """One bit: how often, since when, and whether anything was dropped."""
    kind = "DROPPED" if seen.fatal else "nothing dropped" if seen.fatal is not None else "meaning unknown"
    steps = f"{seen.rows} recorded {'step' if seen.rows == 1 else 'steps'}"
    since = f"{'first at' if seen.first_step_exact else 'by'} step {seen.first_step}"
    return f"{seen.name} ({kind}) at {steps}, {since}"


def count_of(metric: Estimate) -> str:
    """How many of how many; a dash where there is no value."""
    return NONE if isinstance(metric.value, Missing) else f"{metric.value:.0f} of {metric.n}"


def timed_steps(metric: Estimate) -> str:
    """Which states of the timed phase were compared by bits, where none were captured; empty where some were."""
    details = metric.details
    steps = details.timed_steps if isinstance(details, DistinctEnvs | DistinctRuns) else None
    if not steps:
        return ""
    if len(steps) > 2:  # a recorder of others may hash more
        return f"at {len(steps)} steps of the timed phase, {steps[0]} to {steps[-1]}"
    return f"at step{'s' if len(steps) > 1 else ''} {' and '.join(map(str, steps))} of the timed phase"


def timed_notes(metric: Estimate) -> tuple[str, ...]:
    """The same as notes of a cell."""
    return tuple(filter(None, (timed_steps(metric),)))


def repeating(claims: Sequence[bool | None]) -> str:
    """How many groups repeat themselves bit for bit, of those of which it is known."""
    yes, of = claims.count(True), sum(claim is not None for claim in claims)
    return f"{yes} of {plural(of, 'group')} with several runs {'repeats' if 1 in (yes, of) else 'repeat'} bit for bit"


def capturing(metric: Estimate) -> str:
    """What capturing costs a step, and the share of it in which the engine waited for the disk."""
    if isinstance(metric.value, Missing):
        return NONE
    return f"{metric.value:.3g}x; {metric.of(CaptureOverhead).stalled_share:.1%} of the time waiting for the disk"


def amount(metric: Estimate) -> str:
    """Mean of a metric of memory, in three digits."""
    return NONE if isinstance(metric.value, Missing) else scaled(metric.value * metric.metric.per_unit, "B", "#.3g")


def shared(fps: Estimate) -> str:
    """The runs of a throughput with another process on their GPU: "2 of 10 runs: 0, 1"; empty without any."""
    told = fps.of(Throughput).co_tenants or ()
    found = [str(one.run) for one in told if one.presence is Presence.SOME]
    return f"{len(found)} of {plural(len(told), 'run')}: {', '.join(found)}" if found else ""


def model(found: MemoryModel) -> str:
    """The memory model with its standard errors (SE), and where it does not hold."""
    fixed, its_error, each, error_of_each = (
        scaled(bytes_, "B") for bytes_ in (found.fixed, found.fixed_se, found.per_env, found.per_env_se)
    )
    line = f"{fixed} (SE {its_error}) + {each} (SE {error_of_each}) per env, from {len(found.n)} points"
    worst = f"largest error {100 * found.largest_residual:.0f} %, at N = {found.worst_n:,}"
    return f"{line}; {worst}" if found.holds else f"{line}; does NOT hold: {worst}"


def equality(metric: Estimate) -> str:
    """A level of equality with the difference that it rests on; a dash where there is none."""
    if isinstance(metric.value, Missing):
        return NONE
    details = metric.of(Equality)
    worst = details.worst
    if metric.value == EqualityLevel.DIFFERENT and worst is None and details.worst_ulp == 0:
        return "different, though not at the sample step"
    if metric.value == EqualityLevel.BIT_IDENTICAL and details.note:  # there are no state hashes
        return f"{details.text} at the sample step, no other was compared"
    return f"{details.text}, {length(worst.difference)} apart" if worst else details.text


def all_alike(metric: Estimate) -> str:
    """What a metric of distinct environments or runs says where it has found one: alike, or not compared and why."""
    claim = identical(metric)
    if claim.holds is None:
        return f"not compared: {claim.why_not}"
    at = timed_steps(metric)
    return f"all alike, bit by bit{f', {at}' if at else ''}" if claim.yes else at


def doubling(metric: Estimate) -> str:
    """How long a distance takes to double, as the median of the runs; a dash where nothing was fitted."""
    times = [time for time in metric.of(Growth).doubling_time_s if time is not None]
    return f"{median(times):.2g}" if times else NONE


def growth(metric: Estimate) -> str:
    """A rate of growth with the time in which a distance doubles, as the median of the runs; a dash without a rate."""
    times = doubling(metric)
    return mean_sd(metric) if times == NONE else f"{mean_sd(metric)}; doubles in {times} s"


def regime(metric: Estimate) -> str:
    """A published type with how often another sample of as many runs would have it; a dash where there is none."""
    if isinstance(metric.value, Missing):
        return NONE
    number = int(metric.value)
    again = resampled(metric)
    if again is None:
        return str(number)
    share = again.probabilities[number - 1]
    if share == 1 and again.agreement:
        return f"{number} ({alike(again)})"
    return f"{number} (in {'all' if share == 1 else f'{percent(share)} of'} resamples of {again.runs} runs)"


def resampled(metric: Estimate) -> RegimeProbabilities | None:
    """Probabilities of the published types; None where there are none."""
    found = metric.of(PublishedType).resampled
    return None if isinstance(found, Missing) else found


def alike(again: RegimeProbabilities) -> str:
    """In what all runs of a published type are alike: in every bit, or rounded as the type is, with other bits."""
    if again.agreement == "bits":
        return f"all {again.runs} runs bit-identical"
    return f"all {again.runs} runs within 0.01 cm, {again.distinct} distinct"


def another(again: RegimeProbabilities) -> str:
    """What is not excluded where all runs of a published type are alike: that another run differs."""
    how = "in some bit" if again.agreement == "bits" else "by 0.01 cm"
    below = bound(1.0 if again.run_differs_below is None else again.run_differs_below)
    return f"another run differs {how} with a probability below {below} (95 % confidence)"


def floor_of(metric: Estimate) -> Floor:
    """What exchanging whole environments gives; without a figure where the metric has no floor."""
    details = metric.details
    return details.permutation_test if isinstance(details, BetweenRuns | ToReference) else Floor()


EXCHANGED = "first two: W1 [cm]; floor [cm]; p"
"""Title of ``exchanged``."""


def exchanged(metric: Estimate) -> str:
    """W1 of the first two sides, its mean with whole environments exchanged between them at random, and its p-value.

    A dash where there is none.
    """
    found = floor_of(metric).w1
    if isinstance(found, Missing):
        return NONE
    return f"{distance(found.observed)}; {distance(found.floor_mean)}; {found.p_value:.2g}"


def not_exchanged(metric: Estimate) -> str:
    """Why a W1 that is not 0 has no such figures; empty where it has them, or is 0."""
    has_floor = isinstance(metric.details, BetweenRuns | ToReference)
    apart = not isinstance(metric.value, Missing) and metric.value != 0
    return why_missing(floor_of(metric).w1) if has_floor and apart else ""


def why_no_interval(metric: Estimate, otherwise: str) -> str:
    """Why an estimate has no 95 % interval."""
    return why_missing(metric.ci95) or otherwise


CELLS: Mapping[str, Callable[[Estimate], str]] = {
    "capture_slowdown": capturing,
    "distinct_envs": count_of,
    "distinct_runs": count_of,
    "equality_envs": equality,
    "equality_runs": equality,
    "divergence_rate": growth,
    "regime_published": regime,
    "capture_changes_states": count_of,
}
"""How metrics are written whose number alone says too little, by name."""


def cell(metric: Estimate) -> str:
    """An estimate as the text of a table's cell: mean and SD, or what its metric needs; a dash where there is none."""
    return CELLS.get(metric.name, mean_sd)(metric)
