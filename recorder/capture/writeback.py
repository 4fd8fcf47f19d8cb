"""The way of a file's data to the disk, begun while the file is being written."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

_BYTES = 32 << 20
_PAGE = 4096  # the last one gets more data yet


class Writeback:
    """Has the operating system begin to write a file's data, 32 MiB at a time: so os.fsync has little left at the end.

    A thread asks for it, since a slow disk makes the caller wait. Nothing depends on it: os.fsync tells whether all
    data are on the disk, and what the disk did not take.

    descriptor  of the file
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._begun = 0  # bytes
        self._thread: threading.Thread | None = None

    def wrote(self, end: int) -> None:
        """The file has so many bytes."""
        end -= end % _PAGE
        if end - self._begun < _BYTES or (self._thread is not None and self._thread.is_alive()):
            return
        thread = threading.Thread(
            target=_begin, args=(self._descriptor, self._begun, end), name="writeback", daemon=True
        )
        with suppress(RuntimeError):  # the system has no thread left
            thread.start()
            self._begun, self._thread = end, thread

    def end(self) -> None:
        """Return once the thread does not need the descriptor any more."""
        if self._thread is not None:
            self._thread.join()


def _begin(descriptor: int, begin: int, end: int) -> None:
    # Linux begins to write the pages of the range, and forgets those that are on the disk: of the newest ones, none
    if hasattr(os, "posix_fadvise"):
        with suppress(OSError):
            os.posix_fadvise(descriptor, begin, end - begin, os.POSIX_FADV_DONTNEED)
