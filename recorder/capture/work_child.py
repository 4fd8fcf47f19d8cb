"""What runs in the process that work_process starts: it hashes, digests and checks states of the recording process."""

from __future__ import annotations

import mmap
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.ranges import BlockMemory, Ranges, columns_of, row_bytes
from gpusimbench.recorder.capture.state_work import (
    Message,
    Read,
    StateStream,
    Stored,
    block_of,
    digest_field,
    gathered,
    hash_piece,
    pieces_of,
    places_of,
)  # fmt: skip
from gpusimbench.schemas.block_parts import raw_bytes
from gpusimbench.schemas.configuration import EPOCH_NS, sim_time_ns
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.fingerprint import in_one_thread, load_compiled
from gpusimbench.schemas.mcap.assembly import CHUNK_BYTES, Assembly, Buffer, NextMessages, Part, Records

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READ, HELD = 0, 1  # numbers of memories
_RECORD_BYTES = 1024  # of a message beside its array, at most: heads, indexes
_MOST = 10  # processes that share the work
_GROUPS = 4  # of messages of a block
_PIECES = 4  # whose hashes each of them makes, about
_COMPILED_BYTES = 1_000_000_000  # of states: loading machine code pays
_DIGEST_NS, _HASH_NS = 0.9, 0.7  # that a byte takes, about: so that all have equally much to do
_LOOK_S = 2.0  # between two looks at whether the process that is worked for is still there
_OWN = {
    signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGTRAP, signal.SIGSYS,
    signal.SIGCHLD,
}  # fmt: skip
"""Signals of its own; others, such as SIGUSR1 of Slurm to all processes of a job, are for the other process."""


class Order(NamedTuple):
    """The next work.

    stored  memory, rows, first step and place of the rows to write; None: no row
    read    rows and first step of the rows to hash; None: no row
    """

    stored: tuple[int, int, int, NextMessages | None] | None
    read: tuple[int, int] | None


class Shared:
    """Memory that both processes share: rows that were read, rows that are held, hashes [row, env], and other bytes.

    The system allocates its pages on first use.
    """

    def __init__(self, descriptor: int, stream: StateStream) -> None:
        block, ranges = BlockMemory.size(stream.n_env, stream.fields, stream.rows), Ranges(stream.n_env)
        hashes = stream.rows * stream.n_env * 8
        other = block + len(ranges.starts) * len(stream.fields) * _RECORD_BYTES  # for small messages, their arrays too
        if os.fstat(descriptor).st_size == 0:
            os.ftruncate(descriptor, 2 * block + hashes + other)
        buffer = mmap.mmap(descriptor, 2 * block + hashes + other)
        self.memories = [BlockMemory(ranges, stream.fields, stream.rows, buffer, block * i) for i in (READ, HELD)]
        self.hashes = np.ndarray((stream.rows, stream.n_env), np.uint64, buffer=buffer, offset=2 * block)
        self._bytes = np.frombuffer(buffer, np.uint8)
        self._other = self._end = 2 * block + hashes

    def stored(self, order: Order) -> Stored | None:
        """The rows to write by an order."""
        if order.stored is None:
            return None
        which, rows, first, place = order.stored
        together = self.memories[which].side_by_side(slice(rows))
        return Stored(first, columns_of(together), together, place=place)

    def read(self, order: Order, ranges: Ranges) -> Read | None:
        """The rows to hash by an order."""
        if order.read is None:
            return None
        rows, first = order.read
        groups = ranges.groups()
        return Read(first, groups, [self.memories[READ].part(group, slice(rows)) for group in groups])

    def put(self, pieces: Sequence[Buffer], *, first: bool) -> NDArray[np.int64]:
        """Offset and size of each piece in this memory, [piece, 2]; others are copied here till the next first ones."""
        begin, end = self._bytes.ctypes.data, self._other if first else self._end
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
        self._end = end
        return np.array(places, np.int64).reshape(-1, 2)

    def get(self, places: NDArray[np.int64]) -> list[memoryview]:
        """The pieces that the other process put there."""
        view = self._bytes.data
        return [view[offset : offset + size] for offset, size in places.tolist()]


