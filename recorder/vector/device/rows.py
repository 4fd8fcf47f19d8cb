"""What a device keeps of steps until a block of them is copied to the host."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.states import STEPS_PER_BLOCK
from gpusimbench.schemas.errors import UsageError

Arrays = Mapping[str, Any]
"""Arrays of one library on a device, by name, [env, ...]."""

Columns = dict[str, NDArray[Any]]
"""The same of several rows on the host, [row, env, ...]."""

_BLOCK_BYTES = 128 << 20  # that a block may take on the device; images of many environments take that in one row


class Rows(ABC):
    """Rows of arrays on a device, a block of them; nothing waits for the device while it is filled.

    filled  rows of the block that are there
    """

    def __init__(self) -> None:
        self.filled = 0
        self._most = 1
        self._layout: dict[str, tuple[Any, tuple[int, ...]]] = {}

    @property
    def full(self) -> bool:
        """Whether the block has to be taken before another row is kept."""
        return self.filled == self._most

    def keep(self, row: Arrays) -> None:
        """Add a row. The arrays may change afterwards.

        UsageError where an array has another dtype or shape than in the rows before.
        """
        layout = {name: (array.dtype, tuple(array.shape)) for name, array in row.items()}
        if not self._layout:
            size = sum(self.itemsize(array) * int(np.prod(array.shape)) for array in row.values())
            self._layout, self._most = layout, max(1, min(STEPS_PER_BLOCK, _BLOCK_BYTES // max(1, size)))
        elif layout != self._layout:
            name = next(name for name in {**self._layout, **layout} if self._layout.get(name) != layout.get(name))
            dtype, shape = layout.get(name, ("missing", ()))
            before, former = self._layout.get(name, ("missing", ()))
            raise UsageError(f"{name} is {dtype} {shape}, and was {before} {former} before")
        self._put(row, self.filled)
        self.filled += 1

    def replace(self, row: Arrays) -> None:
        """Put other arrays into the last row, in place of some that are there."""
        self._put(row, self.filled - 1)

    @abstractmethod
    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """A copy of arrays of the last row, [env, ...]; the function waits for it."""

    def take(self) -> Callable[[], Columns]:
        """Begin to copy the rows that are there to the host, and begin a new block.

        Returns a function that waits for the copy and returns it; it is called in another thread.
        """
        taken, self.filled = self._take(self.filled), 0
        return taken

    @staticmethod
    @abstractmethod
    def described(array: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """The dtype in which an array comes to the host, and its shape."""

    def itemsize(self, array: Any) -> int:
        """Bytes of a number of an array."""
        return self.described(array)[0].itemsize

    @abstractmethod
    def _put(self, row: Arrays, at: int) -> None:
        """Copy arrays into a row of the block on the device, without waiting for it."""

    @abstractmethod
    def _take(self, filled: int) -> Callable[[], Columns]:
        """See take."""
