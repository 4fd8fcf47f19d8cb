"""States of a run to blocks: full-rate fingerprints, strided rows, canonical digests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.view import ViewWriter
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.simulators.captured import Captured, Held, States
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import encode_fingerprints, fingerprint_parts, little_endian, state_parts
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import ALGORITHM, fingerprint
from gpusimbench.schemas.mcap.writer import Part

STEPS_PER_BLOCK = 50
_ENV_BLOCK_MIN = 64
_ENV_BLOCKS = 64
_BLOCK_BYTES = 4 << 20
_RING_BYTES = 128 << 20
_ALONE_BYTES = 2 << 20  # blocks up to this size are not worth other threads: 1.1 MB took a fifth more time with two
_PIECES = 8  # of a block, at least, to be shared among threads
_GROUP = 4  # ranges of environments that a thread reads and looks at together


def env_block(n_env: int) -> int:
    """Environments per block: few topics for many environments, one block for few."""
    return max(_ENV_BLOCK_MIN, -(-n_env // _ENV_BLOCKS))


def row_bytes(n_env: int, fields: Sequence[StateField]) -> int:
    """Bytes of the states of all environments after one step."""
    return n_env * sum(len(f.items) * f.width * np.dtype(f.dtype).itemsize for f in fields)


def steps_per_block(n_env: int, fields: Sequence[StateField]) -> int:
    """Rows per block, so that the largest message stays at about 4 MB, and a block of all environments at 128 MiB."""
    row = max(len(f.items) * f.width * np.dtype(f.dtype).itemsize for f in fields) * min(n_env, env_block(n_env))
    return max(1, min(STEPS_PER_BLOCK, _BLOCK_BYTES // row, _RING_BYTES // row_bytes(n_env, fields)))


def declare_fingerprints(sink: Sink, phase: str) -> None:
    """The channel of a phase's state hashes."""
    sink.channel(
        topics.fingerprint(phase),
        "gsb.v1.FingerprintBlock",
        {"algorithm": ALGORITHM, "shape": "step,env", "covers": "all state fields of an env in recording order"},
    )


def write_fingerprints(
    sink: Sink, phase: str, hashes: NDArray[np.uint64], *, first_step: int, stride: int, dt: float
) -> None:
    """State hashes [step, env] of a phase."""
    data = encode_fingerprints(hashes, first_step=first_step, stride=stride)
    sink.write(topics.fingerprint(phase), data, sim_ns=sim_time_ns(first_step, dt))


def hash_messages(hashes: NDArray[np.uint64], *, first_step: int) -> Sequence[tuple[Part, ...]]:
    """State hashes [step, env] of consecutive steps."""
    return [fingerprint_parts(hashes, first_step=first_step, stride=1)]


class _Piece(NamedTuple):
    """A part of a block that one thread looks at: some steps of some ranges of environments of the same size.

    states  [range, step, env, item, width]
    """

    states: States
    first_row: int
    first_env: int


_Looked = tuple[NDArray[np.uint64], list[tuple[int, int, str]]]
"""Hashes [step, env] of a piece, and where it is not finite: step, environment, and the name of the place."""


class _Writing(NamedTuple):
    """Rows that other threads make messages of.

    first_row  number of the first of them in the recording
    columns    their states, by range of environments
    last_step  the last of them
    time       simulated time of the first [ns]
    places     number of the range of environments, and of the field, of each message
    blocks     the messages, in that order
    digesting  one for each field; the arrays are needed until all have come
    """

    first_row: int
    columns: Sequence[States]
    last_step: int
    time: int
    places: list[tuple[int, int]]
    blocks: Iterable[tuple[Part, ...]]
    digesting: Iterable[None]


