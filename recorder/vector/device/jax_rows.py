"""Rows of JAX's arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.device.rows import Arrays, Columns, Rows

_WORD = 4  # bytes
_ALIGNED = (
    8  # bytes of which an array's words are a multiple, so that numbers of 64 bits lie where a CPU reads them best
)


class _Place(NamedTuple):
    """Where the words of an array lie in a row, and what they are."""

    begin: int
    end: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def of(self, block: NDArray[np.uint32]) -> NDArray[Any]:
        """The array of all rows of a block [row, word]; nothing is copied."""
        numbers = block[:, self.begin : self.end].view(self.dtype)[:, : math.prod(self.shape)]
        return numbers.reshape(len(block), *self.shape)


class JaxRows(Rows):
    """One array of words [row, word] that a compiled function writes into, in place.

    Each array of a row is some of its words, bit for bit: so a GPU starts few kernels for a row, and makes one copy of
    a block. A full block is handed over, and a new one made.
    """

    def __init__(self) -> None:
        super().__init__()
        self._block: Any = None
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
        arrays = tuple([row[name] for name in names])
        if self._block is None:
            words = max(place.end for place in self._places.values())
            self._block = _zeros()(arrays[0], self._most, words)
        write = _write(tuple([self._places[name].begin for name in names]))
        self._block = write(self._block, self._numbers[at], arrays)

    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """See Rows.last."""
        row, places = self._block[self.filled - 1], {name: self._places[name] for name in names}
        return lambda: {name: place.of(np.asarray(row)[None])[0] for name, place in places.items()}

    def _take(self, filled: int) -> Callable[[], Columns]:
        block, self._block = self._block, None
        block.copy_to_host_async()

        def arrived() -> Columns:
            words = np.asarray(block)[:filled]
            return {name: place.of(words) for name, place in self._places.items()}

        return arrived


def _places(row: Arrays) -> dict[str, _Place]:
    """One array behind the other, as JAX has them, which may be in fewer bits than numpy."""
    import jax

    found = {name: JaxRows.described(array) for name, array in jax.eval_shape(lambda row: row, dict(row)).items()}
    ends = list(
        accumulate(
            -(-dtype.itemsize * math.prod(shape) // _ALIGNED) * (_ALIGNED // _WORD) for dtype, shape in found.values()
        )
    )
    begins = [0, *ends]
    return {
        name: _Place(begin, end, *described)
        for (name, described), begin, end in zip(found.items(), begins, ends, strict=False)
    }


@cache
def _write(begins: tuple[int, ...]) -> Callable[..., Any]:
    """A function that puts arrays into a row of a block, in its memory; their words begin there."""
    import jax
    import jax.numpy as jnp

    def write(block: Any, at: Any, arrays: tuple[Any, ...]) -> Any:
        runs: list[tuple[int, list[Any]]] = []  # of arrays that lie one behind the other: each is one update
        end = -1
        for begin, array in zip(begins, arrays, strict=True):
            words = _words(array)
            if begin != end:
                runs.append((begin, []))
            runs[-1][1].append(words)
            end = begin + words.size
        for begin, parts in runs:
            block = jax.lax.dynamic_update_slice(block, jnp.concatenate(parts)[None], (at, np.uint32(begin)))
        return block

    compiled: Callable[..., Any] = jax.jit(write, donate_argnums=0)
    return compiled


def _words(array: Any) -> Any:
    """The bits of an array, with zeros behind them up to what _ALIGNED says."""
    import jax
    import jax.numpy as jnp

    dtype, _ = JaxRows.described(array)
    numbers = array.astype(np.uint8 if dtype.kind == "b" else dtype).reshape(-1)
    numbers = jnp.pad(numbers, (0, -numbers.size % (_ALIGNED // dtype.itemsize)))
    if dtype.itemsize < _WORD:
        numbers = numbers.reshape(-1, _WORD // dtype.itemsize)
    return jax.lax.bitcast_convert_type(numbers, jnp.uint32).reshape(-1)


@cache
def _zeros() -> Callable[..., Any]:
    import jax
    import jax.numpy as jnp

    def zeros(_: Any, rows: int, words: int) -> Any:
        return jnp.zeros((rows, words), jnp.uint32)

    # the array says on which device
    compiled: Callable[..., Any] = jax.jit(zeros, static_argnums=(1, 2), keep_unused=True)
    return compiled


def _numbers(rows: int) -> list[Any]:
    import jax.numpy as jnp

    # without a sign, which a kernel would look at in each step
    return [jnp.asarray(at, jnp.uint32) for at in range(rows)]
