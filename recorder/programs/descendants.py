"""Processes that a program leaves behind, also those that made sessions of their own; and a process that is left."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from contextlib import suppress

from gpusimbench.schemas.commands.parent import signalled_at_its_end
from gpusimbench.schemas.errors import ExitCode

_PATIENCE_S = 5.0  # for processes that the kernel does not let end, such as those that wait for a disk
_SET_CHILD_SUBREAPER = 36  # prctl(2)


def adopt() -> bool:
    """Have what processes of this one leave behind become its own children, not those of the system's first process.

    Linux alone has that (prctl(2), PR_SET_CHILD_SUBREAPER). Returns whether it is so.
    """
    if not sys.platform.startswith("linux"):
        return False
    return bool(ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0) == 0)


def end_with_parent() -> None:
    """Have SystemExit raised in the main thread once the parent of this process has ended, however it did.

    On Linux alone.
    """
    if tell := signalled_at_its_end(signal.SIGUSR1):
        parent = os.getppid()
        signal.signal(signal.SIGUSR1, _ended)
        tell()
        if os.getppid() != parent:
            _ended()


def _ended(*_: object) -> None:
    raise SystemExit(int(ExitCode.FAILURE))


def end_all() -> None:
    """Kill all processes that descend from this one, and those that they start meanwhile, until none is left.

    Without `adopt`, those whose parents have ended are not found.
    """
    import psutil

    until = time.monotonic() + _PATIENCE_S
    while left := psutil.Process().children(recursive=True):
        for process in left:
            with suppress(psutil.Error):
                process.kill()
        if psutil.wait_procs(left, timeout=max(0.0, until - time.monotonic()))[1]:
            return
