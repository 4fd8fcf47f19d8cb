"""Arrays that no file holds: found apart by the comparison that gsb-diff makes of recorded states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import CommonField
from gpusimbench.evaluator.diff.first import locate
from gpusimbench.evaluator.diff.numbers import Pairing
from gpusimbench.evaluator.diff.result import Basis, Number
from gpusimbench.evaluator.metrics.divergence import differs
from gpusimbench.schemas.fields import UNKNOWN, StateField

_BYTES = 16 << 20  # of one array, compared at a time
_NO_ORIGIN = np.zeros((1, 1, 1))


@dataclass(frozen=True)
class Rows:
    """Numbers of some steps.

    values  real numbers or truth values, [step, env, ...]
    first   step of the first row
    """

    values: NDArray[Any]
    first: int = 0

    @property
    def steps(self) -> range:
        """The steps of the rows."""
        return range(self.first, self.first + len(self.values))


@dataclass(frozen=True)
class ArrayDivergence:
    """The first step at which any number differs.

    step        that step
    after_step  last compared step before it; None where there is none
    env         first environment that differs
    envs        how many differ at that step
    n_env       of how many
    fields      names of the arrays that differ at that step
    number      the first pair of numbers that differ: lowest environment, then array, then number in it
    """

    step: int
    after_step: int | None
    env: int
    envs: int
    n_env: int
    fields: tuple[str, ...]
    number: Number


@dataclass(frozen=True)
class ArraysDifference:
    """What tells two sets of arrays apart.

    unlike    a sentence for each array that cannot be compared: only one side has it, or dtypes, shapes or steps differ
    first     where the others part; None where they do not
    compared  names of the arrays that were compared
    """

    unlike: tuple[str, ...]
    first: ArrayDivergence | None
    compared: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """Whether all is there on both sides, and every bit of it is the same."""
        return not self.unlike and self.first is None


def compare_arrays(
    a: Mapping[str, Rows], b: Mapping[str, Rows], *, names: tuple[str, str] = ("a", "b")
) -> ArraysDifference:
    """Hold arrays of one name against each other, bit by bit.

    a, b   arrays by name
    names  of the two sides, for the sentences
    """
    alike, unlike = [], []
    for name in dict.fromkeys((*a, *b)):
        if name not in a or name not in b:
            unlike.append(f"{name}: only in {names[0] if name in a else names[1]}")
        elif why := _unlike(a[name], b[name], names):
            unlike.append(f"{name}: {why}")
        else:
            alike.append(name)
    return ArraysDifference(tuple(unlike), _first(a, b, alike), tuple(alike))


def _unlike(a: Rows, b: Rows, names: tuple[str, str]) -> str:
    told = [
        f"{what} {of_a} in {names[0]}, {of_b} in {names[1]}"
        for what, of_a, of_b in (
            ("dtype", a.values.dtype, b.values.dtype),
            ("shape", a.values.shape, b.values.shape),
            ("first step", a.first, b.first),
        )
        if of_a != of_b
    ]
    return "; ".join(told)


def _first(a: Mapping[str, Rows], b: Mapping[str, Rows], names: list[str]) -> ArrayDivergence | None:
    found = {name: step for name in names if (step := _first_step(a[name], b[name])) is not None}
    if not found:
        return None
    step = min(found.values())
    there = [name for name in names if found.get(name) == step]
    place = locate([(_pairing(name, a[name].values), _at(step, a[name]), _at(step, b[name])) for name in there])
    return ArrayDivergence(
        step=step,
        after_step=step - 1 if any(step - 1 in a[name].steps for name in names) else None,
        env=place.pair,
        envs=place.pairs,
        n_env=a[there[0]].values.shape[1],
        fields=place.fields,
        number=place.number,
    )


def _first_step(a: Rows, b: Rows) -> int | None:
    for rows in _ranges(a.values):
        apart = np.any(differs(a.values[rows], b.values[rows]), axis=tuple(range(1, a.values.ndim)))
        if apart.any():
            return int(a.first + rows.start + np.argmax(apart))
    return None


def _ranges(values: NDArray[Any]) -> Iterator[slice]:
    rows = max(1, _BYTES // max(1, values[:1].nbytes))
    for begin in range(0, len(values), rows):
        yield slice(begin, min(begin + rows, len(values)))


def _at(step: int, rows: Rows) -> NDArray[Any]:
    # [1, env, item, component], with one item
    values: NDArray[Any] = rows.values[step - rows.first : step - rows.first + 1]
    return values.reshape(1, values.shape[1], 1, -1)


def _pairing(name: str, values: NDArray[Any]) -> Pairing:
    components = tuple(", ".join(map(str, at)) for at in product(*map(range, values.shape[2:])))
    field = StateField("", name, str(values.dtype), ("",), components, UNKNOWN, "")
    item, every = np.zeros(1, dtype=np.int64), np.arange(len(components))
    return Pairing(
        CommonField(field, field, field.items, components, item, item, every, every, Basis.BITS), _NO_ORIGIN, _NO_ORIGIN
    )
