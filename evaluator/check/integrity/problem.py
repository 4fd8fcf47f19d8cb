"""What can be wrong with a file, by kind, and a collection of it that no file can make grow without end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum

from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, GsbError

MAX_KEPT = 20
"""Problems of one kind that are told in full; of the others their number is."""


class Kind(Enum):
    """Kinds of problems, each with what it means. Rules ask for one by its name."""

    not_a_recording = "the file is no MCAP, of another profile or format version, or says nothing of its run"
    cut_short = "the file does not end as an MCAP file ends"
    record = "a record contradicts its own length, is where it cannot be, or there is one too many or too few of it"
    unknown_record = "a record is of no type that MCAP has"
    chunk_crc = "a chunk fails its CRC, or cannot be decompressed"
    attachment_crc = "an attachment fails its CRC"
    data_crc = "the data section fails its CRC"
    summary_crc = "the summary fails its CRC"
    crc_missing = "a CRC that the format asks for is not there"
    index = "an index of messages disagrees with the messages"
    summary = "the summary disagrees with the data section"
    library = "the mcap library does not read the file, or reads something else"
    sequence = "messages of a topic are missing, or there twice"
    end = "there is not exactly one end record, behind everything else"
    digest = "a digest of the end record is not that of the content"
    content_hash = "the content hash is not that of the end record's digests"
    stream = "a stream cannot be read as what it should be"
    state_hash = "a recorded state hash is not that of the state"
    fingerprint = "a step has no state hashes"
    clock = "a clock runs backwards, or a phase has no end"
    contradiction = "two parts of the file say what cannot both be"
    dropout = "the recorder says that data was lost"
    view = "what viewers are told to draw is not what the states say"
    unconfirmed = "the file has an end record, and still the name under which it was written"
    observer = "the states of the timed phase and of the capture phase differ at the same step"


REMARKS = frozenset({Kind.unknown_record, Kind.crc_missing, Kind.unconfirmed, Kind.observer})
"""Kinds that are worth knowing; the file can be used."""

DAMAGE = frozenset(Kind) - REMARKS - {Kind.fingerprint, Kind.clock, Kind.contradiction}
"""Kinds that mean that bytes are missing or changed, or that data was lost."""


OF_STREAMS = (
    Kind.stream,
    Kind.state_hash,
    Kind.fingerprint,
    Kind.clock,
    Kind.contradiction,
    Kind.dropout,
    Kind.view,
    Kind.observer,
)
"""Kinds that are found by reading a recording's streams."""

WHOLE_CONTENT = (Kind.summary, Kind.summary_crc, Kind.library, Kind.digest, Kind.content_hash, *OF_STREAMS)
"""Kinds that are looked for only where a whole file is verified."""


class Problems:
    """Problems of one file, in order of their being found."""

    def __init__(self) -> None:
        self._found: dict[Kind, list[str]] = {}
        self._more: dict[Kind, int] = {}
        self._skipped: dict[Kind, str] = {}

    def skip(self, reason: str, *kinds: Kind) -> None:
        """Kinds that were not looked for, or not everywhere, and why: that there is none is not known."""
        for kind in kinds:
            self._skipped.setdefault(kind, reason)

    def skipped(self, kind: Kind) -> str:
        """Why a kind was not looked for; empty where it was."""
        return self._skipped.get(kind, "")

    def add(self, kind: Kind, what: str) -> None:
        """Add one; of many of a kind the first MAX_KEPT are kept."""
        found = self._found.setdefault(kind, [])
        if what in found:
            return
        if len(found) < MAX_KEPT:
            found.append(what)
        else:
            self._more[kind] = self._more.get(kind, 0) + 1

    def of(self, kind: Kind) -> tuple[str, ...]:
        """All of one kind, the last entry telling of how many more there are."""
        more = self._more.get(kind, 0)
        return (*self._found.get(kind, ()), *([f"and {more} more of this kind"] if more else []))

    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of which there are any."""
        return tuple(self._found)

    @contextmanager
    def noting(self, kind: Kind, *unknown: Kind, path: object = "") -> Iterator[None]:
        """Damage that is met inside is a problem of this kind; whatever else is raised goes on.

        unknown  kinds that are then not looked for
        path     of the file, which messages of errors begin with and a problem does not repeat
        """
        with self._caught(path) as reasons:
            yield
        for reason in reasons:
            self.add(kind, reason)
            self.skip(reason, *unknown)

    @contextmanager
    def skipping(self, *kinds: Kind, path: object = "") -> Iterator[None]:
        """Damage that is met inside ends the search for these kinds, and is told as a problem elsewhere."""
        with self._caught(path) as reasons:
            yield
        for reason in reasons:
            self.skip(reason, *kinds)

    @contextmanager
    def _caught(self, path: object) -> Iterator[list[str]]:
        reasons: list[str] = []
        try:
            yield reasons
        except GsbError as error:
            reasons.append(without_path(error, path))
        except NUMBERS_OF_A_STRANGER as error:
            reasons.append(str(error) or type(error).__name__)


def without_path(error: GsbError, path: object) -> str:
    """The message of an error without the name of the file that it begins with."""
    text = str(error)
    return text.removeprefix(f"{path}: ").removeprefix(f"{path} ") if path else text
