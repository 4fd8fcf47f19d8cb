"""Where two recordings part first, by recorded hashes or states, and both numbers of the first states that differ; of
two runs of one program also in actions, or in the program's arrays.

States, actions and arrays are events in the order in which the program came to them. The action of row s of the group
`env` precedes the other arrays of that row, which the simulator returned; an update follows the states that precede it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import Selection
from gpusimbench.evaluator.diff.numbers import Pairing, number
from gpusimbench.evaluator.diff.program_parts import ComparedPart, Kind, Moment, ProgramDifference, is_action
from gpusimbench.evaluator.diff.result import Divergence, FieldDifference, Number, StateDifference
from gpusimbench.evaluator.diff.splits import Agreement
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.metrics.divergence import first_true
from gpusimbench.evaluator.read.digests import Updates
from gpusimbench.evaluator.read.recording import Recording

_RESET, _STEP = Moment(1, 0), Moment(2, 0)
_KINDS = list(Kind)
_Key = tuple[int, int, int]


def first_divergence(
    a: Selection,
    b: Selection,
    ratio: Fraction,
    states: CommonStates,
    seen: Agreement,
    hashed: Agreement | None,
    timed: Agreement | None,
) -> Divergence | None:
    """The first common step at which anything differs; None where nothing does.

    ratio   steps of b for a step of a
    seen    what reading the states found
    hashed  what reading hashes found, which are there for steps whose states are not
    timed   the same of the timed phase's hashes beside these, which decide where nothing else differs
    """
    found = seen
    if hashed and hashed.first and (seen.first is None or hashed.first_step() <= seen.first_step()):
        found = hashed
    if found.first is None and timed:
        found = timed
    if found.first is None:
        return None
    known = timed.steps if timed and found is timed else [*seen.steps, *(hashed.steps if hashed else [])]
    step = found.first_step()
    step_b = int(step * ratio)
    env_a, env_b = envs_of(found.first.pair, a, b)
    return Divergence(
        phase=found.phase,
        step_a=step,
        step_b=step_b,
        time=step * a.recording.configuration.dt,
        after_step=max((s for s in known if s < step), default=None),
        env_a=env_a,
        env_b=env_b,
        envs=found.first.count,
        by_hashes=found is not seen,
        state=state_difference(states, seen.first.row, a, b) if seen.first else None,
        contacts_a=a.contacts(found.phase, step),
        contacts_b=b.contacts(found.phase, step_b),
        begins_episode=a.begins_episode(step, env_a) or b.begins_episode(step_b, env_b),
    )


@dataclass(frozen=True)
class Found:
    """What differs at one step.

    pair    first pair of environments that differs, counted from 0
    pairs   how many differ
    fields  names of the fields that differ in any pair
    items   names of the bodies or joints that differ in the first
    number  the first pair of numbers that differ: lowest pair of environments, then field, item and component
    """

    pair: int
    pairs: int
    fields: tuple[str, ...]
    items: tuple[str, ...]
    number: Number


def locate(sides: Sequence[tuple[Pairing, NDArray[Any], NDArray[Any]]]) -> Found:
    """Where the numbers of one step differ; something must.

    sides  of each field how it is compared, and its numbers on both sides, [1, env, item, component]
    """
    masks = [how.differs(a, b) for how, a, b in sides]
    pairs = np.stack([mask[0].any(axis=(1, 2)) for mask in masks])
    pair = int(np.argmax(pairs.any(axis=0)))
    items: dict[str, None] = {}
    for (how, _, _), mask in zip(sides, masks, strict=True):
        items |= dict.fromkeys(how.field.items[i] for i in np.flatnonzero(mask[0, pair].any(axis=-1)))
    index = int(np.argmax(pairs[:, pair]))
    at = first_true(masks[index][0, pair])
    assert at is not None  # the pair differs in this field
    return Found(
        pair=pair,
        pairs=int(np.count_nonzero(pairs.any(axis=0))),
        fields=tuple(how.field.name for (how, _, _), mask in zip(sides, masks, strict=True) if mask.any()),
        items=tuple(items),
        number=number(*sides[index], (0, pair, *at)),
    )


def state_difference(states: CommonStates, row: int, a: Selection, b: Selection) -> StateDifference:
    """What differs at a common step, of which something does; `row` counts the common steps from 0."""
    rows = slice(row, row + 1)
    there = [index for index in range(len(states.fields)) if states.has(index, rows).all()]
    found = locate([(states.fields[index], *states.read(index, rows)) for index in there])
    step = int(states.steps_a[row])
    env_a, env_b = envs_of(found.pair, a, b)
    return StateDifference(
        step=step,
        time=step * a.recording.configuration.dt,
        env_a=env_a,
        env_b=env_b,
        envs=found.pairs,
        fields=found.fields,
        items=found.items,
        number=found.number,
    )


def envs_of(pair: int, a: Selection, b: Selection) -> tuple[int, int]:
    """Numbers of the environments of a pair; a single one is in all pairs."""
    return a.envs[min(pair, len(a.envs) - 1)], b.envs[min(pair, len(b.envs) - 1)]


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
