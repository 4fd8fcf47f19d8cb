"""The first recorded states that differ: environment, field, body, component, and both numbers."""

from __future__ import annotations

import numpy as np

from gpusimbench.evaluator.diff.numbers import number
from gpusimbench.evaluator.diff.result import StateDifference
from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.metrics.divergence import first_true


def state_difference(states: CommonStates, row: int, a: Selection, b: Selection) -> StateDifference:
    """What differs at a common step, of which something does; `row` counts the common steps from 0."""
    rows = slice(row, row + 1)
    there = [index for index in range(len(states.fields)) if states.has(index, rows).all()]
    fields = [states.fields[index] for index in there]
    masks = [how.differs(*states.read(index, rows)) for index, how in zip(there, fields, strict=True)]
    pairs = np.stack([mask[0].any(axis=(1, 2)) for mask in masks])
    pair = int(np.argmax(pairs.any(axis=0)))
    items: dict[str, None] = {}
    for how, mask in zip(fields, masks, strict=True):
        items |= dict.fromkeys(how.field.items[i] for i in np.flatnonzero(mask[0, pair].any(axis=-1)))
    index = int(np.argmax(pairs[:, pair]))
    at = first_true(masks[index][0, pair])
    assert at is not None  # the pair differs in this field
    step = int(states.steps_a[row])
    env_a, env_b = envs_of(pair, a, b)
    return StateDifference(
        step=step,
        time=step * a.recording.configuration.dt,
        env_a=env_a,
        env_b=env_b,
        envs=int(np.count_nonzero(pairs.any(axis=0))),
        fields=tuple(how.field.name for how, mask in zip(fields, masks, strict=True) if mask.any()),
        items=tuple(items),
        number=number(fields[index], *states.read(there[index], rows), (0, pair, *at)),
    )


def envs_of(pair: int, a: Selection, b: Selection) -> tuple[int, int]:
    """Numbers of the environments of a pair; a single one is in all pairs."""
    return a.envs[min(pair, len(a.envs) - 1)], b.envs[min(pair, len(b.envs) - 1)]
