"""The first recorded states that differ: environment, field, body, component, and both numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evaluator.diff.numbers import number
from evaluator.diff.result import StateDifference
from evaluator.diff.selection import Selection
from evaluator.diff.states import CommonStates
from evaluator.metrics.divergence import first_true


def state_difference(states: CommonStates, row: int, a: Selection, b: Selection) -> StateDifference:
    """What differs at a common step, of which something does; `row` counts the common steps from 0."""
    rows = slice(row, row + 1)
    masks: list[NDArray[np.bool_]] = []
    for index, how in enumerate(states.fields):
        masks.append(how.differs(*states.read(index, rows)))
    pairs = np.stack([mask[0].any(axis=(1, 2)) for mask in masks])
    pair = int(np.argmax(pairs.any(axis=0)))
    fields = [how.field.name for how, mask in zip(states.fields, masks, strict=True) if mask.any()]
    items: dict[str, None] = {}
    for how, mask in zip(states.fields, masks, strict=True):
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
        fields=tuple(fields),
        items=tuple(items),
        number=number(states.fields[index], *states.read(index, rows), (0, pair, *at)),
    )


def envs_of(pair: int, a: Selection, b: Selection) -> tuple[int, int]:
    """Numbers of the environments of a pair; a single one is in all pairs."""
    return a.envs[min(pair, len(a.envs) - 1)], b.envs[min(pair, len(b.envs) - 1)]
