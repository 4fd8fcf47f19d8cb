"""What is said of a comparison: its numbers, and which part of a program's run differs first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from gpusimbench.evaluator.diff.program_parts import ComparedPart, Kind, ProgramDifference
from gpusimbench.evaluator.diff.result import Change, Number
from gpusimbench.evaluator.metrics.divergence import opposite_signs
from gpusimbench.evaluator.render.document import Cell, Section, table
from gpusimbench.evaluator.render.numbers import NONE, length, ulps
from gpusimbench.schemas.fields import DIMENSIONLESS, UNKNOWN
from gpusimbench.schemas.text import cut, few, plural

_ARRAYS, _NAMES, _LAST = 3, 8, 100

WITHOUT_UNIT = ("unit quaternion", UNKNOWN, DIMENSIONLESS)
"""Units that are not written behind a number."""

_NAME = 60
_BARS = "▁▂▃▄▅▆▇█"


def sentence(found: ProgramDifference, first: ComparedPart, who: str, dt: float) -> str:
    """The verdict: "The runs first differ at update 12 of gradient, after step 640; until then, batch is the same".

    first  the part that differs first
    who    the two runs
    dt     time of a step [s]
    """
    known = [part for part in found.parts if part.name in found.same_before]
    names = [part.name for part in known if part.kind is Kind.PROGRAM]
    if any(part.kind is Kind.ACTION for part in known):
        names.append("the actions")
    if any(part.kind is Kind.SIMULATOR for part in known):
        names.append("all that the simulator returned")
    until = f"until then, {_listed(names)} {'is' if len(names) == 1 else 'are'} the same"
    return f"{who} first differ {where(first, dt)}; {until if names else 'nothing that was recorded precedes it'}."


def _listed(parts: list[str]) -> str:
    if len(parts) > _NAMES:
        return names(parts, _NAMES)
    return " and ".join(filter(None, (", ".join(map(name, parts[:-1])), *parts[-1:])))


def where(part: ComparedPart, dt: float) -> str:
    """Where a part differs first: "at update 12 of gradient (gradient/w), after step 640 (3.2 s)".

    part  one that differs
    dt    time of a step [s]
    """
    if part.kind is not Kind.PROGRAM:
        return f"at {_when(part, dt)} in {name(part.name)}"
    what = part.reason or names(part.arrays, _ARRAYS)
    of = name(part.name)
    return f"at update {part.update} of {of}{'' if what == of else f' ({what})'}, {_when(part, dt)}"


def _when(part: ComparedPart, dt: float) -> str:
    assert part.first is not None
    step = part.first.states - 1
    time = f"step {step} ({step * dt:g} s)"
    if part.kind is not Kind.PROGRAM:
        return time
    return f"after {time}" if step >= 0 else "before the first state"


def pairs(found: ProgramDifference) -> list[tuple[str, str]]:
    """Facts: which arrays were compared, and the last event before the first difference."""
    arrays = [part for part in found.parts if part.kind is Kind.PROGRAM]
    counts = [f"{name(part.name)} ({plural(min(part.count_a, part.count_b), 'update')})" for part in arrays]
    said = [("arrays", names(counts, _NAMES))] if counts else []
    return [*said, ("last equal", cut(found.last_same, _LAST))] if found.last_same else said


def section(found: ProgramDifference, dt: float) -> Section:
    """All arrays, and the state fields that differ, in the order in which they do."""
    shown = [part for part in found.parts if part.first is not None or part.kind is Kind.PROGRAM]
    last = max((part.first.states for part in shown if part.first), default=0) + 1
    ordered = sorted(shown, key=lambda part: (part.first.states, part.first.order) if part.first else (last, 0))
    rows = [
        [
            name(part.name),
            part.kind.value,
            *(Cell(f"{count:,}", count) for count in (part.count_a, part.count_b)),
            NONE if part.update is None else str(part.update),
            _when(part, dt) if part.first else NONE,
        ]
        for part in ordered
    ]
    made = table("program", "", ("part", "of", "in a", "in b", "update", "first difference"), rows)
    same = len(found.parts) - len(shown)
    return Section(
        "program", "parts of the program", (made,), f"{plural(same, 'other state field')} the same throughout"
    )


def amount(value: float | None, unit: str) -> str:
    """A difference with its unit; lengths in the unit that suits them."""
    if value is None or unit == "m":
        return length(value)
    return "0" if value == 0 else f"{value:.3g} {'' if unit in WITHOUT_UNIT else unit}".rstrip()


def in_ulps(number: Number, *, named: bool = False) -> str:
    """How far two numbers are apart in units in the last place; empty where nothing tells it.

    Where one is zero or the signs differ, the count is of all numbers down to zero, so this is said in its place.

    named  the sentence names both; otherwise they are named here where they are not counted
    """
    if number.ulp is None:
        return ""
    a, b = float(number.a), float(number.b)
    said = "one is zero" if (a == 0) != (b == 0) else ""
    if not said and opposite_signs(np.array([a]), np.array([b]))[0]:
        said = "the signs differ"
    if said:
        return said if named else f"{said} ({number.a} and {number.b})"
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
