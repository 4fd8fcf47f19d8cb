"""How a difference grows, as text."""

from __future__ import annotations

import math

from rich.console import Console

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.result import Difference, Growth
from gpusimbench.evaluator.diff.text_numbers import print_numbers
from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.text import printable

_ROWS, _WIDTH = 6, 60
_FEWEST = 8  # steps that are worth a sparkline


def print_growth(console: Console, found: Difference) -> None:
    """Distances of bodies at some of the steps, a sparkline of all, and the fit."""
    growth = found.growth
    if isinstance(growth, Missing):
        console.print(printable(f"distances of bodies: none, {growth.reason}"))
        console.print()
        return
    console.print(printable(f"distances of bodies ({', '.join(growth.groups)})"), style="bold")
    rows = []
    for row in _chosen(growth):
        columns = (growth.median_planar, growth.max_planar, growth.median_spatial, growth.max_spatial)
        rows.append((f"{growth.times[row]:g}", *(words.length(c[row]) for c in columns)))
    print_numbers(console, ("t [s]", "median, planar", "max, planar", "median, 3D", "max, 3D"), rows)
    for line in _lines(growth):
        console.print(printable(f"  {line}"))
    console.print()


def _largest(growth: Growth) -> tuple[float | None, ...]:
    return growth.max_spatial if any(d is not None for d in growth.max_spatial) else growth.max_planar


def _chosen(growth: Growth) -> list[int]:
    # from the first distance on, evenly
    largest = _largest(growth)
    begin = next((row for row, d in enumerate(largest) if d), 0)
    last = len(largest) - 1
    count = min(_ROWS, last - begin + 1)
    return sorted({begin + round(i * (last - begin) / max(1, count - 1)) for i in range(count)})


def _lines(growth: Growth) -> list[str]:
    lines = []
    levels = [math.log10(d) if d else None for d in _largest(growth)]
    known = [level for level in levels if level is not None]
    if len(levels) >= _FEWEST and known:
        low, span = min(known), max(max(known) - min(known), 1e-9)
        bars = words.sparkline([None if v is None else (v - low) / span for v in levels], _WIDTH)
        lines.append(f"max, log scale: |{bars}| {growth.times[0]:g} to {growth.times[-1]:g} s")
    for size, when in (("1 mm", growth.to_1mm), ("1 cm", growth.to_1cm)):
        lines.append(f"{size}: {'never' if when is None else f'first recorded at {when:g} s'}")
    fit = growth.fit
    if isinstance(fit, Missing) or fit.why_no_rate:
        lines.append(f"growth rate: none; {fit.reason if isinstance(fit, Missing) else fit.why_no_rate}")
    else:
        doubling = "" if fit.doubling_time is None else f", doubling every {fit.doubling_time * 1000:.3g} ms"
        lines.append(
            f"growth rate: {fit.rate:.3g} /s{doubling}; log-linear fit of the max through {fit.points} steps from "
            f"{fit.begin:g} to {fit.end:g} s (first difference to 1 mm), R2 {fit.r_squared:.3f}"
        )
    if growth.not_finite_from is not None:
        lines.append(f"positions that are not finite, first at step {growth.not_finite_from}, are left out")
    return lines
