"""The first divergence, by recorded hashes or states, and the first states that differ: where, and both numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import Selection
from gpusimbench.evaluator.diff.numbers import Pairing, number
from gpusimbench.evaluator.diff.result import Divergence, Number, StateDifference
from gpusimbench.evaluator.diff.splits import Agreement
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.metrics.divergence import first_true


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
