"""Rows of JAX's arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.device.rows import Arrays, Columns, Rows
from gpusimbench.schemas.errors import DataLost, UsageError

_LARGE = 128 << 10  # bytes of an array that is written alone: joining it costs a CPU more than another kernel

# A call that writes a row takes 0.17 ms beside a step that keeps the thread busy, one that writes ten little more. So
# arrays wait for those of later steps: at most so many rows, of so many bytes.
_TOGETHER = 10
_TOGETHER_BYTES = 32 << 20
_WATCHED = 2 * _TOGETHER  # rows that do not wait, to see whether their arrays are donated to a function afterwards


class _Place(NamedTuple):
    """Where the numbers of an array lie in a row of the block of their dtype."""

    dtype: str
    begin: int
    shape: tuple[int, ...]

    @property
    def end(self) -> int:
        return self.begin + math.prod(self.shape)

    def of(self, blocks: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The array of all rows; nothing is copied."""
        block = blocks[self.dtype]
        return block[:, self.begin : self.end].reshape(len(block), *self.shape)


class JaxRows(Rows):
    """For each dtype an array [row, number] that a compiled function writes into, in place.

    The arrays of one dtype lie in it side by side: a GPU starts a kernel for each dtype, and not for each array. Full
    blocks are handed over, and new ones made. JAX's arrays do not change, so that several rows are written at a time;
    those of a program that donates them to its functions are written at once.
    """

    def __init__(self) -> None:
        super().__init__()
        self._blocks: dict[str, Any] = {}
        self._places: dict[str, _Place] = {}
        self._numbers: list[Any] = []  # of rows, on the device: none is sent there in a step
        self._together = 1  # rows that one call writes
        self._held: list[tuple[Any, ...]] = []  # the last rows, which are not in the block yet
        self._last: tuple[Any, ...] = ()  # arrays of the last row that did not wait
        self._to_watch = _WATCHED

    @staticmethod
    def described(array: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """See Rows.described; bfloat16 comes as float32."""
        dtype = np.dtype(array.dtype)
        return (np.dtype(np.float32) if dtype.kind == "V" else dtype), tuple(array.shape)

    def _put(self, row: Arrays, at: int) -> None:
        if not self._places:
            self._begin(row)
        if at == self.filled and self._may_wait(row):
            self._held.append(tuple([row[name] for name in self._places]))
            if len(self._held) == self._together:
                self._write_held(at + 1)
            return
        self._write_held(self.filled)
        names = [name for name in self._places if name in row]
        self._write(names, at, (tuple([row[name] for name in names]),))

    def _begin(self, row: Arrays) -> None:
        self._places, self._numbers = _places(row), _numbers(self._most)
        size = sum(self.itemsize(array) * math.prod(array.shape) for array in row.values())
        if self._most >= _TOGETHER and size * _TOGETHER <= _TOGETHER_BYTES:
            self._together = _TOGETHER
            # compiled now, and not in the midst of steps; what it writes is overwritten
            self._write(list(self._places), 0, (tuple([row[name] for name in self._places]),) * _TOGETHER)

    def _may_wait(self, row: Arrays) -> bool:
        # arrays of numpy may change, and those that are donated are there no more
        if self._together == 1 or not all(hasattr(array, "is_deleted") for array in row.values()):
            return False
        if self._to_watch:
            self._to_watch -= 1
            if _deleted(self._last):
                self._together = 1
            self._last = tuple(row.values()) if self._to_watch and self._together > 1 else ()
            return False
        return True

    def _write_held(self, stop: int) -> None:
        # the rows that end before row `stop`
        held, self._held = self._held, []
        first = stop - len(held)
        there = list(takewhile(lambda arrays: not _deleted(arrays), held))
        calls = (tuple(there),) if len(there) == self._together else tuple((arrays,) for arrays in there)
        for number, rows in enumerate(calls):
            self._write(list(self._places), first + number, rows)
        if len(there) < len(held):
            self.filled = first + len(there)
            raise DataLost(
                f"arrays of step {len(held) - len(there)} before this one are there no more: a function took their "
                f"memory (donate_argnums of jax.jit), which none did in the first {_WATCHED} steps; give it copies "
                "(jnp.copy)"
            )

    def _write(self, names: list[str], at: int, rows: tuple[tuple[Any, ...], ...]) -> None:
        # arrays of these names, of rows that follow each other from `at` on
        places = tuple([self._places[name] for name in names])
        try:
            if not self._blocks:
                self._blocks = _zeros()(rows[0], places, self._most)
            self._blocks |= _write(places)(
                {place.dtype: self._blocks[place.dtype] for place in places}, self._numbers[at], rows
            )
        except ValueError:  # JAX names its own functions
            for arrays in rows:
                _check_devices(dict(zip(names, arrays, strict=True)), self._blocks)
            raise

    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """See Rows.last."""
        self._write_held(self.filled)
        places = {name: self._places[name] for name in names}
        row = {place.dtype: self._blocks[place.dtype][self.filled - 1] for place in places.values()}

        def arrived() -> Columns:
            blocks = {dtype: np.asarray(array)[None] for dtype, array in row.items()}
            return {name: place.of(blocks)[0] for name, place in places.items()}

        return arrived

    def _take(self, filled: int) -> Callable[[], Columns]:
        try:
            self._write_held(filled)
        except DataLost as lost:  # the rows before are there
            self.lost, filled = lost, self.filled
        blocks, self._blocks = self._blocks, {}

        def arrived() -> Columns:
            for block in blocks.values():  # here, since it takes a thread 3 ms until 16 MB have begun to be copied
                block.copy_to_host_async()
            rows = {dtype: np.asarray(block)[:filled] for dtype, block in blocks.items()}
            return {name: place.of(rows) for name, place in self._places.items()}

        return arrived


def _deleted(arrays: Iterable[Any]) -> bool:
    return any(array.is_deleted() for array in arrays)


def _check_devices(row: Arrays, blocks: Arrays) -> None:
    """UsageError where arrays are not all on the devices on which the blocks are, or the first array is."""
    at = {name: array.devices() for name, array in row.items() if getattr(array, "committed", False)}
    kept: Any = next((block.devices() for block in blocks.values()), next(iter(at.values()), set()))
    for name, devices in at.items():
        if devices != kept:
            here, there = (", ".join(sorted(map(str, some))) for some in (devices, kept))
            raise UsageError(
                f"{name} is on {here}, and the arrays that are kept are on {there}: jax.device_put moves it"
            )


def _places(row: Arrays) -> dict[str, _Place]:
    """Of the arrays as JAX has them, which may be in fewer bits than numpy."""
    import jax

    found: dict[str, _Place] = {}
    ends: dict[str, int] = {}
    for name, array in jax.eval_shape(lambda row: row, dict(row)).items():
        dtype, shape = JaxRows.described(array)
        found[name] = _Place(dtype.name, ends.get(dtype.name, 0), shape)
        ends[dtype.name] = found[name].end
    return found


@cache
def _write(places: tuple[_Place, ...]) -> Callable[..., dict[str, Any]]:
    """A function that puts arrays into their places in rows of blocks that follow each other, in their memory."""
    import jax
    import jax.numpy as jnp

    def write(blocks: dict[str, Any], at: Any, rows: tuple[tuple[Any, ...], ...]) -> dict[str, Any]:
        blocks = dict(blocks)
        for runs in zip(*(_runs(places, arrays) for arrays in rows), strict=True):
            begin, dtype, _ = runs[0]
            numbers = jnp.stack([jnp.concatenate(parts) for _, _, parts in runs])
            blocks[dtype] = jax.lax.dynamic_update_slice(blocks[dtype], numbers, (at, np.uint32(begin)))
        return blocks

    compiled: Callable[..., dict[str, Any]] = jax.jit(write, donate_argnums=0)
    return compiled


def _runs(places: Iterable[_Place], arrays: Iterable[Any]) -> list[tuple[int, str, list[Any]]]:
    """Where numbers begin, their dtype, and arrays [number] that lie one behind the other from there on."""
    found: list[tuple[int, str, list[Any]]] = []
    last: dict[str, tuple[int, list[Any]]] = {}  # where the last run of a dtype ends, if another array may follow
    for place, array in zip(places, arrays, strict=True):
        numbers = array.astype(place.dtype).reshape(-1)
        end, parts = last.get(place.dtype, (-1, []))
        large = numbers.nbytes > _LARGE
        if end != place.begin or large:
            parts = []
            found.append((place.begin, place.dtype, parts))
        parts.append(numbers)
        last[place.dtype] = (-1 if large else place.end, parts)
    return found


@cache
def _zeros() -> Callable[..., dict[str, Any]]:
    import jax
    import jax.numpy as jnp

    def zeros(_: Any, places: tuple[_Place, ...], rows: int) -> dict[str, Any]:
        widths = {place.dtype: place.end for place in places}  # the last one ends the row
        return {dtype: jnp.zeros((rows, width), dtype) for dtype, width in widths.items()}

    # the arrays say on which device
    compiled: Callable[..., dict[str, Any]] = jax.jit(zeros, static_argnums=(1, 2), keep_unused=True)
    return compiled


def _numbers(rows: int) -> list[Any]:
    import jax.numpy as jnp

    # without a sign, which a kernel would look at in each step
    return [jnp.asarray(at, jnp.uint32) for at in range(rows)]
