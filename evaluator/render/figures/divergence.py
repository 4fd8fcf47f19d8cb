"""Divergence: how far the environments of each run lie apart over time, on a logarithmic axis with exact zero below."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import GrowthFit
from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, open_path, text, title

MAX_POINTS = 160
"""Points of a curve that are drawn; of more, evenly spread ones and the first that is not zero."""

LINE_FROM = 4
"""Points of a curve from which on a line joins them: fewer do not show what lies between."""

_WIDTH, _HEIGHT = 480.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 84.0, 14.0, 12.0, 42.0
_ZERO = 22.0  # height of the strip of exact zeros
_SIDE, _LOW = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _BOTTOM
_FLOOR = _LOW - _ZERO  # of the logarithmic axis
_INSET = 8.0  # of the time axis within the frame, for the marks at its ends
_UNITS = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"), (1e-15, "f"))
_FEW = 20  # points that are marked one by one

Scale = Callable[[float], float]


@dataclass(frozen=True)
class Curve:
    """One run, or several whose distances are the same.

    index    of its colour and dash
    label    for those who point at it
    times    [s], shape [step]
    largest  distance of a body or joint from environment 0 [m or rad], NaN where it is not finite, shape [step]
    rms      over all pairs of environments, likewise
    fit      exponential through `largest`; None where there is none
    """

    index: int
    label: str
    times: NDArray[np.float64]
    largest: NDArray[np.float64]
    rms: NDArray[np.float64]
    fit: GrowthFit | None


def shown_rows(curve: Curve) -> NDArray[np.int64]:
    """The rows of a curve that are drawn, in order."""
    n = len(curve.times)
    if n <= MAX_POINTS:
        return np.arange(n)
    spread = np.linspace(0, n - 1, MAX_POINTS - 1).round().astype(np.int64)
    return np.unique(np.append(spread, np.argmax(curve.largest > 0)))


def divergence_chart(curves: Sequence[Curve], *, onset: float | None, name: str, unit: str = "m") -> str:
    """Largest distance as a line, root mean square as a thin one; empty where nothing is above zero.

    onset  time at which the first bit differs between two environments [s], by hashes; None where that is not known
    name   of the group, for the picture's label
    unit   of the distances: "m" or "rad"
    """
    values = np.concatenate([part for c in curves for part in (c.largest, c.rms)])
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return ""
    low, high = math.log10(positive.min()) - 0.3, math.log10(positive.max()) + 0.3
    last = max(float(c.times[-1]) for c in curves)

    def x(time: float) -> float:
        return _LEFT + _INSET + (_SIDE - 2 * _INSET) * (time / last if last else 0.0)

    def y(value: float) -> float:
        if value <= 0:
            return _LOW - _ZERO / 2
        return _TOP + (_FLOOR - _TOP) * (high - math.log10(value)) / (high - low)

    ticks = [(v, y(v)) for v in plot.log_ticks(10**low, 10**high)]
    rows = [(v, at) for v, at in ticks if at <= _FLOOR - 3]  # below, its label would meet that of the zeros
    columns = [(t, x(t)) for t in plot.ticks(0.0, last)] if last else []
    fitted = next((c for c in curves if c.fit), None)
    return figure(
        _WIDTH,
        _HEIGHT,
        f"Distances between the environments of {name} over time, {len(curves)} curves",
        element("rect", x=_LEFT, y=_FLOOR, width=_SIDE, height=_ZERO, class_="ground"),
        *(element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=at, y2=at, class_="faint") for _, at in rows),
        *(_window(fitted.fit, x) if fitted and fitted.fit else ()),
        plot.frame(_LEFT, _TOP, _SIDE, _LOW - _TOP),
        *(plot.left(_LEFT, at, _amount(v, unit)) for v, at in rows),
        text("exactly 0", _LEFT - 7, _LOW - _ZERO / 2 + 4, class_="end"),
        *(plot.bottom(at, _LOW, plot.tick_label(t)) for t, at in columns),
        text("simulated time [s]", _LEFT + _SIDE / 2, _LOW + 34, class_="mid"),
        text("distance between envs", 14, (_TOP + _LOW) / 2, class_="mid", rotate=-90),
        *(_onset(x(onset)) if onset is not None and onset <= last else ()),
        *(_curve(c, x, y) for c in curves),
        _fit(fitted, x, y) if fitted else "",
    )


def _amount(value: float, unit: str) -> str:
    for size, prefix in _UNITS:
        if value >= size * 0.999:
            return f"{value / size:.3g} {prefix}{unit}"
    return f"{value:.0e} {unit}"


def _curve(curve: Curve, x: Scale, y: Scale) -> str:
    rows = shown_rows(curve)
    times = curve.times[rows]
    parts = [title(curve.label)]
    if len(curve.times) < LINE_FROM:
        for values, hollow in ((curve.rms, True), (curve.largest, False)):
            found = [(x(t), y(v)) for t, v in zip(curve.times, values, strict=True) if np.isfinite(v)]
            parts += [plot.mark(curve.index, *at, hollow=hollow) for at in found]
        return element("g", *parts)
    for values, thin in ((curve.rms[rows], True), (curve.largest[rows], False)):
        places = [(x(t), y(v)) if np.isfinite(v) else None for t, v in zip(times, values, strict=True)]
        if thin:
            parts.append(element("path", d=open_path(places), class_=f"{plot.colour_class(curve.index)} model"))
            continue
        parts.append(plot.path(curve.index, open_path(places)))
        if len(rows) <= _FEW:
            parts += [plot.mark(curve.index, *at) for at in places if at]
    return element("g", *parts)


def _window(fit: GrowthFit, x: Scale) -> list[str]:
    begin, end = x(fit.begin_s), x(fit.end_s)
    return [element("rect", x=begin, y=_TOP, width=max(end - begin, 1.0), height=_FLOOR - _TOP, class_="board")]


def _fit(curve: Curve, x: Scale, y: Scale) -> str:
    # least squares go through the middle of the window's points
    fit = curve.fit
    if fit is None:
        return ""
    inside = (curve.times >= fit.begin_s) & (curve.times <= fit.end_s) & (curve.largest > 0)
    t, logs = curve.times[inside], np.log(curve.largest[inside])
    ends = [(x(at), y(math.exp(float(logs.mean() + fit.rate * (at - t.mean()))))) for at in (fit.begin_s, fit.end_s)]
    said = f"fit of {curve.label}: {fit.rate:.3g} per s, from {fit.begin_s:g} to {fit.end_s:g} s"
    return element("path", title(said), d=open_path(ends), class_="fit")


def _onset(at: float) -> list[str]:
    side = "end" if at > _LEFT + _SIDE * 0.7 else ""
    return [
        element("line", x1=at, x2=at, y1=_TOP, y2=_LOW, class_="lead-out"),
        text("first bit differs", at + (-5 if side else 5), _TOP + 13, class_=f"small over {side}".strip()),
    ]
