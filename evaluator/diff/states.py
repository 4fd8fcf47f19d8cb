"""The recorded states of two selections, read side by side in bounded memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.diff.common import common_steps
from evaluator.diff.numbers import Pairing
from evaluator.diff.selection import Selection, picked
from evaluator.state_array import StateArray

_ROWS = 50  # a block's rows, so that few are decoded twice
_BYTES = 16 << 20  # of one field on one side; never less than a row


class CommonStates:
    """States at the steps that both sides recorded, of the fields that both have.

    fields   and how they are compared
    steps_a  common steps, of side a, shape [step]
    steps_b  the same of side b
    """

    def __init__(self, a: Selection, b: Selection, fields: Sequence[Pairing], ratio: Fraction) -> None:
        self.fields = tuple(fields)
        self._a, self._b = a, b
        self._of_a = [a.recording.state(p.field.a.group, p.field.a.field) for p in self.fields]
        self._of_b = [b.recording.state(p.field.b.group, p.field.b.field) for p in self.fields]
        # a file that was cut short may have a row more of its first field than of its last
        self.steps_a, self.steps_b = common_steps(_all_have(self._of_a), _all_have(self._of_b), ratio)

    def __len__(self) -> int:
        return len(self.steps_a)

    def last_a(self) -> int | None:
        """Last recorded step of side a, common or not."""
        return _last(self._of_a)

    def last_b(self) -> int | None:
        """Last recorded step of side b, common or not."""
        return _last(self._of_b)

    def read(self, number: int, rows: slice) -> tuple[NDArray[Any], NDArray[Any]]:
        """A field of both sides at a range of common steps, each [step, env, item, component]."""
        field = self.fields[number].field
        a = _rows(self._of_a[number], self.steps_a[rows], self._a.slice)
        b = _rows(self._of_b[number], self.steps_b[rows], self._b.slice)
        return picked(a, field.items_a, field.components_a), picked(b, field.items_b, field.components_b)

    def ranges(self) -> Iterator[slice]:
        """Ranges of common steps that fit into memory, field by field."""
        row = max((math.prod(s.shape[2:]) * s.dtype.itemsize for s in (*self._of_a, *self._of_b)), default=1)
        rows = max(1, min(_ROWS, _BYTES // max(1, row * max(len(self._a.envs), len(self._b.envs)))))
        begin = 0
        while begin < len(self):
            end = begin + 1
            # the initial state is a block of its own
            while begin and end < len(self) and self._span(begin, end) < rows:
                end += 1
            yield slice(begin, end)
            begin = end

    def _span(self, begin: int, end: int) -> int:
        # recorded rows of either side from one common step to another
        spans = [
            (steps[end] - steps[begin]) // stride
            for steps, stride in (
                (self.steps_a, self._a.recording.configuration.stride),
                (self.steps_b, self._b.recording.configuration.stride),
            )
        ]
        return int(max(spans))


def _all_have(arrays: Sequence[StateArray]) -> NDArray[np.int64]:
    common: NDArray[np.int64] = arrays[0].steps if arrays else np.empty(0, dtype=np.int64)
    for array in arrays[1:]:
        common = np.intersect1d(common, array.steps)
    return np.asarray(common)


def _last(arrays: Sequence[StateArray]) -> int | None:
    return max((int(array.steps[-1]) for array in arrays if len(array)), default=None)


def _rows(array: StateArray, steps: NDArray[np.int64], envs: slice) -> NDArray[Any]:
    at = np.searchsorted(array.steps, steps)
    read: NDArray[Any] = array.read(slice(int(at[0]), int(at[-1]) + 1), envs)
    return read if len(read) == len(at) else read[at - at[0]]
