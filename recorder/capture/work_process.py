"""The work on blocks of states by a process of its own.

Threads that hash, digest and check take the interpreter's lock again after each call of a library. An engine that
launches its kernels from Python waits meanwhile. A process does the same work in memory that both processes have, and
only writing is left to do here.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Pipe
from pathlib import Path
from typing import Any

from gpusimbench.recorder.capture.state_work import Begun, Hashed, Message, Read, Stored
from gpusimbench.recorder.capture.work_child import Order, Shared, Task
from gpusimbench.recorder.interruption import blocked
from gpusimbench.schemas.blocks import raw_bytes
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import expected
from gpusimbench.schemas.mcap.assembly import Part, Records

LEAST_CPUS = 4  # with fewer, the process takes them from the engine
LEAST_BYTES = 64 << 20  # of states: starting the process takes about as long as the work on them
_READY_S = 30.0
_LOOK_S = 1.0
_END_S = 10.0
_MAIN = "import sys; sys.path[:] = {path!r}; from gpusimbench.recorder.capture.work_child import main; main()"


def worthwhile(size: int | None) -> bool:
    """Whether a process is to work on so many bytes of states; None: it is not known how many there will be."""
    return (
        hasattr(os, "memfd_create")
        and len(os.sched_getaffinity(0)) >= LEAST_CPUS
        and (size is None or size >= LEAST_BYTES)
        and "python" in Path(sys.executable or "").name  # and no program that has an interpreter within
    )


class WorkProcess:
    """A process that does the work on blocks; see state_work.Work. OSError where none can be started.

    Rows are put into `shared`, which is there once the process is ready.
    """

    def __init__(
        self,
        fields: Sequence[StateField],
        *,
        n_env: int,
        rows: int,
        dt: float,
        stride: int,
        may_fail: frozenset[int],
        size: int | None,
    ) -> None:
        """rows  that a block has at most
        size  bytes of all states; None: it is not known
        """
        task = Task(tuple(fields), n_env, rows, dt, stride, may_fail, max(expected(), size or 0))
        self._owner = os.getpid()
        self._digests: dict[str, str] | None = None
        memory = os.memfd_create("gsb-states")
        self._connection, theirs = Pipe()
        try:
            self.shared = Shared(memory, task)
            with blocked():  # the user's interruption is not for it
                # its path is given to it; a Python that needs PYTHONHOME does not start without
                flags = ("-s", "-S") if "PYTHONHOME" in os.environ else ("-I", "-S")
                numbers = (theirs.fileno(), memory)
                self._child = subprocess.Popen(
                    [sys.executable, *flags, "-c", _MAIN.format(path=_path()), *map(str, numbers)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    pass_fds=numbers,
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
                )
            with suppress(OSError):  # it has died, and `ready` finds that out
                self._connection.send(task)
        except BaseException:
            self._connection.close()
            raise
        finally:
            theirs.close()
            os.close(memory)

    def ready(self) -> bool:
        """Whether the process works; returns once it does, and ends it where it does not."""
        with suppress(Exception):  # whatever keeps it from working, it has not begun
            if self._receive(_READY_S) == "ready":
                return True
        self._child.kill()
        self.close()
        return False

    def begin(self, stored: Stored | None, read: Read | None) -> Begun:
        """See Work; the arrays are those of `shared`."""
        self._send(
            Order(
                stored and (stored.memory, len(stored.columns[0][0]), stored.first_step, stored.place),
                read and (read.states[0][0].shape[1], read.first_step),
            )
        )
        return Begun(
            self._blocks(stored) if stored and not stored.place else (),
            self._digesting() if stored else (),
            self._hashed(read) if read else (),
            self._records() if stored and stored.place else (),
        )

    def digests(self) -> dict[str, str]:
        """Digests of the states and of the message of hashes, as of ContentDigest, once all are there.

        The process ends while the caller writes what is left to write.
        """
        if self._digests is None:
            self._send(None)
            self._digests = self._receive()
            self._connection.close()
        return self._digests

    def close(self) -> None:
        """End the process; a copy (os.fork) of the process that began it does not."""
        self._connection.close()
        if os.getpid() != self._owner:
            return
        try:
            self._child.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def _blocks(self, stored: Stored) -> Iterator[Message]:
        arrays = [array for states in stored.columns for array in states]
        for (head, crc), array in zip(self._receive(), arrays, strict=True):
            yield Part(head), Part(raw_bytes(array), crc)

    def _records(self) -> Iterator[Records]:
        places, records = self._receive()
        yield records._replace(pieces=self.shared.get(places))

    def _digesting(self) -> Iterator[None]:
        yield self._receive()

    def _hashed(self, read: Read) -> Iterator[Hashed]:
        messages, found = self._receive()
        hashes = raw_bytes(self.shared.hashes[: read.states[0][0].shape[1]])
        yield [(Part(head), Part(hashes, crc)) for head, crc in messages], found

    def _send(self, order: Order | None) -> None:
        if os.getpid() != self._owner:
            raise RuntimeError("the process that hashes and digests states works for another process")
        try:
            self._connection.send(order)
        except OSError:
            raise self._dead() from None

    def _receive(self, seconds: float = math.inf) -> Any:
        until = time.monotonic() + seconds
        try:
            while not self._connection.poll(_LOOK_S):  # a copy of this process may hold the other end open
                if time.monotonic() > until or (self._child.poll() is not None and not self._connection.poll()):
                    raise self._dead()
            found = self._connection.recv()
        except (EOFError, ConnectionResetError):
            raise self._dead() from None
        if isinstance(found, Exception):
            raise found
        return found

    def _dead(self) -> RuntimeError:
        with suppress(subprocess.TimeoutExpired):
            self._child.wait(_LOOK_S)
        code = self._child.returncode
        how = "gave no answer" if code is None else f"ended with exit code {code}"
        how = f"was killed by signal {-code}" if code and code < 0 else how
        return RuntimeError(f"the process that hashes and digests states {how}")


def _path() -> list[str]:
    # of this process, since a program may have changed it; this package may have been found by other means
    from gpusimbench import schemas

    path = [str(Path(folder).absolute()) for folder in sys.path]
    ours = str(Path(schemas.__file__).absolute().parent.parent.parent)
    return path if ours in path else [ours, *path]
