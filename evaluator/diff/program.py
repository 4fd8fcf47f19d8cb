"""Where two runs of one program part first: in what the simulator returned, in actions, or in the program's arrays.

States, actions and arrays are events in the order in which the program came to them. The action of row s of the group
`env` precedes the other arrays of that row, which the simulator returned; an update follows the states that precede it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.diff.program_parts import ComparedPart, Kind, Moment, ProgramDifference, is_action
from gpusimbench.evaluator.diff.result import Divergence, FieldDifference
from gpusimbench.evaluator.read.digests import Updates
from gpusimbench.evaluator.read.recording import Recording

_RESET, _STEP = Moment(1, 0), Moment(2, 0)
_KINDS = list(Kind)


def compare_program(
    a: Recording, b: Recording, fields: Sequence[FieldDifference], first: Divergence | None
) -> ProgramDifference | None:
    """What differs first; None where neither recording has hashes of its program.

    fields  what became of the states
    first   where states or their hashes differ first
    """
    of_a, of_b = a.program, b.program
    if not of_a and not of_b:
        return None
    names = sorted(of_a.keys() & of_b.keys())
    of_arrays = (_of_arrays(name, of_a[name], of_b[name]) for name in names)
    parts = (*of_arrays, *_of_states(fields, first, _states(a), _states(b)))
    differing = [(_key(part.kind, part.first), part) for part in parts if part.first is not None]
    earliest = min(differing, key=lambda pair: pair[0], default=None)
    return ProgramDifference(
        parts=parts,
        first=earliest[1] if earliest else None,
        same_before=tuple(
            part.name
            for part in parts
            if earliest is None or (part is not earliest[1] and _key(part.kind, part.begin) < earliest[0])
        ),
        last_same=_last_same(of_a, names, parts, *earliest) if earliest else "",
        only_a=tuple(sorted(of_a.keys() - of_b.keys())),
        only_b=tuple(sorted(of_b.keys() - of_a.keys())),
    )


_Key = tuple[int, int, int]


def _key(kind: Kind, moment: Moment) -> _Key:
    return moment.states, _KINDS.index(kind), moment.order


def _states(recording: Recording) -> int:
    hashes = recording.fingerprints("capture")
    return 0 if hashes is None else len(hashes.steps)


def _of_states(
    fields: Sequence[FieldDifference], first: Divergence | None, count_a: int, count_b: int
) -> Iterator[ComparedPart]:
    # a capture's step is found by hashes where no state of it was recorded
    if first is not None and all(field.first_step != first.step_a for field in fields):
        yield ComparedPart(Kind.SIMULATOR, "states", _RESET, count_a, count_b, Moment(first.step_a + 1, 0))
    for field in fields:
        kind, begin = (
            (Kind.ACTION, _STEP) if is_action(field.field) else (Kind.SIMULATOR, _RESET)
        )  # no action precedes the reset
        at = None if field.first_step is None else Moment(field.first_step + 1, 0)
        yield ComparedPart(kind, field.field, begin, count_a, count_b, at)


def _of_arrays(name: str, a: Updates, b: Updates) -> ComparedPart:
    counts = len(a.order), len(b.order)
    begin = min(_moment(a, 0), _moment(b, 0), key=lambda moment: (moment.states, moment.order))
    same = ComparedPart(Kind.PROGRAM, name, begin, *counts)
    for update in range(min(counts)):
        if a.states[update] != b.states[update]:
            early = min(a, b, key=lambda side: int(side.states[update]))
            reason = f"it follows {a.states[update]} states in a, {b.states[update]} in b"
            return ComparedPart(Kind.PROGRAM, name, begin, *counts, _moment(early, update), update, reason=reason)
        if arrays := _differing(a, b, update):
            return ComparedPart(Kind.PROGRAM, name, begin, *counts, _moment(a, update), update, arrays)
    if counts[0] == counts[1]:
        return same
    longer, update = max(a, b, key=lambda side: len(side.order)), min(counts)
    reason = f"a has {counts[0]} updates of it, b has {counts[1]}"
    return ComparedPart(Kind.PROGRAM, name, begin, *counts, _moment(longer, update), update, reason=reason)


def _moment(updates: Updates, update: int) -> Moment:
    return Moment(int(updates.states[update]), int(updates.order[update]))


def _differing(a: Updates, b: Updates, update: int) -> tuple[str, ...]:
    """Names of the arrays that differ, also in dtype or shape."""
    of_a, of_b = (list(zip(side.arrays[update], side.hashes[update].tolist(), strict=True)) for side in (a, b))
    if of_a == of_b:
        return ()
    either = set(of_a) ^ set(of_b)
    differing = [pair for pair in (*of_a, *of_b) if pair in either]
    return tuple(dict.fromkeys(array.split(" ", 2)[-1] for array, _ in differing)) or ("the order of its arrays",)


def _last_same(
    updates: dict[str, Updates], names: Sequence[str], parts: Sequence[ComparedPart], key: _Key, earliest: ComparedPart
) -> str:
    """The last event before the first difference, in words; empty where there is none."""
    found: list[tuple[_Key, str]] = []
    step = key[0] - 1 if earliest.kind is Kind.PROGRAM else key[0] - 2
    if step >= 0:
        found.append((_key(Kind.SIMULATOR, Moment(step + 1, 0)), f"the states of step {step}"))
    if earliest.kind is Kind.SIMULATOR and any(part.kind is Kind.ACTION for part in parts) and key[0] > _RESET.states:
        found.append((_key(Kind.ACTION, Moment(key[0], 0)), f"the actions of step {key[0] - 1}"))
    for name in names:
        for update in range(len(updates[name].order)):
            at = _key(Kind.PROGRAM, _moment(updates[name], update))
            if at < key:
                found.append((at, f"{name} at update {update}"))
    return max(found)[1] if found else ""
