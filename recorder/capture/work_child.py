"""The process that works on the states of another one (see work_process): what runs in it."""

from __future__ import annotations

import mmap
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.ranges import BlockMemory, Ranges, columns_of
from gpusimbench.recorder.capture.state_work import Message, NotFinite, Piece, Read, StateWork, Stored, hash_piece
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.schemas.configuration import EPOCH_NS, sim_time_ns
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import without_compiling
from gpusimbench.schemas.mcap.assembly import Assembly, Buffer, Place, Records

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READ, HELD = 0, 1  # numbers of memories
_RECORD_BYTES = 1024  # of a message beside its array, at most: heads, indexes
_MOST_HASHING = 4
_LOOK_S = 2.0  # between two looks at whether the process that is worked for is still there
_OWN = {
    signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGTRAP, signal.SIGSYS,
    signal.SIGCHLD,
}  # fmt: skip
"""Signals of its own; others, such as SIGUSR1 of Slurm to all processes of a job, are for the other process."""


class Task(NamedTuple):
    """What all blocks have in common.

    rows  that a block has room for
    """

    fields: tuple[StateField, ...]
    n_env: int
    rows: int
    dt: float
    stride: int
    may_fail: frozenset[int]


class Order(NamedTuple):
    """What is to be done next.

    stored  memory, rows, first step and place of what is written; None: nothing is
    read    rows and first step of what is hashed; None: nothing is
    """

    stored: tuple[int, int, int, Place | None] | None
    read: tuple[int, int] | None


class Shared:
    """Memory of both processes: rows that were read, rows that are held, hashes [row, env], and other bytes.

    The system gives what is used of it.
    """

    def __init__(self, descriptor: int, task: Task) -> None:
        block, ranges = BlockMemory.size(task.n_env, task.fields, task.rows), Ranges(task.n_env)
        hashes = task.rows * task.n_env * 8
        other = block + len(ranges.starts) * len(task.fields) * _RECORD_BYTES  # for small messages, their arrays too
        if os.fstat(descriptor).st_size == 0:
            os.ftruncate(descriptor, 2 * block + hashes + other)
        buffer = mmap.mmap(descriptor, 2 * block + hashes + other)
        self.memories = [BlockMemory(ranges, task.fields, task.rows, buffer, block * i) for i in (READ, HELD)]
        self.hashes = np.ndarray((task.rows, task.n_env), np.uint64, buffer=buffer, offset=2 * block)
        self._bytes = np.frombuffer(buffer, np.uint8)
        self._other = 2 * block + hashes

    def read(self, ranges: Ranges, rows: int, first_step: int) -> Read:
        """So many rows that were read."""
        groups = ranges.groups()
        return Read(first_step, groups, [self.memories[READ].part(group, slice(rows)) for group in groups])

    def put(self, pieces: Sequence[Buffer]) -> NDArray[np.int64]:
        """Where pieces are, [piece, (offset, size)]: in this memory, or copied there, until the next ones are."""
        begin, end = self._bytes.ctypes.data, self._other
        places: list[tuple[int, int]] = []
        for piece in pieces:
            array = np.frombuffer(piece, np.uint8)
            offset = array.ctypes.data - begin
            if 0 <= offset < self._other:
                places.append((offset, array.size))
                continue
            self._bytes[end : end + array.size] = array
            if places and sum(places[-1]) == end:
                places[-1] = (places[-1][0], places[-1][1] + array.size)
            else:
                places.append((end, array.size))
            end += array.size
        return np.array(places, np.int64).reshape(-1, 2)

    def get(self, places: NDArray[np.int64]) -> list[memoryview]:
        """The pieces that another process has put."""
        view = self._bytes.data
        return [view[offset : offset + size] for offset, size in places.tolist()]


