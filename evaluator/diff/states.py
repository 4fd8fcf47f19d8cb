"""The recorded states of two sides, read side by side in bounded memory; and bodies that are only in another order."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import Selection, common_steps, picked
from gpusimbench.evaluator.diff.numbers import Pairing
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mixing import GOLDEN, mix

_ROWS = 50  # a block's rows, so that few are decoded twice
_BYTES = 16 << 20  # of one field on one side; never less than a row
_NONE: tuple[NDArray[np.int64], NDArray[np.int64]] = (np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))

Words = NDArray[np.uint64]


@dataclass(frozen=True)
class Ends:
    """Last steps of one side's field: of those that both sides recorded, and of its own; None without any."""

    common: int | None
    own: int | None


class CommonStates:
    """States at the steps that both sides recorded, of the fields that both have.

    A file that was cut short has more rows of its first field than of its last: each field has common steps of its own.

    fields   and how they are compared
    steps_a  steps at which any field is common, of side a, shape [step]
    steps_b  the same of side b
    """

    def __init__(self, a: Selection, b: Selection, fields: Sequence[Pairing], ratio: Fraction) -> None:
        self.fields = tuple(fields)
        self._a, self._b = a, b
        self._of_a = [a.recording.state(p.field.a.group, p.field.a.field) for p in self.fields]
        self._of_b = [b.recording.state(p.field.b.group, p.field.b.field) for p in self.fields]
        common = [
            common_steps(of_a.steps, of_b.steps, ratio) for of_a, of_b in zip(self._of_a, self._of_b, strict=True)
        ]
        self.steps_a, self.steps_b = (_any_has(steps) for steps in zip(*common, strict=True)) if common else _NONE
        self._has = [np.isin(self.steps_a, of_a, assume_unique=True) for of_a, _ in common]

    def __len__(self) -> int:
        return len(self.steps_a)

    def ends(self, number: int) -> tuple[Ends, Ends]:
        """Where a field ends, on side a and on side b."""
        has = self._has[number]
        return (
            Ends(_last(self.steps_a[has]), _last(self._of_a[number].steps)),
            Ends(_last(self.steps_b[has]), _last(self._of_b[number].steps)),
        )

    def has(self, number: int, rows: slice) -> NDArray[np.bool_]:
        """At which of a range of common steps both sides have a field, shape [step]."""
        return self._has[number][rows]

    def read(self, number: int, rows: slice) -> tuple[NDArray[Any], NDArray[Any]]:
        """A field of both sides at those common steps of a range that have it, each [step, env, item, component]."""
        field, has = self.fields[number].field, self.has(number, rows)
        a = _rows(self._of_a[number], self.steps_a[rows][has], self._a.slice)
        b = _rows(self._of_b[number], self.steps_b[rows][has], self._b.slice)
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


def _any_has(steps: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.unique(np.concatenate(steps))


def _last(steps: NDArray[np.int64]) -> int | None:
    return int(steps[-1]) if len(steps) else None


def _rows(array: StateArray, steps: NDArray[np.int64], envs: slice) -> NDArray[Any]:
    if not len(steps):
        return array.read(slice(0), envs)
    at = np.searchsorted(array.steps, steps)
    read: NDArray[Any] = array.read(slice(int(at[0]), int(at[-1]) + 1), envs)
    return read if len(read) == len(at) else read[at - at[0]]


class BodyOrder:
    """Bodies by 64-bit hashes of all their numbers at a state, which are held against each other in any order.

    The bodies of a group, which has positions, may be in any order within their environment, at every recorded state in
    another one; items of other groups, such as joints, keep theirs. Environments keep their places in time.

    in_env     every environment has the bodies of its counterpart
    any_env    the environments of b have the bodies of those of a, each as often; False where not all are compared
    """

    def __init__(self, states: CommonStates, a: Selection, b: Selection) -> None:
        self._states = states
        self._placed = {how.field.a.group for how in states.fields if how.field.is_position}
        whole = all(len(side.envs) == side.recording.configuration.n_env for side in (a, b))
        self.in_env, self.any_env = True, whole and len(a.envs) == len(b.envs)
        self._trajectories = tuple(np.zeros(len(side.envs), dtype=np.uint64) for side in (a, b))

    def look(self) -> None:
        """Read the common states until neither can hold any more: of sides that differ otherwise, a chunk or two."""
        for rows in self._states.ranges():
            a, b = self._bodies(rows)
            self.in_env = self.in_env and a.shape[2:] == b.shape[2:] and bool((a == b).all())
            if self.any_env:
                found = [_followed(t, side) for t, side in zip(self._trajectories, (a, b), strict=True)]
                self._trajectories = tuple(found)
                self.any_env = np.array_equal(np.sort(found[0]), np.sort(found[1]))
            if not (self.in_env or self.any_env):
                return

    def _bodies(self, rows: slice) -> tuple[Words, Words]:
        """Hashes of the bodies of both sides, in order where that may be another, [step, env, item]."""
        sides: list[dict[tuple[str, int], Words]] = [{}, {}]
        for index, how in enumerate(self._states.fields):
            has = self._states.has(index, rows)
            key = np.uint64((index + 1) * GOLDEN & 0xFFFFFFFFFFFFFFFF)
            for side, array in zip(sides, self._states.read(index, rows), strict=True):
                # fields of a group that have other items are bodies of their own
                hashes = np.zeros((len(has), *array.shape[1:3]), dtype=np.uint64)
                hashes[has] = mix(fingerprint([array[..., np.newaxis, :]]) + key)
                of = how.field.a.group, array.shape[2]
                side[of] = side[of] + hashes if of in side else hashes
        a, b = (np.concatenate([self._sorted(group, h) for (group, _), h in s.items()], axis=2) for s in sides)
        return a, b

    def _sorted(self, group: str, hashes: Words) -> Words:
        return np.sort(hashes, axis=2) if group in self._placed else hashes


def _followed(trajectories: Words, bodies: Words) -> Words:
    """Trajectories of environments so far, shape [env], and on by some states of their bodies."""
    for row in fingerprint([bodies.view(np.float64)[..., np.newaxis]]):
        trajectories = mix((trajectories + np.uint64(GOLDEN)) ^ row)
    return trajectories
