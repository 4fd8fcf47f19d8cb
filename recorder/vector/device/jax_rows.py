"""Rows of JAX's arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np

from gpusimbench.recorder.vector.device.rows import Arrays, Columns, Rows


class JaxRows(Rows):
    """A block that a compiled function writes into, in place; a full block is handed over, and a new one made."""

    def __init__(self) -> None:
        super().__init__()
        self._block: dict[str, Any] = {}
        self._places: list[Any] = []  # numbers of rows, on the device: none is sent there in a step

    @staticmethod
    def described(array: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """See Rows.described; bfloat16 comes as float32."""
        dtype = np.dtype(array.dtype)
        return (np.dtype(np.float32) if dtype.kind == "V" else dtype), tuple(array.shape)

    def _put(self, row: Arrays, at: int) -> None:
        if missing := [name for name in row if name not in self._block]:
            self._block |= _zeros()({name: row[name] for name in missing}, self._most)
            self._places = self._places or _numbers(self._most)
        part = {name: self._block[name] for name in row}
        self._block |= _write()(part, dict(row), self._places[at])

    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """See Rows.last."""
        row = {name: self._block[name][self.filled - 1] for name in names}
        return lambda: {name: np.asarray(array) for name, array in row.items()}

    def _take(self, filled: int) -> Callable[[], Columns]:
        block, self._block = self._block, {}
        for array in block.values():
            array.copy_to_host_async()
        return lambda: {name: np.asarray(array)[:filled] for name, array in block.items()}


@cache
def _write() -> Callable[..., dict[str, Any]]:
    import jax

    def write(block: dict[str, Any], row: dict[str, Any], at: Any) -> dict[str, Any]:
        return {
            name: jax.lax.dynamic_update_index_in_dim(block[name], row[name].astype(block[name].dtype), at, 0)
            for name in block
        }

    compiled: Callable[..., dict[str, Any]] = jax.jit(write, donate_argnums=0)
    return compiled


@cache
def _zeros() -> Callable[..., dict[str, Any]]:
    import jax
    import jax.numpy as jnp

    def zeros(row: dict[str, Any], rows: int) -> dict[str, Any]:
        described = {name: JaxRows.described(array) for name, array in row.items()}
        return {name: jnp.zeros((rows, *shape), dtype) for name, (dtype, shape) in described.items()}

    compiled: Callable[..., dict[str, Any]] = jax.jit(zeros, static_argnums=1)
    return compiled


def _numbers(rows: int) -> list[Any]:
    import jax.numpy as jnp

    return [jnp.asarray(at) for at in range(rows)]