class HashProcesses:
    """Copies of this process that hash states, each in one thread: hashes by numpy are many short calls, and threads
    that make such calls wait for each other's turn with the interpreter.

    They end with this process, whose end of their connections closes.
    """

    def __init__(self, task: Task, shared: Shared, ranges: Ranges, other: Connection) -> None:
        """other  connection of this process that is not theirs"""
        from multiprocessing.connection import Pipe

        self._connections: list[Connection] = []
        for _ in range(max(1, min(_MOST_HASHING, len(os.sched_getaffinity(0)) // 4))):
            ours, theirs = Pipe()
            if os.fork():
                theirs.close()
                self._connections.append(ours)
                continue
            try:
                for inherited in (*self._connections, ours, other):
                    inherited.close()
                _hash_until_closed(theirs, task, shared, ranges)
            finally:
                os._exit(0)

    def start(self, read: Read, pieces: Sequence[Piece], _: NDArray[np.uint64]) -> Iterator[list[NotFinite]]:
        """See state_work.Hash; the rows and the hashes are those of the shared memory."""
        rows = read.states[0][0].shape[1]
        for number, connection in enumerate(self._connections):
            connection.send((rows, pieces[number :: len(self._connections)]))
        return self._found()

    def _found(self) -> Iterator[list[NotFinite]]:
        for connection in self._connections:
            try:
                found = connection.recv()
            except (EOFError, ConnectionResetError):
                raise RuntimeError("a process that hashes states ended") from None
            if isinstance(found, Exception):
                raise found
            yield found


def _hash_until_closed(connection: Connection, task: Task, shared: Shared, ranges: Ranges) -> None:
    without_compiling()  # by several processes, numpy's hashes are there as soon
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            rows, pieces = connection.recv()
            read, hashes = shared.read(ranges, rows, 0), shared.hashes[:rows]
            try:
                found = [hash_piece(task.fields, ranges, task.may_fail, read, piece, hashes) for piece in pieces]
                connection.send([place for some in found for place in some])
            except Exception as error:
                connection.send(error if isinstance(error, MemoryError) else RuntimeError(f"{error}"))


def work(connection: Connection, memory: int) -> None:
    """Answer orders until the other end of the connection is closed.

    The first message is the Task. An Order is answered by the heads and CRCs of its blocks, or by the records of their
    messages; then by None once they are digested; then by head and CRC of the hashes' message, and what is not finite.
    Anything else is answered by the digests.
    """
    task: Task = connection.recv()
    shared, ranges, digest = Shared(memory, task), Ranges(task.n_env), ContentDigest()
    hashing = HashProcesses(task, shared, ranges, connection)  # before there are threads
    connection.send("ready")
    state_work = StateWork(
        task.fields, ranges, dt=task.dt, stride=task.stride, may_fail=task.may_fail, digest=digest,
        workers=Workers(small=False), hashes=lambda rows: shared.hashes[:rows], hash_by=hashing.start,
    )  # fmt: skip
    parent = os.getppid()
    while True:
        while not connection.poll(_LOOK_S):
            if os.getppid() != parent:  # a copy of it may hold the connection open
                return
        order = connection.recv()
        if not isinstance(order, Order):
            connection.send(digest.digests())
            continue
        stored = read = None
        if order.stored is not None:
            which, rows, first, place = order.stored
            together = shared.memories[which].side_by_side(slice(rows))
            stored = Stored(first, columns_of(together), together, place=place)
        if order.read is not None:
            rows, first = order.read
            read = shared.read(ranges, rows, first)
        begun = state_work.begin(stored, read)
        if stored is not None and stored.place is not None:
            records = assembled(stored.place, begun.blocks, EPOCH_NS + sim_time_ns(stored.first_step, task.dt))
            connection.send((shared.put(records.pieces), records._replace(pieces=())))
        elif stored is not None:
            connection.send([(bytes(head.data), array.crc) for head, array in begun.blocks])
        if stored is not None:
            for _ in begun.digesting:
                pass
            connection.send(None)
        for messages, found in begun.hashed:
            connection.send(([(bytes(head.data), hashes.crc) for head, hashes in messages], found))


def assembled(place: Place, messages: Iterable[Message], log_time: int) -> Records:
    """The records of messages at their place."""
    assembly = Assembly(place.offset)
    for channel, sequence, parts in zip(place.channels, place.sequences, messages, strict=True):
        assembly.message(channel, parts, log_time=log_time, publish_time=place.publish_time, sequence=sequence)
    return assembly.records()


def main() -> None:
    """Work on what the arguments say: descriptors of the connection and of the memory."""
    from multiprocessing.connection import Connection  # not where the other process loads this module

    for number in signal.valid_signals() - _OWN:
        with suppress(OSError):  # of those that cannot be ignored
            signal.signal(number, signal.SIG_IGN)  # the other process decides when this one ends
    connection = Connection(int(sys.argv[1]))
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        try:
            work(connection, int(sys.argv[2]))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            raise
        except Exception as error:
            connection.send(error if isinstance(error, MemoryError) else RuntimeError(f"{error}"))
    os._exit(0)  # at once: the other process waits, and nothing here is to be put in order
