"""How states are cut: ranges of environments, rows in a block, and the memory of a block."""

from __future__ import annotations

from collections.abc import Sequence
from mmap import mmap

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import BLOCK_BYTES, BLOCK_STEPS
from gpusimbench.schemas.fields import StateField

_ENV_BLOCK_MIN = 64
_ENV_BLOCKS = 64
_MESSAGE_BYTES = 4 << 20
_ALIGNED = 64  # bytes
_GROUP = 4  # ranges of environments that a thread reads and looks at together

Arrays = tuple[NDArray[np.floating], ...]
"""One array per state field."""


def env_block(n_env: int) -> int:
    """Environments per block: few topics for many environments, one block for few."""
    return max(_ENV_BLOCK_MIN, -(-n_env // _ENV_BLOCKS))


def row_bytes(n_env: int, fields: Sequence[StateField]) -> int:
    """Bytes of the states of all environments after one step."""
    return n_env * sum(len(f.items) * f.width * np.dtype(f.dtype).itemsize for f in fields)


def steps_per_block(n_env: int, fields: Sequence[StateField]) -> int:
    """Rows per block, so that the largest message stays at about 4 MB, and a block of all environments at 128 MiB."""
    row = max(len(f.items) * f.width * np.dtype(f.dtype).itemsize for f in fields) * min(n_env, env_block(n_env))
    return max(1, min(BLOCK_STEPS, _MESSAGE_BYTES // row, BLOCK_BYTES // row_bytes(n_env, fields)))


class Ranges:
    """The ranges of environments whose states are messages of their own.

    starts  first environment of each
    each    environments of each
    alike   numbers of the ranges of the full size, and of the odd one behind them, where there are any
    """

    def __init__(self, n_env: int) -> None:
        self.n_env = n_env
        self.starts = range(0, n_env, env_block(n_env))
        self.each = [range(start, min(start + self.starts.step, n_env)) for start in self.starts]
        even = n_env // env_block(n_env)
        self.alike = [ranges for ranges in (range(even), range(even, len(self.starts))) if ranges]

    def groups(self) -> list[range]:
        """Numbers of a few ranges of one size that follow each other: the share of a thread."""
        return [ranges[at : at + _GROUP] for ranges in self.alike for at in range(0, len(ranges), _GROUP)]

    def envs(self, ranges: range) -> slice:
        """Environments of ranges that follow each other."""
        first = self.starts[ranges.start]
        return slice(first, min(first + len(ranges) * self.starts.step, self.n_env))


class BlockMemory:
    """Memory for the states of a block: arrays [range, row, env, item, width], one a field, for each of Ranges.alike.

    buffer  from which it is taken, `size` bytes from `offset` on; None: memory of its own
    """

    def __init__(
        self, ranges: Ranges, fields: Sequence[StateField], rows: int, buffer: mmap | None = None, offset: int = 0
    ) -> None:
        self._ranges = ranges
        self._arrays: list[Arrays] = []
        for alike in ranges.alike:
            envs = ranges.envs(alike)
            arrays = []
            for f in fields:
                shape = (len(alike), rows, (envs.stop - envs.start) // len(alike), len(f.items), f.width)
                dtype = np.dtype(f.dtype).newbyteorder("<")
                if buffer is None:
                    arrays.append(np.empty(shape, dtype))
                else:
                    arrays.append(np.ndarray(shape, dtype, buffer=buffer, offset=offset))
                    offset += -(-arrays[-1].nbytes // _ALIGNED) * _ALIGNED
            self._arrays.append(tuple(arrays))

    @staticmethod
    def size(n_env: int, fields: Sequence[StateField], rows: int) -> int:
        """Bytes of a buffer that has room for it."""
        return rows * row_bytes(n_env, fields) + 2 * len(fields) * _ALIGNED

    def part(self, ranges: range, rows: slice) -> Arrays:
        """Some rows of ranges of one size, [range, row, env, item, width]."""
        which = next(i for i, alike in enumerate(self._ranges.alike) if ranges.start in alike)
        first = self._ranges.alike[which].start
        own = slice(ranges.start - first, ranges.stop - first)
        return tuple(array[own, rows] for array in self._arrays[which])

    def side_by_side(self, rows: slice) -> list[Arrays]:
        """Some rows of all ranges, for each of Ranges.alike."""
        return [self.part(alike, rows) for alike in self._ranges.alike]

    def owns(self, array: NDArray[np.floating]) -> bool:
        """Whether an array is a view of this memory's own arrays."""
        return array.base is self._arrays[0][0]


def columns_of(groups: Sequence[Arrays]) -> list[Arrays]:
    """Arrays [row, env, item, width] by range, of arrays [range, row, env, item, width]."""
    return [states for group in groups for states in zip(*group, strict=True)]
