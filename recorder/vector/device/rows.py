"""What a device keeps of steps until a block of them is copied to the host."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import BLOCK_STEPS
from gpusimbench.schemas.errors import DataLost, UsageError

Arrays = Mapping[str, Any]
"""Arrays of one library on a device, by name, [env, ...]."""

Columns = dict[str, NDArray[Any]]
"""The same of several rows on the host, [row, env, ...]."""

OBSERVATION = "observation"
"""Begins the names of the arrays of observations."""

_FLAGS = ("done", "truncation", "terminated", "truncated")

_Layout = dict[str, tuple[Any, tuple[int, ...]]]

_BLOCK_BYTES = 128 << 20  # that a block may take on the device; images of many environments take that in one row

# Blocks of small rows wait for more rows, at most so many, so long and of so many bytes: each block that is handed over
# wakes two threads, which take the interpreter from the one that steps.
_MOST_ROWS = 8 * BLOCK_STEPS
_WAIT_S = 0.25
_WAIT_BYTES = 16 << 20


def check_envs(row: Arrays) -> None:
    """UsageError where arrays are not of as many environments as there are rewards, or a flag is not one for each."""
    shapes = {name: tuple(getattr(array, "shape", ())) for name, array in row.items()}
    envs = shapes["reward"][:1]
    if not envs:
        raise UsageError("reward has shape (); a number for each environment is recorded")
    for name, shape in shapes.items():
        if shape[:1] != envs or (name in _FLAGS and len(shape) > 1):
            what = "a truth value" if name in _FLAGS else "a row"
            raise UsageError(f"{name} has shape {shape}; {what} for each of {envs[0]} environments is recorded")


def _layout(row: Arrays) -> _Layout:
    return {
        name: (getattr(array, "dtype", type(array).__name__), tuple(getattr(array, "shape", ())))
        for name, array in row.items()
    }


def _rows_of(size: int) -> int:
    """How many rows of so many bytes a block has: whole blocks of the file, if one of them fits."""
    least = max(1, min(BLOCK_STEPS, _BLOCK_BYTES // size))
    return max(least, min(_MOST_ROWS, _WAIT_BYTES // size // BLOCK_STEPS * BLOCK_STEPS))


class Rows(ABC):
    """Rows of arrays on a device, a block of them; nothing waits for the device while it is filled.

    filled  rows of the block that are there
    lost    why rows are missing behind those that were taken last; None: none are
    """

    def __init__(self) -> None:
        self.filled = 0
        self.lost: DataLost | None = None
        self._most = 1
        self._since = 0.0  # when the first row of the block was kept [s]
        self._layout: _Layout = {}

    @property
    def full(self) -> bool:
        """Whether the block is to be taken before another row is kept: it has no room, or whole blocks of the file."""
        if self.filled == self._most:
            return True
        whole = self.filled > 0 and self.filled % BLOCK_STEPS == 0
        return whole and time.monotonic() - self._since > _WAIT_S

    def keep(self, row: Arrays) -> None:
        """Add a row. The arrays may change afterwards.

        UsageError where an array has another dtype or shape than in the rows before; DataLost where rows that were kept
        are there no more, which `filled` does not count then.
        """
        layout = _layout(row)
        if not self._layout:
            self._check_numbers(row)
            size = sum(self.itemsize(array) * int(np.prod(array.shape)) for array in row.values())
            self._layout, self._most = layout, _rows_of(max(1, size))
        self._check_layout(layout, self._layout)
        if not self.filled:
            self._since = time.monotonic()
        self._put(row, self.filled)
        self.filled += 1

    def replace(self, row: Arrays) -> None:
        """Put other arrays, which `check` takes, into the last row, in place of some that are there."""
        self._put(row, self.filled - 1)

    def check(self, row: Arrays) -> None:
        """UsageError where arrays cannot replace those of the last row: of observations, all are replaced."""
        seen = {name: at for name, at in self._layout.items() if name in row or name.startswith(OBSERVATION)}
        self._check_layout(_layout(row), seen)

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

    def _check_numbers(self, row: Arrays) -> None:
        for name, array in row.items():
            try:
                kind = self.described(array)[0].kind
            except (AttributeError, TypeError):
                kind = "O"
            if kind not in "fiub":
                told = getattr(array, "dtype", type(array).__name__)
                raise UsageError(f"{name} is {told}; arrays of real numbers or truth values are taken")

    @staticmethod
    def _check_layout(now: _Layout, before: _Layout) -> None:
        if now != before:
            name = next(name for name in {**before, **now} if before.get(name) != now.get(name))
            (dtype, shape), (former, other) = (layout.get(name, ("missing", ())) for layout in (now, before))
            raise UsageError(f"{name} is {dtype} {shape}, and was {former} {other} before")

    @abstractmethod
    def _put(self, row: Arrays, at: int) -> None:
        """Copy arrays into a row of the block on the device, without waiting for it."""

    @abstractmethod
    def _take(self, filled: int) -> Callable[[], Columns]:
        """See take."""