class _Sharing:
    """Copies of this process that share the work on a block, in one thread each. (Threads that hash by numpy make
    many short calls, and would wait for the interpreter's lock.)

    They end with this process, which closes their connections.
    """

    def __init__(self, stream: StateStream, shared: Shared, ranges: Ranges, other: Connection) -> None:
        """other  connection to the recording process, which the copies close"""
        from multiprocessing.connection import Pipe

        self._connections: list[Connection] = []
        self._processes: list[int] = []
        count = max(2, min(_MOST, len(os.sched_getaffinity(0)) * 5 // 8))
        for number in range(count):
            try:
                ours, theirs = Pipe()
                process = os.fork()
            except OSError:  # a limit of processes, or of descriptors: those that there are have ended when it is told
                self.end()
                raise
            if process:
                theirs.close()
                self._connections.append(ours)
                self._processes.append(process)
                continue
            try:
                for inherited in (*self._connections, ours, other):
                    inherited.close()
                _Share(stream, shared, ranges, number, count).work(theirs)
            finally:
                os._exit(0)

    def begin(self, order: Order | None) -> None:
        """Send the order to all copies."""
        for connection in self._connections:
            with suppress(BrokenPipeError, ConnectionResetError):  # that one has ended is found when it is to answer
                connection.send(order)

    def end(self) -> None:
        """End the copies and wait for them, so that their CPU time is counted with that of this process."""
        for connection in self._connections:
            connection.close()
        for process in self._processes:
            with suppress(ChildProcessError):  # the program ignores SIGCHLD, as this process then does
                os.waitpid(process, 0)

    def receive(self) -> list[Any]:
        """The next answer of each copy."""
        found = []
        for connection in self._connections:
            try:
                found.append(connection.recv())
            except (EOFError, ConnectionResetError):
                raise RuntimeError("a process that hashes and digests states ended") from None
            if isinstance(found[-1], Exception):
                raise found[-1]
        return found


class _Share:
    """The work of copy `number` of `count`: every count-th message, digests of some fields, and some hashes."""

    def __init__(self, stream: StateStream, shared: Shared, ranges: Ranges, number: int, count: int) -> None:
        self._stream, self._shared, self._ranges, self._number, self._count = stream, shared, ranges, number, count
        self._digest = ContentDigest()
        self._loads = [0.0] * count  # of a row's digests
        widths = [row_bytes(stream.n_env, [field]) for field in stream.fields]
        self._fields = dealt([_DIGEST_NS * width for width in widths], self._loads)[number]
        self._hash_ns = _HASH_NS * sum(widths)
        in_one_thread()

    def work(self, connection: Connection) -> None:
        """Answer orders until the connection is closed: with heads and CRCs; then None, once digested; then, once
        hashed, the places of values that are not finite. The order None is answered with the digests."""
        with suppress(EOFError, BrokenPipeError, ConnectionResetError):
            while True:
                order = connection.recv()
                try:
                    for answer in self._answers(order) if order else (self._digest.digests(),):
                        connection.send(answer)
                except (BrokenPipeError, ConnectionResetError):
                    raise
                except Exception as error:
                    connection.send(_picklable(error))

    def _answers(self, order: Order) -> Iterator[Any]:
        stream = self._stream
        stored, read = self._shared.stored(order), self._shared.read(order, self._ranges)
        if stored is not None:
            places = places_of(stored, stream.fields)
            for group in groups_of(stored):
                mine = places[group][self._number :: self._count]
                blocks = (block_of(stored, place, self._ranges, dt=stream.dt, stride=stream.stride) for place in mine)
                yield [(bytes(head.data), array.crc) for head, array in blocks]
            for index in self._fields:
                digest_field(self._digest, stream.fields, index, stream.n_env, stored)
            yield None
        if read is not None:
            hashes = self._shared.hashes[: read.states[0][0].shape[1]]
            pieces = pieces_of(read, _PIECES * self._count)
            loads = [load * len(stored.columns[0][0]) if stored else 0.0 for load in self._loads]
            costs = [self._hash_ns * (piece.rows.stop - piece.rows.start) * len(read.groups[piece.group])
                     / len(self._ranges.starts) for piece in pieces]  # fmt: skip
            to_hash = [pieces[index] for index in dealt(costs, loads)[self._number]]
            found = [hash_piece(stream.fields, self._ranges, stream.may_fail, read, piece, hashes) for piece in to_hash]
            yield [place for some in found for place in some]


def dealt(costs: Sequence[float], loads: list[float]) -> list[list[int]]:
    """Indices of the items of each holder, [holder, index]. Items go, the costliest first, to the holder with the least
    load, to which the cost is added."""
    hands: list[list[int]] = [[] for _ in loads]
    for index in sorted(range(len(costs)), key=lambda index: -costs[index]):
        holder = min(range(len(loads)), key=loads.__getitem__)
        hands[holder].append(index)
        loads[holder] += costs[index]
    return hands


def work(connection: Connection, memory: int) -> None:
    """Answer orders until the other end of the connection is closed.

    The first message is the StateStream. An Order is answered with the heads and CRCs of its blocks, or with the
    records of their messages, group by group; then None, once digested; then head and CRC of the hashes' message, with
    the places of values that are not finite. The order None is answered with the digests.
    """
    stream: StateStream = connection.recv()
    shared, ranges, digest = Shared(memory, stream), Ranges(stream.n_env), ContentDigest()
    if stream.size >= _COMPILED_BYTES:
        load_compiled()  # 1 to 2 s, before there are copies; the program waits for it before it captures
    sharing = _Sharing(stream, shared, ranges, connection)
    connection.send("ready")
    try:
        for order in _orders(connection):
            sharing.begin(order)
            if order is None:
                digests = digest.digests()
                for some in sharing.receive():
                    digests |= some
                connection.send(digests)
                continue
            stored, read = shared.stored(order), shared.read(order, ranges)
            if stored is not None:
                for answer in _written(stored, sharing, shared, stream):
                    connection.send(answer)
                sharing.receive()
                connection.send(None)
            if read is not None:
                hashes = shared.hashes[: read.states[0][0].shape[1]]
                parts, not_finite = gathered(hashes, read.first_step, sharing.receive(), digest)
                connection.send(([(bytes(head.data), array.crc) for head, array in parts], not_finite))
    finally:
        sharing.end()


def _orders(connection: Connection) -> Iterator[Order | None]:
    # until the process that is worked for is there no more: a copy of it may hold the connection open
    parent = os.getppid()
    while True:
        while not connection.poll(_LOOK_S):
            if os.getppid() != parent:
                return
        yield connection.recv()


def groups_of(stored: Stored) -> list[slice]:
    """Messages that are written together: while those of a group are written, those of the next are checked.

    A group begins with a message that is a chunk of its own, so that chunks are as if there were no groups.
    """
    sizes = [array.nbytes for array in stored.arrays]
    begins = [0]
    for least in range(len(sizes) // _GROUPS, len(sizes), -(-len(sizes) // _GROUPS)) if stored.place else ():
        large = (at for at in range(max(least, begins[-1] + 1), len(sizes)) if sizes[at] >= CHUNK_BYTES)
        begins += [next(large, len(sizes))]
    return [slice(begin, end) for begin, end in pairwise((*begins, len(sizes))) if begin < end]


def _written(stored: Stored, sharing: _Sharing, shared: Shared, stream: StateStream) -> Iterator[Any]:
    """Heads and CRCs of all messages, which the copies made in turn; or, group by group, the places of their records in
    the memory, and the rest of the Records."""
    place, arrays = stored.place, stored.arrays
    for group in groups_of(stored):
        shares = sharing.receive()
        heads = [shares[at % len(shares)][at // len(shares)] for at in range(sum(map(len, shares)))]
        if place is None:
            yield heads
            continue
        here = place._replace(channels=place.channels[group], sequences=place.sequences[group])
        records = assembled(
            here, messages_of(heads, arrays[group]), EPOCH_NS + sim_time_ns(stored.first_step, stream.dt)
        )
        place = place._replace(offset=place.offset + records.size)
        yield shared.put(records.pieces, first=not group.start), records._replace(pieces=())


def messages_of(heads: Sequence[tuple[bytes, int]], arrays: Sequence[NDArray[np.floating]]) -> Iterator[Message]:
    """The messages of arrays, from what is ahead of each, and its CRC."""
    for (head, crc), array in zip(heads, arrays, strict=True):
        yield Part(head), Part(raw_bytes(array), crc)


def assembled(place: NextMessages, messages: Iterable[Message], log_time: int) -> Records:
    """The records of messages, for their place in the file."""
    assembly = Assembly(place.offset)
    for channel, sequence, parts in zip(place.channels, place.sequences, messages, strict=True):
        assembly.message(channel, parts, log_time=log_time, publish_time=place.publish_time, sequence=sequence)
    return assembly.records()


def _picklable(error: Exception) -> Exception:
    # as the other process is sure to know it
    return error if isinstance(error, MemoryError) else RuntimeError(f"{error}")


def main() -> None:
    """Run the process; its arguments are the file descriptors of the connection and of the memory."""
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
            connection.send(_picklable(error))
    os._exit(0)  # at once: the other process waits, and nothing here is to be put in order
