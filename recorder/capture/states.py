"""States of a run to blocks: full-rate fingerprints, strided rows, canonical digests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.ranges import BlockMemory, Ranges, columns_of, row_bytes, steps_per_block
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.state_work import Begun, NotFinite, Read, StateStream, StateWork, Stored, Work
from gpusimbench.recorder.capture.view import ViewWriter
from gpusimbench.recorder.capture.work_child import HELD, READ
from gpusimbench.recorder.capture.work_process import WorkProcess, worthwhile
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.interruption import postponed, shielded
from gpusimbench.recorder.simulators.captured import Captured, Held, States
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import encode_fingerprints, little_endian
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import ALGORITHM, expect

_ALONE_BYTES = 2 << 20  # blocks up to this size are not worth other threads: 1.1 MB took a fifth more time with two


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


class _BegunRows(NamedTuple):
    """Rows that others make messages of.

    first_row  number of the first of them in the recording
    columns    their states, by range of environments
    last_step  the last of them
    time       simulated time of the first [ns]
    begun      the work on them
    """

    first_row: int
    columns: Sequence[States]
    last_step: int
    time: int
    begun: Begun


class StateWriter:
    """Writes the states of the capture phase.

    Rows are fed at full rate; every `stride`-th is stored, and every one is hashed. Ranges of environments, and fields,
    are worked on by several threads, of another process where that pays, so that the file keeps pace with a device.

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
        n_row: int | None = None,
    ) -> None:
        """first_step  number of the first state that will be fed
        may_fail    environments whose states need not be finite
        n_row       rows that will be fed in all; None: it is not known
        """
        self._sink = sink
        self.fields = tuple(fields)
        self._dt = dt
        self._stride = stride
        self._rows = steps_per_block(n_env, fields)
        self._ranges = Ranges(n_env)
        self._held: list[list[States]] = []  # by block that was fed, then by range of environments
        self._held_rows = 0
        self._held_first = 0
        row = row_bytes(n_env, fields)
        small = row * self._rows < _ALONE_BYTES
        self.workers = Workers(small=small)
        size = None if n_row is None else n_row * row
        stream = StateStream(self.fields, n_env, self._rows, dt, stride, may_fail, size or 0)
        self._threads = StateWork(stream, self._ranges, sink.digest, self.workers)
        self._memory: BlockMemory | None = None  # that blocks are read into, where they are not worked on as they came
        self._begun = False
        self._process: WorkProcess | None = None
        if not small and worthwhile(size):
            with suppress(Exception):  # no memory, no process, a program that lets none start: threads do the same
                self._process = WorkProcess(stream)
                sink.at_end(self._process.close)
        if self._process is None and size is not None:
            with postponed():  # compiling calls Python from C, where an interruption would be printed and forgotten
                expect(size)
        self._view = view
        self._first_step = first_step
        self.last_step = first_step - 1
        self.last_recorded_step = first_step - 1
        self._topics = [topics.state(f.group, f.field, start) for start in self._ranges.starts for f in self.fields]
        for field in self.fields:
            for start in self._ranges.starts:
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

    def begin(self) -> None:
        """Return once processes that work on states, if any, are there; the first states wait for them otherwise."""
        if self._begun:
            return
        # a process was begun with the writer, and takes a while until it works
        process, self._process = self._process, None  # threads go on where something strikes meanwhile
        if process is not None and process.ready():
            self._process = process
            self._sink.digest.add(self._process.digests)
            self._memory = self._process.shared.memories[READ]
        elif len(self._ranges.starts) > 1:
            self._memory = BlockMemory(self._ranges, self.fields, self._rows)
        self._begun = True

    def take(self, block: Captured, meanwhile: Callable[[], None] = lambda: None) -> str | None:
        """The same of a block that an engine made, of at most `steps_per_block` steps; its arrays are not needed when
        this returns.

        meanwhile  begins work of other threads on the same block, once theirs on its states is begun; what it raises
                   leaves the file without a good end
        """
        first = self.last_step + 1
        keep = slice(-first % self._stride, None, self._stride)
        self.begin()
        read = self._read_block(block, first)
        columns = columns_of(read.states)
        with shielded():  # hashes and rows stay in step, so that what was fed can be written after an interruption
            kept = [tuple(array[keep] for array in states) for states in columns]
            stored = len(kept[0][0])
            if self._held_rows + stored > self._rows:
                self.flush()  # no message has more rows than that
            whole = self._held_rows + stored >= self._rows or first == self._first_step
            as_read = whole and not self._held_rows and self._stride == 1  # and are written from where they were read
            if stored:
                if not self._held_rows:
                    self._held_first = first + keep.start
                self._held.append(kept if as_read else self._hold(kept, read, keep, whole=whole))
                self._held_rows += stored
            self.last_step += len(columns[0][0])
            # in this order: a file is written by one thread, which must not wait for hashes that others make meanwhile
            with self._sink.parting():  # states and their hashes, too
                found = self._write_and_look(read, meanwhile, whole=whole, as_read=as_read)
        if not found:
            return None
        row, env, what = min(found, key=lambda place: place[:2])  # of those of one row, the first field
        return f"a state is not finite: step {first + row}, env {env}, {what}"

    def _hold(self, kept: list[States], read: Read, keep: slice, *, whole: bool) -> list[States]:
        # rows in memory of their own, until the block is full
        if self._process is None:
            return kept if whole else [tuple(array.copy() for array in states) for states in kept]
        rows = slice(self._held_rows, self._held_rows + len(kept[0][0]))
        held = self._process.shared.memories[HELD].side_by_side(rows)
        for own, states in zip(held, read.states, strict=True):
            for to, array in zip(own, states, strict=True):
                np.copyto(to, array[:, keep])
        return columns_of(held)

    def _write_and_look(
        self, read: Read, meanwhile: Callable[[], None], *, whole: bool, as_read: bool
    ) -> list[NotFinite]:
        # rows that are held back where they are a whole block, and hashes of the new rows; what of them is not finite
        writing = self._begin_writing(read, as_read=as_read) if whole else None
        hashed = writing.begun.hashed if writing else self._work.begin(None, read).hashed
        meanwhile()
        if writing:
            self._end_writing(writing)
        messages, found = next(iter(hashed))
        time = sim_time_ns(read.first_step, self._dt)
        for message in messages:
            self._sink.write_parts(topics.fingerprint("capture"), message, sim_ns=time)
        self._sink.flush()
        return found

    @property
    def _work(self) -> Work:
        return self._process or self._threads

    def flush(self) -> None:
        """Write the rows that are held back for a full block."""
        with shielded():
            if self._held_rows:
                with self._sink.parting():
                    self._end_writing(self._begin_writing())
                self._sink.flush()

    def _begin_writing(self, read: Read | None = None, *, as_read: bool = False) -> _BegunRows:
        # of all rows that are held back
        # read     what is to be hashed meanwhile
        # as_read  the rows are those, where they were read
        held, self._held = self._held, []
        rows, self._held_rows = self._held_rows, 0
        together: list[States] = []
        if self._process is not None:
            together = self._process.shared.memories[READ if as_read else HELD].side_by_side(slice(rows))
            columns = columns_of(together)
        else:
            columns = held[0] if len(held) == 1 else [_joined(parts) for parts in zip(*held, strict=True)]
            # not where a block is looked at in the memory that it came in, though one before was read into the buffers
            if as_read and read is not None and self._memory is not None and self._memory.owns(read.states[0][0]):
                together = self._memory.side_by_side(slice(rows))
        # a process makes the records, too
        place = self._sink.place(self._topics, columns[0][0].nbytes) if self._process is not None else None
        whole = read.whole if as_read and read is not None else ()
        stored = Stored(self._held_first, columns, together, READ if as_read else HELD, place, whole)
        return _BegunRows(
            first_row=self._held_first // self._stride,
            columns=columns,
            last_step=self._held_first + (rows - 1) * self._stride,
            time=sim_time_ns(self._held_first, self._dt),
            begun=self._work.begin(stored, read),
        )

    def _end_writing(self, writing: _BegunRows) -> None:
        with self._sink.parting():
            self._write_blocks(writing)
        if self._view is not None:
            self._view.rows(writing.first_row, writing.columns, self._ranges.starts.step)

    def _write_blocks(self, writing: _BegunRows) -> None:
        written = 0
        for records in writing.begun.records:
            count = sum(records.counts.values())
            self._sink.append(self._topics[written : written + count], records)
            written += count
        if not writing.begun.records:
            self._sink.write_together(self._topics, writing.begun.blocks, sim_ns=writing.time)
        self._sink.flush()  # small ones wait for others, and their arrays are not theirs for much longer
        for _ in writing.begun.digesting:
            pass
        self.last_recorded_step = writing.last_step

    def _read_block(self, block: Captured, first: int) -> Read:
        if self._process is not None:  # few copies, as large as can be, none of which needs the interpreter
            groups = self._ranges.alike
            return Read(first, groups, [self._read(block, group) for group in groups])
        groups = self._ranges.groups()
        states = list(self.workers.start(lambda group: self._read(block, group), groups))
        return Read(first, groups, states, block.states(slice(None)) if isinstance(block, Held) else ())

    def _read(self, block: Captured, ranges: range) -> States:
        # [range, step, env, item, width]
        envs = self._ranges.envs(ranges)
        arrays = block.states(envs)
        self._check(arrays, envs.stop - envs.start)
        if len(self._ranges.starts) == 1 and self._process is None:
            if all(array.flags.c_contiguous for array in arrays):
                return tuple(little_endian(array)[np.newaxis] for array in arrays)
            self._memory = self._memory or BlockMemory(self._ranges, self.fields, self._rows)
        assert self._memory is not None
        filled = self._memory.part(ranges, slice(len(arrays[0])))
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


def _joined(parts: Sequence[States]) -> States:
    return tuple(np.concatenate(pieces) for pieces in zip(*parts, strict=True))
