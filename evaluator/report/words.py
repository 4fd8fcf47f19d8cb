"""Short words for what a table's cell has room for."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.metrics.levels import Level
from gpusimbench.evaluator.metrics.memory_model import MemoryModel
from gpusimbench.evaluator.render.numbers import NONE, distance
from gpusimbench.evaluator.results.claims import identical
from gpusimbench.evaluator.results.fidelity import Fidelity, Verdict
from gpusimbench.evaluator.results.result import Metric
from gpusimbench.evaluator.results.validity import BufferUse, Counted, OverflowSeen, Validity
from gpusimbench.evaluator.runs.groups import Described, Group, shown_status

BYTES = {"GB": 1e9, "MB": 1e6}


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
    return f"{use.share:.0%}" if use.share is not None else _NOT_TOLD


def buffers(validity: Validity) -> str:
    """The buffers by name, each with the share that was needed; the number of those of which nothing shows that."""
    shown = [f"{use.buffer.name} {share(use)}" for use in validity.buffers if use.share is not None]
    if untold := len(validity.buffers) - len(shown):
        shown.append(f"{untold} {_NOT_TOLD}")
    return ", ".join(shown) or NONE


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
    since = f"{'by' if seen.spread else 'first at'} step {seen.first_step}"
    return f"{seen.name} ({kind}) at {steps}, {since}"


def preparation(metrics: Mapping[str, Metric]) -> str:
    """Seconds of build and compilation."""
    values = [metrics[name].value for name in ("build_time", "compile_time")]
    return NONE if values == [None, None] else "; ".join(NONE if v is None else seconds(v) for v in values)


def capturing(metrics: Mapping[str, Metric]) -> str:
    """What capturing costs a step, and the share of it in which the engine waited for the disk."""
    found = metrics["capture_slowdown"]
    return NONE if found.value is None else f"{found.value:.3g}; {found.extra['stalled_share']:.1%}"


def seconds(value: float) -> str:
    """A time in as many digits as matter."""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}" if value >= 0.01 else "0"


def size(value: float, digits: str = ".3g") -> str:
    """An amount of memory [bytes] in a fitting decimal unit."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if abs(value) >= scale:
            return f"{format(value / scale, digits).rstrip('.')} {unit}"
    return f"{value:.0f} B"


def amount(metric: Metric) -> str:
    """Mean of a metric of memory, in three digits."""
    return NONE if metric.value is None else size(metric.value * BYTES[metric.unit], "#.3g")


def shared(fps: Metric) -> str:
    """The runs of a throughput with another process on their GPU: "2 of 10 runs: 0, 1"; empty without any."""
    told = fps.extra.get("co_tenants") or []
    found = [str(one["run"]) for one in told if one["presence"] == Presence.SOME.value]
    return f"{len(found)} of {len(told)} runs: {', '.join(found)}" if found else ""


def model(found: MemoryModel) -> str:
    """The memory model with its errors, and where it does not hold."""
    line = (
        f"{size(found.fixed)} (± {size(found.fixed_se)}) + {size(found.per_env)} (± {size(found.per_env_se)}) per env, "
        f"from {len(found.n)} points"
    )
    worst = f"{found.largest_residual:.0%} at N = {found.worst_n:,}"
    return f"{line}; off by at most {worst}" if found.holds else f"{line}; does NOT hold: off by {worst}"


def shortened(text: str, length: int = 160) -> str:
    """A reason for a table; the whole of it stands in JSON and HTML."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


def equality(metric: Metric) -> str:
    """A level of equality with the difference that it rests on; a dash where there is none."""
    if metric.value is None:
        return NONE
    worst = metric.extra["worst"]
    if metric.value == Level.DIFFERENT and worst is None and metric.extra["worst_ulp"] == 0:
        return "different, though not at the sample step"
    if metric.value == Level.BIT_IDENTICAL and metric.extra["note"]:  # there are no state hashes
        return f"{metric.extra['text']} at the sample step, no other was compared"
    return f"{metric.extra['text']}, {_length(worst['difference'])} apart" if worst else str(metric.extra["text"])


def all_alike(metric: Metric) -> str:
    """What a metric of distinct environments or runs says where it has found one: alike, or not compared and why."""
    claim = identical(metric)
    if claim.holds is None:
        return f"not compared: {claim.why_not}"
    return "all alike, bit by bit" if claim.yes else ""


def _length(metres: float) -> str:
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6)):
        if metres >= size:
            return f"{metres / size:.3g} {unit}"
    return f"{metres * 1e9:.3g} nm"


def mechanics(fidelity: Fidelity) -> str:
    """How many of the checks that mechanics demands and that could be made hold; a dash where none could."""
    held, broken = len(fidelity.of(Verdict.HELD)), len(fidelity.of(Verdict.BROKEN))
    return f"{held} of {held + broken}" if held + broken else NONE


def doubling(metric: Metric) -> str:
    """How long a distance takes to double, as the median of the runs; a dash where nothing was fitted."""
    times = [time for time in metric.extra.get("doubling_time_s", ()) if time is not None]
    return f"{median(times):.2g}" if times else NONE


def regime(metric: Metric) -> str:
    """A published type with how often another sample of as many runs would have it; a dash where there is none."""
    if metric.value is None:
        return NONE
    number = int(metric.value)
    again = metric.extra.get("probabilities")
    if not again:
        return str(number)
    share, runs = again[number - 1], metric.extra["runs"]
    if share == 1 and metric.extra["agreement"]:
        return f"{number} ({alike(metric)})"
    return f"{number} (in {'all' if share == 1 else format(share, '.0%') + ' of'} resamples of {runs} runs)"


def alike(metric: Metric) -> str:
    """In what all runs of a published type are alike: in every bit, or rounded as the type is, with other bits."""
    runs, distinct = metric.extra["runs"], metric.extra["distinct"]
    if metric.extra["agreement"] == "bits":
        return f"all {runs} runs bit-identical"
    return f"all {runs} runs within 0.01 cm, {distinct} distinct"


def another(metric: Metric) -> str:
    """What is not excluded where all runs of a published type are alike: that another run differs."""
    how = "in some bit" if metric.extra["agreement"] == "bits" else "by 0.01 cm"
    return f"another run differs {how} with a probability below {metric.extra['run_differs_below']:.0%} (95 %)"


EXCHANGED = "first two: W1; floor; p"
"""Title of ``exchanged``."""


def exchanged(metric: Metric) -> str:
    """W1 of the first two sides, its mean with whole environments exchanged between them at random, and its p-value.

    A dash where there is none.
    """
    found = metric.extra.get("floor", {})
    if "p_value" not in found:
        return NONE
    return f"{distance(found['observed_cm'])}; {distance(found['floor_mean_cm'])}; {found['p_value']:.2g}"


def not_exchanged(metric: Metric) -> str:
    """Why a W1 that is not 0 has no such figures; empty where it has them, or is 0."""
    return str(metric.extra.get("floor", {}).get("why_not", "")) if metric.value else ""
