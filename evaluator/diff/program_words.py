"""What is said of two runs of one program: which part differs first, and which parts were the same until then."""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.program_parts import Kind, Part, ProgramDifference
from gpusimbench.evaluator.render.document import NONE, Cell, Section, table
from gpusimbench.schemas.text import cut, plural

_ARRAYS, _NAMES, _LAST = 3, 8, 100


def sentence(found: ProgramDifference, first: Part, who: str, dt: float) -> str:
    """The verdict: "The runs part at update 12 of gradient, after step 640; until then, batch is the same".

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
    return f"{who} part {where(first, dt)}; {until if names else 'nothing that was recorded precedes it'}."


def _listed(names: list[str]) -> str:
    if len(names) > _NAMES:
        return words.names(names, _NAMES)
    return " and ".join(filter(None, (", ".join(map(words.name, names[:-1])), *names[-1:])))


def where(part: Part, dt: float) -> str:
    """Where a part differs first: "at update 12 of gradient (gradient/w), after step 640 (3.2 s)".

    part  one that differs
    dt    time of a step [s]
    """
    if part.kind is not Kind.PROGRAM:
        return f"at {_when(part, dt)} in {words.name(part.name)}"
    what = part.reason or words.names(part.arrays, _ARRAYS)
    of = words.name(part.name)
    return f"at update {part.update} of {of}{'' if what == of else f' ({what})'}, {_when(part, dt)}"


def _when(part: Part, dt: float) -> str:
    assert part.first is not None
    step = part.first.states - 1
    time = f"step {step} ({step * dt:g} s)"
    if part.kind is not Kind.PROGRAM:
        return time
    return f"after {time}" if step >= 0 else "before the first state"


def pairs(found: ProgramDifference) -> list[tuple[str, str]]:
    """Facts: which arrays were compared, and the last event before the first difference."""
    arrays = [part for part in found.parts if part.kind is Kind.PROGRAM]
    counts = [f"{words.name(part.name)} ({plural(min(part.count_a, part.count_b), 'update')})" for part in arrays]
    said = [("arrays", words.names(counts, _NAMES))] if counts else []
    return [*said, ("last equal", cut(found.last_same, _LAST))] if found.last_same else said


def section(found: ProgramDifference, dt: float) -> Section:
    """All arrays, and the state fields that differ, in the order in which they do."""
    shown = [part for part in found.parts if part.first is not None or part.kind is Kind.PROGRAM]
    last = max((part.first.states for part in shown if part.first), default=0) + 1
    ordered = sorted(shown, key=lambda part: (part.first.states, part.first.order) if part.first else (last, 0))
    rows = [
        [
            words.name(part.name),
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
