"""A recorded state field as an array that is read when it is indexed."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import (
    STATE_HEAD_BYTES,
    BlockHeader,
    decode_state,
    state_bytes,
    state_header,
    state_header_in,
)
from gpusimbench.schemas.checks import MAX_COUNT
from gpusimbench.schemas.configuration import EPOCH_NS, RunConfiguration, sim_time_ns
from gpusimbench.schemas.errors import DamagedRecording, damage_in
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.contents import Message
from gpusimbench.schemas.mcap.reader import Container

_BLOCK_ROWS = 50  # at most, by the format
_GAP_ROWS = 1 << 22  # that may be missing before nothing else can be read
_THREADS_MEMORY = 256 << 20  # that blocks may take while threads decode them
_THREADED_BYTES = 4 << 20  # below which threads are not worth their while, where the file is near


@dataclass(frozen=True)
class _Block:
    first_row: int
    rows: int
    message: Message


@dataclass(frozen=True)
class _Part:
    """What is asked for of one block: rows and environments of the block, and where they go."""

    block: _Block
    env_start: int
    envs: int
    taken: tuple[slice, slice]
    target: tuple[slice, slice]


@dataclass(frozen=True)
class _Column:
    """The blocks of one range of environments, in order of time."""

    env_start: int
    blocks: list[_Block]
    end_row: int


class StateArray:
    """A state field, shape [step, env, item, width].

    Indexing works as in numpy and reads only the blocks that the first two indices touch; numpy.asarray reads all.

    field  what the numbers mean
    steps  simulator step of each row; a simulation's row i is step i * stride
    """

    def __init__(self, container: Container, configuration: RunConfiguration, field: StateField) -> None:
        self._container = container
        self.field = field
        self._n_env = configuration.n_env
        self._stride = configuration.stride
        self._columns = self._index(configuration.dt)
        starts = [c.env_start for c in self._columns]
        if self._columns and (starts[0] != 0 or any(c.blocks[0].first_row != self._first_row for c in self._columns)):
            raise DamagedRecording(f"{container.path}: environment blocks of {field.name} are missing")
        # A run that was cut short may have a block more of its first environments than of its last.
        rows = min((c.end_row for c in self._columns), default=0) - self._first_row
        self._check_rows(rows)
        self.steps = (self._first_row + np.arange(rows, dtype=np.int64)) * self._stride
        self.shape = (rows, self._n_env, len(field.items), field.width)
        self.dtype = np.dtype(field.dtype)
        self.ndim = 4

    @property
    def _first_row(self) -> int:
        # Measured trials have no state at step 0; everything else begins there.
        return self._columns[0].blocks[0].first_row if self._columns else 0

    @property
    def env_ranges(self) -> tuple[slice, ...]:
        """Of the blocks, in order: all environments."""
        return tuple(slice(column.env_start, end) for column, end in self._env_ranges())

    @property
    def block_rows(self) -> tuple[int, ...]:
        """Rows of each block of the first environments, in order."""
        return tuple(block.rows for block in self._columns[0].blocks) if self._columns else ()

    def __len__(self) -> int:
        return self.shape[0]

    def __repr__(self) -> str:
        return f"<StateArray {self.field.name} [{self.field.unit}] {self.shape} {self.dtype}>"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        array = self.read(slice(None), slice(None))
        return array if dtype is None else array.astype(dtype, copy=False)

    def __getitem__(self, index: Any) -> NDArray[Any]:
        index = index if isinstance(index, tuple) else (index,)
        if any(part is Ellipsis for part in index):
            at = next(i for i, part in enumerate(index) if part is Ellipsis)
            index = (*index[:at], *[slice(None)] * (self.ndim - len(index) + 1), *index[at + 1 :])
        if len(index) > self.ndim or any(part is None for part in index):
            raise IndexError(f"{len(index)} indices for an array of {self.ndim} dimensions, or a new axis")
        index = (*index, *[slice(None)] * (self.ndim - len(index)))
        steps, step_index = self._bounds(index[0], 0)
        envs, env_index = self._bounds(index[1], 1)
        picked: NDArray[Any] = self.read(steps, envs)[(step_index, env_index, *index[2:])]
        return picked

    def at_step(self, step: int) -> NDArray[Any]:
        """The state after `step` simulator steps, [env, item, width]; KeyError where it was not recorded."""
        row, rest = divmod(step, self._stride)
        row -= self._first_row
        if rest or not 0 <= row < len(self):
            raise KeyError(f"step {step} of {self.field.name} is not recorded")
        return self[row]

    def read(self, steps: slice, envs: slice, *, copy: bool = True) -> NDArray[Any]:
        """Rows and environments of contiguous ranges, [step, env, item, width]; only their blocks are read.

        copy  False gives the file's own bytes, read-only, where one block has all that is asked for. They are a mapping
              of the file, so that nobody may shorten it while they are used.
        """
        first, stop, _ = steps.indices(self.shape[0])
        env_first, env_stop, _ = envs.indices(self.shape[1])
        shape = (max(0, stop - first), max(0, env_stop - env_first), *self.shape[2:])
        size = math.prod(shape) * self.dtype.itemsize
        if size > self._container.content_bytes and size > self._held(first, stop, env_first, env_stop):
            raise DamagedRecording(
                f"{self._container.path}: {self.field.name} announces {shape}, more numbers than the file holds"
            )
        parts = list(self._parts(first, stop, env_first, env_stop))
        if not copy and len(parts) == 1:
            only = self._decode(parts[0])
            if only.shape == shape:
                return only
        out = np.empty(shape, dtype=self.dtype)

        def place(part: _Part) -> int:
            found = self._decode(part)
            out[part.target] = found
            return found.size

        workers = self._workers(parts, size)
        if workers > 1:
            with ThreadPoolExecutor(workers) as pool:
                try:
                    filled = sum(pool.map(place, parts))
                except BaseException:
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise
        else:
            filled = sum(map(place, parts))
        if filled != out.size:
            raise DamagedRecording(
                f"{self._container.path}: blocks of {self.field.name} are missing: "
                f"{filled} of {out.size} numbers are there"
            )
        return out

    def _workers(self, parts: list[_Part], size: int) -> int:
        # threads that are worth their while, and that have room for the blocks that they are at
        source = self._container.source
        if not parts or (source.near and size < _THREADED_BYTES):
            return 1
        number = self.shape[2] * self.shape[3] * self.dtype.itemsize
        most = max(max(p.block.rows * p.envs * number, self._container.chunk_bytes(p.block.message)) for p in parts)
        return max(1, min(len(parts), source.workers, _THREADS_MEMORY // max(most, 1)))

    def _parts(self, first: int, stop: int, env_first: int, env_stop: int) -> Iterator[_Part]:
        for column, next_start in self._env_ranges():
            env_begin, env_end = max(env_first, column.env_start), min(env_stop, next_start)
            if env_begin >= env_end:
                continue
            envs = slice(env_begin - column.env_start, env_end - column.env_start)
            target = slice(env_begin - env_first, env_end - env_first)
            for block in self._touched(column, first, stop):
                at = block.first_row - self._first_row
                begin, end = max(first, at), min(stop, at + block.rows)
                yield _Part(
                    block, column.env_start, next_start - column.env_start,
                    (slice(begin - at, end - at), envs), (slice(begin - first, end - first), target),
                )  # fmt: skip

    def _held(self, first: int, stop: int, env_first: int, env_stop: int) -> int:
        # bytes of the arrays that the blocks of a range hold; packed, they are fewer in the file
        return sum(
            state_bytes(self._container.read(block.message)[1])
            for column, next_start in self._env_ranges()
            if max(env_first, column.env_start) < min(env_stop, next_start)
            for block in self._touched(column, first, stop)
        )

    def _touched(self, column: _Column, first: int, stop: int) -> list[_Block]:
        # the blocks of a range of rows
        if first >= stop:
            return []
        begin, end = (
            bisect_right(column.blocks, row + self._first_row, key=lambda block: block.first_row)
            for row in (first, stop - 1)
        )
        return column.blocks[begin - 1 : end]

    def _check_rows(self, rows: int) -> None:
        # before an array of that length is made
        most = _GAP_ROWS + _BLOCK_ROWS * sum(len(c.blocks) for c in self._columns)
        if self._first_row < 0 or rows > most or (self._first_row + rows) * self._stride > MAX_COUNT:
            raise DamagedRecording(
                f"{self._container.path}: {self.field.name} announces {rows} rows from row {self._first_row} on, which "
                "cannot be"
            )

    def _env_ranges(self) -> Iterator[tuple[_Column, int]]:
        # each column with the end of its environments: where the next one begins
        return zip(self._columns, [*(c.env_start for c in self._columns[1:]), self._n_env], strict=False)

    def _bounds(self, index: Any, axis: int) -> tuple[slice, Any]:
        # the contiguous range to read, and the index into what was read
        size = self.shape[axis]
        if isinstance(index, slice):
            picked = range(size)[index]
            if not picked:
                return slice(0, 0), slice(0, 0)
            low, high = min(picked[0], picked[-1]), max(picked[0], picked[-1])
            # both ends were picked, so stepping through what was read picks the same
            return slice(low, high + 1), slice(None, None, index.step)
        if isinstance(index, (int, np.integer)):
            position = int(index) + size if index < 0 else int(index)
            if not 0 <= position < size:
                raise IndexError(f"index {index} is out of bounds for axis {axis} of size {size}")
            return slice(position, position + 1), 0
        return slice(None), index

    def _decode(self, part: _Part) -> NDArray[Any]:
        block = part.block
        _, content, crc = self._container.read_with_crc(block.message)
        with damage_in(self._container.path):
            header, array = decode_state(content, crc=crc)
        first_step = block.first_row * self._stride
        expected = (first_step, self._stride, part.env_start, block.rows, part.envs, *self.shape[2:])
        found = (header.first_step, header.stride, header.env_start, *array.shape)
        if found != expected or array.dtype != self.dtype:
            raise DamagedRecording(
                f"{self._container.path}: a block of {self.field.name} says (step, stride, env, rows, envs, items, "
                f"width) = {found}, its place in the file says {expected}"
            )
        return array[part.taken]

    def _index(self, dt: float) -> list[_Column]:
        # A block's place follows from its topic and time, so that nothing has to be decompressed to find a step.
        columns = []
        group, field = self.field.group, self.field.field
        for topic, env_start in topics.states_of(self._container.channels, group, field).items():
            if topic != topics.state(group, field, env_start):
                raise DamagedRecording(f"{self._container.path}: {topic} is no name that the format gives")
            messages = self._container.messages(topic)
            if not messages:
                if topics.RUN_END not in self._container.channels:
                    return []  # cut short before the first row of all environments was there
                continue
            rows = [self._row(m, dt) for m in messages]
            last = self._header(messages[-1])
            if last.first_step != rows[-1] * self._stride:
                raise DamagedRecording(f"{self._container.path}: the last block of {topic} is not where it says")
            rows.append(rows[-1] + last.steps)
            blocks = [_Block(r, after - r, m) for r, after, m in zip(rows, rows[1:], messages, strict=False)]
            if any(block.rows < 1 for block in blocks):
                raise DamagedRecording(f"{self._container.path}: {topic} has two blocks of one step")
            columns.append(_Column(env_start, blocks, rows[-1]))
        return sorted(columns, key=lambda c: c.env_start)

    def _header(self, message: Message) -> BlockHeader:
        # Without the block, where that suffices: its rows are held against its place when it is read, and the last step
        # against that of the end record.
        size, head = self._container.peek(message, STATE_HEAD_BYTES)
        return state_header_in(head, size) or state_header(self._container.read(message)[1])

    def _row(self, message: Message, dt: float) -> int:
        step = round((message.log_time - EPOCH_NS) / (dt * 1e9))
        if message.log_time - EPOCH_NS != sim_time_ns(step, dt) or step % self._stride:
            raise DamagedRecording(
                f"{self._container.path}: a block of {self.field.name} has a time that no recorded step has"
            )
        return step // self._stride
