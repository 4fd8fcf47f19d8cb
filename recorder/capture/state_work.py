"""The work on a block of states: hashes, the search for what is not finite, digests, and the messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.ranges import Arrays, Ranges
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import fingerprint_parts, state_parts
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mcap.assembly import NextMessages, Part, Records

PIECES = 8
"""Of a block, at least, to be shared among threads."""

Message = tuple[Part, ...]
NotFinite = tuple[int, int, str]
"""Row of the block, environment, and the name of the place."""

Hashed = tuple[Sequence[Message], list[NotFinite]]


def hash_messages(hashes: NDArray[np.uint64], *, first_step: int) -> Sequence[Message]:
    """State hashes [step, env] of consecutive steps."""
    return [fingerprint_parts(hashes, first_step=first_step, stride=1)]


class Read(NamedTuple):
    """Rows that were read, all of which are hashed.

    first_step  of the first of them
    groups      numbers of ranges of one size
    states      theirs, [range, row, env, item, width]
    whole       the same of all environments, [row, env, item, width]; empty where they do not lie so
    """

    first_step: int
    groups: Sequence[range]
    states: Sequence[Arrays]
    whole: Arrays = ()


class Stored(NamedTuple):
    """Rows that are written.

    first_step    of the first of them
    columns       by range of environments, [row, env, item, width]
    side_by_side  the same for each of Ranges.alike, [range, row, env, item, width]; empty where they do not lie so
    memory        number of the memory that they lie in, where a process works on them
    place         of their messages in the file, if their records can be made beforehand
    whole         the same of all environments, [row, env, item, width]; empty where they do not lie so
    """

    first_step: int
    columns: Sequence[Arrays]
    side_by_side: Sequence[Arrays] = ()
    memory: int = 0
    place: NextMessages | None = None
    whole: Arrays = ()

    @property
    def arrays(self) -> list[NDArray[np.floating]]:
        """Those of all messages, in the order of the file."""
        return [array for states in self.columns for array in states]


class StateStream(NamedTuple):
    """The states that a recording is given, block by block: what all blocks have in common.

    rows      that a block has room for
    may_fail  environments whose states need not be finite
    size      bytes of all states; 0: it is not known
    """

    fields: tuple[StateField, ...]
    n_env: int
    rows: int
    dt: float
    stride: int
    may_fail: frozenset[int]
    size: int


class Begun(NamedTuple):
    """Work that is under way.

    blocks     messages of each range and, within it, of each field; or, in one piece,
    records    the records of all these messages, group by group
    digesting  one for each field; the arrays are needed until all have come
    hashed     once: the messages of all hashes, and what is not finite
    """

    blocks: Iterable[Message]
    digesting: Iterable[object]
    hashed: Iterable[Hashed]
    records: Iterable[Records] = ()


class Work(Protocol):
    """Whoever does the work."""

    def begin(self, stored: Stored | None, read: Read | None) -> Begun:
        """Begin on rows to be written, and on rows to be hashed."""


class Piece(NamedTuple):
    """Rows of a group of ranges, whose hashes one thread or process makes.

    group  index of the group in Read.groups
    """

    group: int
    rows: slice


def hash_piece(
    fields: Sequence[StateField],
    ranges: Ranges,
    may_fail: frozenset[int],
    read: Read,
    piece: Piece,
    hashes: NDArray[np.uint64],
) -> list[NotFinite]:
    """Put the state hashes of a piece into `hashes` [row, env]; returns for each field the first number that is not
    finite.

    may_fail  environments whose states need not be finite
    """
    arrays = tuple(array[:, piece.rows] for array in read.states[piece.group])
    envs, first_row = ranges.envs(read.groups[piece.group]), piece.rows.start
    some, rows, each = arrays[0].shape[:3]
    found = []
    for field, array in zip(fields, arrays, strict=True):
        if np.isfinite(array).all():
            continue
        wrong = (~np.isfinite(array)).swapaxes(0, 1).reshape(rows, some * each, *array.shape[3:])
        wrong[:, np.isin(np.arange(envs.start, envs.stop), list(may_fail))] = False
        if wrong.any():
            row, env, item, _ = (int(i) for i in np.argwhere(wrong)[0])
            where = f"{field.name} of {field.items[item]}" if field.items[item] else field.name
            found.append((first_row + row, envs.start + env, where))
    hashes[first_row : first_row + rows, envs] = fingerprint(arrays).swapaxes(0, 1).reshape(rows, some * each)
    return found


def pieces_of(read: Read, least: int) -> list[Piece]:
    """All that was read in pieces: at least so many, where there are as many rows."""
    rows = read.states[0][0].shape[1]
    size = max(1, -(-rows * len(read.groups) // least))
    return [
        Piece(group, slice(row, min(row + size, rows)))
        for group in range(len(read.groups))
        for row in range(0, rows, size)
    ]


def digest_field(digest: ContentDigest, fields: Sequence[StateField], index: int, n_env: int, stored: Stored) -> None:
    """Feed the next rows of a field to its digest."""
    field = fields[index]
    if stored.whole:
        digest.state(field, n_env, stored.whole[index])
    elif stored.side_by_side:
        digest.state_ranges(field, n_env, [states[index] for states in stored.side_by_side])
    else:
        digest.state_columns(field, n_env, [states[index] for states in stored.columns])


def places_of(stored: Stored, fields: Sequence[StateField]) -> list[tuple[int, int]]:
    """Range of environments and field of each message, in the order of the file."""
    return [(column, field) for column in range(len(stored.columns)) for field in range(len(fields))]


def block_of(stored: Stored, place: tuple[int, int], ranges: Ranges, *, dt: float, stride: int) -> Message:
    """The message of a place."""
    column, index = place
    return state_parts(
        stored.columns[column][index],
        first_step=stored.first_step,
        stride=stride,
        env_start=ranges.starts[column],
        sim_time_ns=sim_time_ns(stored.first_step, dt),
    )


class StateWork:
    """Does the work by the threads of this process.

    digest  takes the states and the message of the hashes
    """

    def __init__(self, stream: StateStream, ranges: Ranges, digest: ContentDigest, workers: Workers) -> None:
        self._stream = stream
        self._ranges = ranges
        self._sha256 = digest
        self._workers = workers

    def begin(self, stored: Stored | None, read: Read | None) -> Begun:
        """See Work."""
        start = self._workers.start
        blocks: Iterable[Message] = ()
        digesting: Iterable[object] = ()
        hashed: Iterable[Hashed] = ()
        if stored is not None:
            blocks = start(
                lambda place: block_of(stored, place, self._ranges, dt=self._stream.dt, stride=self._stream.stride),
                places_of(stored, self._stream.fields),
            )
            digesting = start(
                lambda field: digest_field(self._sha256, self._stream.fields, field, self._ranges.n_env, stored),
                range(len(self._stream.fields)),
            )
        if read is not None:
            hashes = np.empty((read.states[0][0].shape[1], self._ranges.n_env), dtype=np.uint64)
            found = start(
                lambda piece: hash_piece(self._stream.fields, self._ranges, self._stream.may_fail, read, piece, hashes),
                pieces_of(read, 1 if self._workers.alone else PIECES),
            )
            hashed = start(lambda _: gathered(hashes, read.first_step, found, self._sha256), (0,))
        return Begun(blocks, digesting, hashed)


def gathered(
    hashes: NDArray[np.uint64], first_step: int, found: Iterable[list[NotFinite]], digest: ContentDigest
) -> Hashed:
    """The messages of the hashes [row, env] of a block, digested, once they are there, and what is not finite."""
    not_finite = [place for some in found for place in some]
    messages = hash_messages(hashes, first_step=first_step)
    for message in messages:
        digest.message(topics.fingerprint("capture"), *(part.data for part in message))
    return messages, not_finite