class StateWriter:
    """Writes the states of the capture phase.

    Rows are fed at full rate; every `stride`-th is stored, and every one is hashed. Ranges of environments, and fields,
    are worked on by several threads, so that the file keeps pace with a device.

    last_step           last step that was fed; -1 before the first
    last_recorded_step  last step whose state is in the file; rows held back for a full block are not yet
    fields              what is written
    workers             the threads
    view                what viewers draw of each block that was written; None: nothing
    """

    def __init__(
        self,
        sink: Sink,
        fields: Sequence[StateField],
        *,
        n_env: int,
        dt: float,
        stride: int,
        first_step: int = 0,
        view: ViewWriter | None = None,
        may_fail: frozenset[int] = frozenset(),
    ) -> None:
        """first_step  number of the first state that will be fed
        may_fail    environments whose states need not be finite
        """
        self._sink = sink
        self.fields = tuple(fields)
        self._n_env = n_env
        self._dt = dt
        self._stride = stride
        self._may_fail = may_fail
        self._rows = steps_per_block(n_env, fields)
        self._starts = range(0, n_env, env_block(n_env))
        even = n_env // env_block(n_env)  # ranges of the full size; there may be one more
        self._alike = [ranges for ranges in (range(even), range(even, len(self._starts))) if ranges]
        self._groups = [
            ranges[at : at + _GROUP] for ranges in self._alike for at in range(0, len(ranges), _GROUP)
        ]  # of ranges of one size
        self._held: list[list[States]] = []  # by block that was fed, then by range of environments
        self._held_rows = 0
        self._held_first = 0
        self._buffers: dict[int, States] = {}  # [range, row, env, item, width] by the first range, of _alike
        self.workers = Workers(small=row_bytes(n_env, fields) * self._rows < _ALONE_BYTES)
        self._view = view
        self._first_step = first_step
        self.last_step = first_step - 1
        self.last_recorded_step = first_step - 1
        for field in self.fields:
            for start in self._starts:
                metadata = {**field.to_metadata(), "stride": str(stride), "dt": repr(dt), "n_env": str(n_env)}
                sink.channel(topics.state(field.group, field.field, start), "gsb.v1.StateBlock", metadata)
        declare_fingerprints(sink, "capture")

    @property
    def steps_per_block(self) -> int:
        """Rows per block; the capture asks the simulator for as many steps at a time."""
        return self._rows

    def feed(self, arrays: Sequence[NDArray[np.floating]]) -> str | None:
        """The states after the next steps, arrays [step, env, item, width]; returns what is not finite, if anything."""
        found = None
        for row in range(0, len(arrays[0]), self._rows):
            problem = self.take(Held(tuple(array[row : row + self._rows] for array in arrays)))
            found = found or problem
        return found

    def take(self, block: Captured, meanwhile: Callable[[], None] = lambda: None) -> str | None:
        """The same of a block that an engine made, of at most `steps_per_block` steps; its arrays are not needed when
        this returns.

        meanwhile  begins work of other threads on the same block, once theirs on its states is begun; what it raises
                   leaves the file without a good end
        """
        first = self.last_step + 1
        keep = slice(-first % self._stride, None, self._stride)
        if len(self._starts) > 1 and not self._buffers:
            self._buffers = {ranges.start: self._memory(ranges) for ranges in self._alike}
        groups = list(self.workers.start(lambda group: self._read(block, group), self._groups))
        columns = [states for group in groups for states in zip(*group, strict=True)]
        with shielded():  # hashes and rows stay in step, so that what was fed can be written after an interruption
            kept = [tuple(array[keep] for array in states) for states in columns]
            stored = len(kept[0][0])
            if self._held_rows + stored > self._rows:
                self.flush()  # no message has more rows than that
            if stored:
                if not self._held_rows:
                    self._held_first = first + keep.start
                self._held.append(kept)
                self._held_rows += stored
            self.last_step += len(columns[0][0])
            whole = self._held_rows >= self._rows or first == self._first_step
            if stored and not whole:  # until the block is full, in memory of their own
                self._held[-1] = [tuple(array.copy() for array in states) for states in kept]
            # in this order: a file is written by one thread, which must not wait for hashes that others make meanwhile
            with self._sink.parting():  # states and their hashes, too
                found = self._write_and_look(groups, first, meanwhile, whole=whole)
        if not found:
            return None
        row, env, what = min(found, key=lambda place: place[:2])  # of those of one row, the first field
        return f"a state is not finite: step {first + row}, env {env}, {what}"

    def _write_and_look(
        self, groups: Sequence[States], first: int, meanwhile: Callable[[], None], *, whole: bool
    ) -> list[tuple[int, int, str]]:
        # rows that are held back where they are a whole block, and hashes of the new rows; what of them is not finite
        rows = groups[0][0].shape[1]
        just_read = rows if len(self._held) == self._stride == 1 and self._side_by_side(groups) else 0
        writing = self._begin_writing(just_read=just_read) if whole else None
        pieces = self._pieces(groups)
        looked_at = self.workers.start(self._look, pieces)
        hashed = self.workers.start(lambda _: self._gather(pieces, looked_at, rows, first), (0,))
        meanwhile()
        if writing:
            self._end_writing(writing)
        messages, found = next(iter(hashed))
        for message in messages:
            self._sink.write_parts(topics.fingerprint("capture"), message, sim_ns=sim_time_ns(first, self._dt))
        self._sink.flush()
        return found

    def _side_by_side(self, groups: Sequence[States]) -> bool:
        # not where a block is looked at in the memory that it came in, though one before was read into the buffers
        return bool(self._buffers) and groups[0][0].base is self._buffers[0][0]

    def _gather(
        self, pieces: Sequence[_Piece], looked_at: Iterable[_Looked], rows: int, first: int
    ) -> tuple[Sequence[tuple[Part, ...]], list[tuple[int, int, str]]]:
        # the messages of a block's hashes, digested, and what is not finite
        hashes = np.empty((rows, self._n_env), dtype=np.uint64)
        found = []
        for piece, (some, not_finite) in zip(pieces, looked_at, strict=True):
            stop, envs = piece.first_row + some.shape[0], piece.first_env + some.shape[1]
            hashes[piece.first_row : stop, piece.first_env : envs] = some
            found += not_finite
        messages = hash_messages(hashes, first_step=first)
        for message in messages:
            self._sink.digest.message(topics.fingerprint("capture"), *(part.data for part in message))
        return messages, found

    def flush(self) -> None:
        """Write the rows that are held back for a full block."""
        with shielded():
            if self._held_rows:
                self._end_writing(self._begin_writing())
                self._sink.flush()

    def _begin_writing(self, *, just_read: int = 0) -> _Writing:
        # of all rows that are held back; just_read: how many they are where they are those of the last block as it was
        # read, whose ranges still lie side by side in memory
        held, self._held = self._held, []
        rows, self._held_rows = self._held_rows, 0
        columns = held[0] if len(held) == 1 else [_joined(parts) for parts in zip(*held, strict=True)]
        places = [(column, field) for column in range(len(self._starts)) for field in range(len(self.fields))]
        return _Writing(
            first_row=self._held_first // self._stride,
            columns=columns,
            last_step=self._held_first + (rows - 1) * self._stride,
            time=sim_time_ns(self._held_first, self._dt),
            places=places,
            blocks=self.workers.start(lambda place: self._block(columns, *place), places),
            digesting=self.workers.start(
                lambda field: self._digest(field, columns, just_read), range(len(self.fields))
            ),
        )

    def _end_writing(self, writing: _Writing) -> None:
        with self._sink.parting():
            self._write_blocks(writing)
        if self._view is not None:
            self._view.rows(writing.first_row, writing.columns, env_block(self._n_env))

    def _write_blocks(self, writing: _Writing) -> None:
        for (column, index), parts in zip(writing.places, writing.blocks, strict=True):
            field = self.fields[index]
            topic = topics.state(field.group, field.field, self._starts[column])
            self._sink.write_parts(topic, parts, sim_ns=writing.time)
        self._sink.flush()  # small ones wait for others, and their arrays are not theirs for much longer
        for _ in writing.digesting:
            pass
        self.last_recorded_step = writing.last_step

    def _memory(self, ranges: range) -> States:
        # for a block of these ranges, which are of one size; memory that is new to the process costs more than copying
        envs = min(self._starts.step, self._n_env - self._starts[ranges.start])
        shape = (len(ranges), self._rows, envs)
        return tuple(
            np.empty((*shape, len(f.items), f.width), dtype=np.dtype(f.dtype).newbyteorder("<")) for f in self.fields
        )

    def _read(self, block: Captured, ranges: range) -> States:
        # [range, step, env, item, width]
        first = self._starts[ranges.start]
        envs = slice(first, min(first + len(ranges) * self._starts.step, self._n_env))
        arrays = block.states(envs)
        self._check(arrays, envs.stop - envs.start)
        if len(self._starts) == 1:
            if all(array.flags.c_contiguous for array in arrays):
                return tuple(little_endian(array)[np.newaxis] for array in arrays)
            self._buffers = self._buffers or {0: self._memory(ranges)}
        alike = next(alike for alike in self._alike if ranges.start in alike)
        own = slice(ranges.start - alike.start, ranges.stop - alike.start)
        filled = tuple(
            buffer[own, : len(array)] for buffer, array in zip(self._buffers[alike.start], arrays, strict=True)
        )
        for buffer, array in zip(filled, arrays, strict=True):
            np.copyto(buffer, array.reshape(buffer.swapaxes(0, 1).shape).swapaxes(0, 1))
        return filled

    def _check(self, arrays: States, n_env: int) -> None:
        # an adapter's mistake must not be copied, cast or broadcast into something that looks right
        expected = [((n_env, len(f.items), f.width), np.dtype(f.dtype)) for f in self.fields]
        for field, array, (shape, dtype) in zip(self.fields, arrays, expected, strict=True):
            if array.shape[1:] != shape or array.dtype != dtype or len(array) != len(arrays[0]):
                raise ValueError(
                    f"the simulator gives {field.name} of {n_env} environments as {array.dtype} {array.shape}, "
                    f"not {dtype} ({len(arrays[0])}, {', '.join(map(str, shape))})"
                )

    def _pieces(self, groups: Sequence[States]) -> list[_Piece]:
        # where there are few ranges of environments, steps are shared out as well, among threads if there are any
        rows = groups[0][0].shape[1]
        size = rows if self.workers.alone else max(1, -(-rows * len(groups) // _PIECES))
        return [
            _Piece(tuple(array[:, row : row + size] for array in states), row, self._starts[ranges.start])
            for ranges, states in zip(self._groups, groups, strict=True)
            for row in range(0, rows, size)
        ]

    def _look(self, piece: _Piece) -> _Looked:
        # hashes [step, env], and for each field the first number that is not finite: its step, environment and place
        ranges, rows, envs = piece.states[0].shape[:3]
        found = []
        for field, array in zip(self.fields, piece.states, strict=True):
            if np.isfinite(array).all():
                continue
            wrong = (~np.isfinite(array)).swapaxes(0, 1).reshape(rows, ranges * envs, *array.shape[3:])
            wrong[:, np.isin(piece.first_env + np.arange(ranges * envs), list(self._may_fail))] = False
            if wrong.any():
                row, env, item, _ = (int(i) for i in np.argwhere(wrong)[0])
                where = f"{field.name} of {field.items[item]}" if field.items[item] else field.name
                found.append((piece.first_row + row, piece.first_env + env, where))
        return fingerprint(piece.states).swapaxes(0, 1).reshape(rows, ranges * envs), found

    def _digest(self, index: int, columns: Sequence[States], just_read: int) -> None:
        field, digest = self.fields[index], self._sink.digest
        if just_read:
            together = [self._buffers[ranges.start][index][:, :just_read] for ranges in self._alike]
            digest.state_ranges(field, self._n_env, together)
        else:
            digest.state_columns(field, self._n_env, [states[index] for states in columns])

    def _block(self, columns: Sequence[States], column: int, index: int) -> tuple[Part, ...]:
        return state_parts(
            columns[column][index],
            first_step=self._held_first,
            stride=self._stride,
            env_start=self._starts[column],
            sim_time_ns=sim_time_ns(self._held_first, self._dt),
        )


def _joined(parts: Sequence[States]) -> States:
    return tuple(np.concatenate(pieces) for pieces in zip(*parts, strict=True))
