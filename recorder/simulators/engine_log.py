"""What an engine prints: for engines that tell of dropped contacts in no other way than a line on standard error.

``EngineLog`` looks at everything that this process prints on file descriptors 1 and 2 while it is open, by Python or by
native code, and finds the lines that match a pattern:

    log = EngineLog()                                # in build, before the engine is started
    ...
    log.matches((r"Contact buffer overflow",))       # in gates, or after each step that was captured
    log.close()                                      # in close

Nothing is lost and nothing is changed of what is printed. A run's process prints to a file in its working folder, which
is read a second time here, from the place where it stood when the log was opened. A terminal or a pipe cannot be read
back: there, what is printed goes to a temporary file, and is passed on whenever the log is asked and when it is closed
or the process exits (not where the process is killed). No thread and no pipe stands in between, which an engine that
prints much while it holds Python's lock could wait for without end.

Of several logs that are open at once, each sees everything; they are best closed in the reverse order.
"""

from __future__ import annotations

import ctypes
import os
import re
import stat
import sys
import tempfile
import weakref
from collections.abc import Iterable
from contextlib import suppress

STANDARD = (1, 2)
_CHUNK = 1 << 20


class EngineLog:
    """The lines printed on file descriptors since it was opened, or since it was last asked."""

    def __init__(self, fds: tuple[int, ...] = STANDARD) -> None:
        """Begin to look; what was printed before is not seen. Linux only: files are found under /proc."""
        _flush()
        self._files: list[_Printed] = []
        self._spools: list[_Spool] = []
        seen: dict[tuple[int, int], _Spool | None] = {}
        for fd in fds:
            status = os.fstat(fd)
            identity = (status.st_dev, status.st_ino)
            if identity not in seen:  # both descriptors may lead to one file, and then to one temporary one
                seen[identity] = self._open(fd, stat.S_ISREG(status.st_mode))
            elif (spool := seen[identity]) is not None:
                spool.redirect(fd)
        self._finalize = weakref.finalize(self, _close, self._files, self._spools)

    def _open(self, fd: int, regular: bool) -> _Spool | None:
        if regular:
            self._files.append(_Printed(os.open(f"/proc/self/fd/{fd}", os.O_RDONLY)))
            return None
        spool = _Spool(fd)
        self._spools.append(spool)
        self._files.append(_Printed(os.dup(spool.fd)))
        return spool

    def matches(self, patterns: Iterable[str]) -> list[str]:
        """The lines, without their ends, in which any of these regular expressions is found.

        Lines are given once, in the order in which they were printed (those of descriptor 1 first, where the two lead
        to different files). A line that has not been finished yet is looked at, and looked at again once it is longer.
        """
        wanted = re.compile("|".join(f"(?:{pattern})" for pattern in patterns).encode())
        _flush()
        lines = [line for printed in self._files for line in printed.lines(wanted)]
        for spool in self._spools:
            spool.pass_on()
        return [line.decode(errors="replace").rstrip("\r\n") for line in lines]

    def close(self) -> None:
        """Pass on what is left and give the descriptors back. A second call does nothing."""
        self._finalize()


class _Printed:
    """A file that is being printed to, read from where it ended at first."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._position = os.fstat(fd).st_size

    def lines(self, wanted: re.Pattern[bytes]) -> list[bytes]:
        """Those of the new lines in which the pattern is found."""
        if os.fstat(self._fd).st_size < self._position:  # the file was emptied, as test runners do
            self._position = 0
        found: list[bytes] = []
        rest = b""
        while chunk := os.pread(self._fd, _CHUNK, self._position + len(rest)):
            *complete, rest = (rest + chunk).split(b"\n")
            found += filter(wanted.search, complete)
            self._position += sum(len(line) + 1 for line in complete)
        if rest and wanted.search(rest):
            found.append(rest)
            self._position += len(rest)
        return found

    def close(self) -> None:
        os.close(self._fd)


class _Spool:
    """A temporary file that stands in for a terminal or a pipe.

    fd  of the temporary file, at its own position for reading
    """

    def __init__(self, fd: int) -> None:
        # appended to, so that no descriptor's position matters
        handle, path = tempfile.mkstemp(prefix="engine-log-")
        os.close(handle)
        self._writer = os.open(path, os.O_WRONLY | os.O_APPEND)
        self.fd = os.open(path, os.O_RDONLY)
        os.unlink(path)
        self._passed = 0
        self._originals: dict[int, int] = {}
        self.redirect(fd)

    def redirect(self, fd: int) -> None:
        """Let this descriptor print here as well."""
        self._originals[fd] = os.dup(fd)
        os.dup2(self._writer, fd)

    def pass_on(self) -> None:
        """Print what is new where it was meant to go."""
        target = next(iter(self._originals.values()))
        while chunk := os.pread(self.fd, _CHUNK, self._passed):
            self._passed += os.write(target, chunk)

    def close(self) -> None:
        for fd, original in self._originals.items():
            os.dup2(original, fd)
        with suppress(OSError):  # whoever read the pipe may be gone
            self.pass_on()
        for handle in (*self._originals.values(), self._writer, self.fd):
            os.close(handle)


def _close(files: list[_Printed], spools: list[_Spool]) -> None:
    _flush()
    for file in files:
        file.close()
    for spool in spools:
        spool.close()


def _flush() -> None:
    """Bring what Python and the C library still hold to its descriptor."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed, or its reader is gone
            stream.flush()
    ctypes.CDLL(None).fflush(None)
