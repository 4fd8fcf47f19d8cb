"""What a process learns of its parent's end: a parent that is killed (SIGKILL) tells nobody, but Linux does."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable

_SET_PDEATHSIG = 1  # prctl(2)


def signalled_at_its_end(number: signal.Signals, parent: int) -> Callable[[], None] | None:
    """A function after whose call this process gets a signal once its parent has ended; None but on Linux.

    parent  process id; a parent that ended before the call is told by the signal as well

    For subprocess's `preexec_fn`: nothing is loaded by the call itself, which a child makes between fork and exec. To
    Linux the parent is the thread that forks: the thread that starts such a process has to wait for its end.
    """
    if not sys.platform.startswith("linux"):
        return None
    prctl = ctypes.CDLL(None).prctl

    def ask() -> None:
        prctl(_SET_PDEATHSIG, int(number), 0, 0, 0)
        if os.getppid() != parent:
            os.kill(os.getpid(), number)

    return ask
