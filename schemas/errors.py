"""Every error that a user can meet, with the exit code that a command ends with.

GsbError                  1  something failed
├── UsageError            2  wrong usage of a command
├── RecordingError        3  a file cannot be read as what it should be
│   ├── NotARecording     3  it is something else: not MCAP, another profile, an unknown format version
│   ├── DamagedRecording  3  bytes are missing or changed
│   │   └── FailedCrc     3  bytes are not those that were written
│   └── Unreachable       3  it is elsewhere and cannot be had: no such file, no access, no connection
├── DataLost              3  finished, but data was lost
├── GateFailed            4  a regression, an audit mismatch, a broken rule
└── NothingComparable     5  nothing was measured
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes shared by all commands."""

    OK = 0
    FAILURE = 1
    USAGE = 2
    DATA_LOST = 3
    GATE_FAILED = 4
    NOTHING_COMPARABLE = 5


class GsbError(Exception):
    """An error with one message for the user: what was wrong and what to do."""

    exit_code = ExitCode.FAILURE

    advice = ""
    """What to do, where that is the same for all errors of a class and the message does not say it."""

    @property
    def advised(self) -> str:
        """The message, and what to do."""
        return "; ".join(filter(None, (str(self), self.advice)))


NUMBERS_OF_A_STRANGER = (ValueError, OverflowError, KeyError, IndexError, MemoryError)
"""What Python and numpy raise for numbers in a file that they cannot take: the file is damaged."""


class UsageError(GsbError):
    exit_code = ExitCode.USAGE


class RecordingError(GsbError):
    exit_code = ExitCode.DATA_LOST


class NotARecording(RecordingError):
    pass


class DamagedRecording(RecordingError):
    pass


class FailedCrc(DamagedRecording):
    advice = (
        "the file was changed or damaged after it was written: fetch it again from whoever recorded it; gsb-check FILE "
        "says what can still be read"
    )


@contextmanager
def damage_in(place: object) -> Iterator[None]:
    """Put `place`, the file or part of a file with the damage, before the message of a DamagedRecording."""
    try:
        yield
    except DamagedRecording as error:
        raise DamagedRecording(f"{place}: {error}") from None


class Unreachable(RecordingError):
    pass


class DataLost(GsbError):
    exit_code = ExitCode.DATA_LOST


class GateFailed(GsbError):
    exit_code = ExitCode.GATE_FAILED


class NothingComparable(GsbError):
    exit_code = ExitCode.NOTHING_COMPARABLE
