"""Rows of JAX's arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.device.rows import Arrays, Columns, Rows
from gpusimbench.schemas.errors import UsageError

_LARGE = 128 << 10  # bytes of an array that is written alone: joining it costs a CPU more than another kernel


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
    blocks are handed over, and new ones made.
    """

    def __init__(self) -> None:
        super().__init__()
        self._blocks: dict[str, Any] = {}
        self._places: dict[str, _Place] = {}
        self._numbers: list[Any] = []  # of rows, on the device: none is sent there in a step

    @staticmethod
    def described(array: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """See Rows.described; bfloat16 comes as float32."""
        dtype = np.dtype(array.dtype)
        return (np.dtype(np.float32) if dtype.kind == "V" else dtype), tuple(array.shape)

    def _put(self, row: Arrays, at: int) -> None:
        if not self._places:
            self._places, self._numbers = _places(row), _numbers(self._most)
        names = [name for name in self._places if name in row]
        places = tuple([self._places[name] for name in names])
        arrays = tuple([row[name] for name in names])
        try:
            if not self._blocks:
                self._blocks = _zeros()(arrays, places, self._most)
            self._blocks |= _write(places)(
                {place.dtype: self._blocks[place.dtype] for place in places}, self._numbers[at], arrays
            )
        except ValueError:  # JAX names its own functions
            _check_devices(row, self._blocks)
            raise

    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """See Rows.last."""
        places = {name: self._places[name] for name in names}
        row = {place.dtype: self._blocks[place.dtype][self.filled - 1] for place in places.values()}

        def arrived() -> Columns:
            blocks = {dtype: np.asarray(array)[None] for dtype, array in row.items()}
            return {name: place.of(blocks)[0] for name, place in places.items()}

        return arrived

    def _take(self, filled: int) -> Callable[[], Columns]:
        blocks, self._blocks = self._blocks, {}
        for block in blocks.values():
            block.copy_to_host_async()

        def arrived() -> Columns:
            rows = {dtype: np.asarray(block)[:filled] for dtype, block in blocks.items()}
            return {name: place.of(rows) for name, place in self._places.items()}

        return arrived


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
    """A function that puts arrays into their places in a row of blocks, in the memory of these."""
    import jax
    import jax.numpy as jnp

    def write(blocks: dict[str, Any], at: Any, arrays: tuple[Any, ...]) -> dict[str, Any]:
        blocks = dict(blocks)
        for begin, dtype, parts in _runs(places, arrays):
            numbers = jnp.concatenate(parts)[None]
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
