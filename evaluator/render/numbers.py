"""Numbers as people read them, and cells of values: an estimate, a count, a reason why there is no value."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from decimal import Decimal

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import EMPTY, Cell, Tone
from gpusimbench.evaluator.render.document import NONE as NONE
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.metric import Estimate


def distance(value: float) -> str:
    """A distance in cm: three decimals, and never "0.000" for what is not zero."""
    if value == 0:
        return "0"
    return f"{value:.3f}" if abs(value) >= 0.0005 else f"{value:.1e}"


def distance_bound(value: float, *, upper: bool) -> str:
    """A bound of a distance in cm, as `distance`, but rounded up if it is an upper bound, and down if it is a lower."""
    shown = Decimal(distance(value))
    last = Decimal((0, (1,), int(shown.as_tuple().exponent)))  # one unit of the last digit
    if float(shown) < value if upper else float(shown) > value:
        shown += last if upper else -last
    return distance(float(shown))


def figure(value: float, unit: str) -> str:
    """A value in its unit's usual precision, and never zero for what is not."""
    if unit == "cm":
        return distance(value)
    if unit == "env-steps/s":
        return f"{value:,.0f}" if value == 0 or abs(value) >= 0.5 else f"{value:.1g}"
    if unit == "s":
        return seconds(value)
    if unit == "rad":
        return f"{value:.3g}"
    if unit in ("GB", "MB"):
        return f"{value:.2f}" if value == 0 or abs(value) >= 0.005 else f"{value:.1g}"
    if value == round(value):
        return f"{value:.0f}"
    return f"{value:.2f}" if abs(value) >= 0.005 else f"{value:.1g}"


def mean_sd(metric: Estimate) -> str:
    """Mean and SD as published tables print them, marked if a bound or of a sample; a dash where there is no value."""
    if isinstance(metric.value, Missing):
        return NONE
    mean = figure(metric.value, metric.unit)
    if metric.exactness == "certified":  # W1 alone, in cm
        mean = f"<= {distance_bound(metric.value, upper=True)}"
    elif metric.exactness == "sampled":
        mean = f"~ {mean}"
    return mean if metric.sd is None else f"{mean} ± {figure(metric.sd, metric.unit)}"


def interval(metric: Estimate) -> str:
    """The 95 % interval, a dash where there is none."""
    if isinstance(metric.value, Missing) or not metric.ci95:
        return NONE
    return bounds(metric.ci95, lambda end: figure(end, metric.unit))


def bounds(ends: Iterable[float], shown: Callable[[float], str]) -> str:
    """An interval from its ends, as they are shown: numbers with thousands hold commas, so "to" stands between them."""
    return f"[{' to '.join(map(shown, ends))}]"


def ulps(count: int | None, *, signs_differ: bool = False) -> str:
    """A distance in units in the last place; of numbers of opposite signs it says nothing, and the signs do."""
    if count is None:
        return NONE
    if signs_differ:
        return "signs differ"
    return f"{count:,}" if count < 10**7 else f"{count:.2e}"


_MULTIPLES = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "µrad": 1e-6, "nrad": 1e-9},
    "B": {"GB": 1e9, "MB": 1e6, "kB": 1e3, "B": 1.0},
}
"""By unit, those that its values are written in, the largest first."""


def scaled(value: float, unit: str, digits: str = ".3g") -> str:
    """A value in m, rad or B, written in the multiple of the unit in which it is 1 or more in three digits."""
    of_unit = _MULTIPLES[unit].items()
    name, size = next(((name, size) for name, size in of_unit if abs(value) >= 0.9995 * size), (unit, 0.0))
    if not size:
        return f"{value:.2g} {unit}"
    amount = value / size
    return f"{format(amount, ',.0f' if 999.5 <= abs(amount) < 1e6 else digits).rstrip('.')} {name}"


def length(metres: float | None) -> str:
    """A distance in the unit that suits its size; a dash where there is none."""
    if metres is None:
        return NONE
    return scaled(metres, "m") if metres else "0"


_LEAST_S = 0.001


def seconds(value: float) -> str:
    """A time [s], or a difference of times, in as many digits as matter; less than a nanosecond is rounding."""
    if abs(value) < 1e-9:
        return "0"
    if abs(value) < _LEAST_S:
        return f"< {_LEAST_S}" if value > 0 else f"> -{_LEAST_S}"
    if abs(value) >= 99.5:
        return f"{value:.0f}"
    return f"{value:.2g}" if abs(value) >= 0.01 else f"{value:.1g}"


def estimate(found: Estimate, *notes: str, tone: Tone = Tone.PLAIN) -> Cell:
    """Mean and SD of an estimate with its 95 % interval, or the reason why there is none."""
    if isinstance(found.value, Missing):
        return missing(found.value)
    return Cell(
        mean_sd(found),
        float(found.value),
        found.ci95 or None,
        interval(found) if found.ci95 else "",
        tuple(note for note in notes if note),
        tone,
    )


def ranked(fps: Estimate) -> Cell:
    """The throughput by which a group is ranked: the estimate, or the range of the slowest outcome."""
    speeds = fps.of(Throughput).speeds
    if speeds is None:
        return estimate(fps)
    slowest = speeds.outcomes[0]
    return Cell(slowest.said, slowest.low, notes=(f"the slowest of {len(speeds.outcomes)} outcomes",))


def missing(why: Missing | str) -> Cell:
    """No value, and the reason."""
    reason = why.reason if isinstance(why, Missing) else why
    return Cell(EMPTY.text, notes=(reason,) if reason else (), tone=Tone.QUIET)
