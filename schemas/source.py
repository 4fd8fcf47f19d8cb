"""The bytes of a file, wherever it is: a part is read when it is asked for."""

from __future__ import annotations

import mmap
import os
import stat
from abc import ABC, abstractmethod
from pathlib import Path

from gpusimbench.schemas.errors import DamagedRecording, NotARecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap.records import MAGIC

_MOST_WORKERS = 4


class Source(ABC):
    """A file that is read in parts.

    place    of the file, for messages of errors
    size     [byte], as it was when the file was opened
    near     a part that was read costs nothing to read again, and is what it was: a file that is mapped
    workers  threads that may read at the same time with profit
    """

    place: Place
    size: int
    near: bool
    workers: int

    @abstractmethod
    def read(self, begin: int, end: int) -> memoryview:
        """The bytes from `begin` up to `end`, which is not behind the end of the file.

        RecordingError where they cannot be had, or the file is not the one that was opened.
        """

    @abstractmethod
    def confirm(self) -> None:
        """DamagedRecording where the file was changed since it was opened, as far as that can be told."""


class MappedFile(Source):
    """A file of this machine. What is read of it is a view of the mapping.

    path   of the file
    place  that errors name, where it is not the path
    """

    near = True

    def __init__(self, path: Path, place: Place | None = None) -> None:
        self.place = place or path
        self._map = _mapped(path)
        self._data = memoryview(self._map)
        self.size = len(self._data)
        self.workers = min(_MOST_WORKERS, os.cpu_count() or 1)

    def read(self, begin: int, end: int) -> memoryview:
        """See Source.read."""
        self.confirm()
        return self._data[begin:end]

    def confirm(self) -> None:
        """See Source.confirm."""
        # Touching a page that the file has no more would end the process with SIGBUS.
        if self._map.size() < self.size:
            raise DamagedRecording(f"{self.place}: the file became shorter while it was read")


def _mapped(path: Path) -> mmap.mmap:
    try:
        # without O_NONBLOCK, opening a pipe would wait for its writer
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:
        raise NotARecording(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    try:
        found = os.fstat(descriptor)
        if stat.S_ISDIR(found.st_mode):
            raise NotARecording(f"cannot read {path}: Is a directory")
        if not stat.S_ISREG(found.st_mode):
            raise NotARecording(f"{path} is not a file")
        if found.st_size < len(MAGIC):
            raise NotARecording(f"{path} is not an MCAP file: it has fewer than {len(MAGIC)} bytes")
        return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise NotARecording(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    finally:
        os.close(descriptor)
