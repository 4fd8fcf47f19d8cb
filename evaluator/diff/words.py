"""Numbers of a comparison as people read them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from gpusimbench.evaluator.diff.result import Change, Number
from gpusimbench.evaluator.metrics.divergence import opposite_signs
from gpusimbench.evaluator.render.numbers import NONE, ulps
from gpusimbench.schemas.fields import DIMENSIONLESS, UNKNOWN
from gpusimbench.schemas.text import cut, few

WITHOUT_UNIT = ("unit quaternion", UNKNOWN, DIMENSIONLESS)
"""Units that are not written behind a number."""

_NAME = 60
_BARS = "▁▂▃▄▅▆▇█"


def length(metres: float | None) -> str:
    """A distance in the unit that suits its size; a dash where there is none."""
    if metres is None:
        return NONE
    if metres == 0:
        return "0"
    for unit, size in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)):
        if metres >= 0.9995 * size:  # which rounds up to 1
            return f"{metres / size:.3g} {unit}" if metres < 1e4 else f"{metres:.3g} m"
    return f"{metres:.2g} m"


def amount(value: float | None, unit: str) -> str:
    """A difference with its unit; lengths in the unit that suits them."""
    if value is None or unit == "m":
        return length(value)
    return "0" if value == 0 else f"{value:.3g} {'' if unit in WITHOUT_UNIT else unit}".rstrip()


def in_ulps(number: Number, *, named: bool = False) -> str:
    """How far two numbers are apart in units in the last place; empty where nothing tells it.

    named  the sentence names both; otherwise they are named here where the signs differ
    """
    if number.ulp is None:
        return ""
    if opposite_signs(*(np.array([float(text)]) for text in (number.a, number.b)))[0]:
        return f"the signs differ{'' if named else f' ({number.a} and {number.b})'}"
    return f"{ulps(number.ulp)} ULP"


def counted(count: int, what: str) -> str:
    """A number of things: "1 env", "2 envs"."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def differ(count: int) -> str:
    """How many differ: "1 differs", "2 differ"."""
    return f"{count:,} differ{'s' if count == 1 else ''}"


def ranges(numbers: Sequence[int]) -> str:
    """Increasing whole numbers, shortened: "0-3, 7"."""
    parts = []
    for _, run in groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0]):
        found = [number for _, number in run]
        parts.append(str(found[0]) if len(found) == 1 else f"{found[0]}-{found[-1]}")
    return ", ".join(parts)


def name(text: str) -> str:
    """A name out of a recording, cut where it is longer than a line has room for."""
    return cut(text, _NAME)


def names(parts: Sequence[str], most: int) -> str:
    """The first of some names, and how many more there are."""
    return few([name(part) for part in parts], most)


def changes(found: Sequence[Change], most: int) -> str:
    """A number over the steps: "1 from step 0, 26 from step 2"; the first changes, and the last."""
    told = [f"{change.count:,} from step {change.step}" for change in found]
    if len(told) > most:
        left_out = len(told) - most
        told = [*told[: most - 1], f"({left_out:,} changes)", told[-1]]
    return ", ".join(told)


def sparkline(levels: Sequence[float | None], width: int) -> str:
    """Values from 0 to 1 as bars, the largest of those that share a column; a space where there is none."""
    columns = min(width, len(levels))
    drawn = []
    for column in range(columns):
        begin, end = column * len(levels) // columns, (column + 1) * len(levels) // columns
        known = [level for level in levels[begin:end] if level is not None]
        drawn.append(_BARS[min(len(_BARS) - 1, int(max(known) * len(_BARS)))] if known else " ")
    return "".join(drawn)
