"""The work on blocks of states by a process of its own.

Threads that hash, digest and check take the interpreter's lock again after each call of a library. An engine that
launches its kernels from Python waits meanwhile. A process does the same work in memory that both processes have, and
only writing is left to do here.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.capture.state_work import Begun, Hashed, Message, Read, StateStream, Stored
from gpusimbench.recorder.capture.work_child import Order, Shared, groups_of, messages_of
from gpusimbench.recorder.interruption import blocked
from gpusimbench.schemas.block_parts import raw_bytes
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.assembly import Part, Records

LEAST_CPUS = 4  # with fewer, the process takes them from the engine
LEAST_BYTES = 64 << 20  # of states: starting the process takes about as long as the work on them
_READY_S = 30.0
_LOOK_S = 1.0
_END_S = 10.0
_SILENT_S = 60.0  # without an answer, and without any work: it was stopped, or hangs
_MAIN = "import sys; sys.path += {path!a}; from gpusimbench.recorder.capture.work_child import main; main()"
_PYTHON = re.compile(r"python[\d.]*[dmtuw]*")
_KEPT = ("PYTHONHOME", "PYTHONPLATLIBDIR", "PYTHONPYCACHEPREFIX")  # some Pythons do not start without
_FIRST = 3  # descriptor that is none of the standard ones


def worthwhile(size: int | None) -> bool:
    """Whether states of `size` bytes are worth starting a process; None: their number is not known beforehand."""
    return (
        hasattr(os, "memfd_create")
        and len(os.sched_getaffinity(0)) >= LEAST_CPUS
        and (size is None or size >= LEAST_BYTES)
        and not hasattr(sys, "frozen")
        and _PYTHON.fullmatch(Path(sys.executable or "").name) is not None  # no program that has an interpreter within
    )


class WorkProcess:
    """A process that does the work on blocks (see state_work.Work). Raises OSError if it cannot be started.

    Put rows into `shared` once `ready` has returned True.
    """

    def __init__(self, stream: StateStream) -> None:
        from multiprocessing.connection import Pipe  # takes 15 ms to load, which whoever starts no process is spared

        stream = stream._replace(fields=_plain(stream.fields))
        self._owner = os.getpid()
        self._digests: dict[str, str] | None = None
        with ExitStack() as here, ExitStack() as failing:
            memory = _beyond(os.memfd_create("gsb-states"))
            here.callback(os.close, memory)
            self._connection, theirs = Pipe()
            failing.callback(self._connection.close)
            here.callback(theirs.close)
            number = _beyond(os.dup(theirs.fileno()))
            here.callback(os.close, number)
            self.shared = Shared(memory, stream)
            with blocked():  # the user's interruption is not for it
                self._child = subprocess.Popen(
                    [sys.executable, *_flags(), "-c", _MAIN.format(path=_path()), str(number), str(memory)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,  # why it does not start is not the user's concern: threads do the same
                    pass_fds=(number, memory),
                    env=_environment(),
                )
                failing.callback(self.close)
            here.close()  # a process that has died reads nothing, and only then that is found out
            with suppress(OSError), _no_broken_pipe():
                self._connection.send(stream)
            failing.pop_all()

    def ready(self) -> bool:
        """Wait until the process works, and return True; if it does not start, end it and return False."""
        with suppress(Exception):  # whatever keeps it from working, it has not begun
            if self._receive(_READY_S) == "ready":
                return True
        self._child.kill()
        self.close()
        return False

    def begin(self, stored: Stored | None, read: Read | None) -> Begun:
        """As Work.begin; the arrays must lie in `shared`."""
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
            self._records(len(groups_of(stored))) if stored and stored.place else (),
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
            self._kill()
            self._child.wait()

    def _blocks(self, stored: Stored) -> Iterator[Message]:
        yield from messages_of(self._receive(), stored.arrays)

    def _records(self, groups: int) -> Iterator[Records]:
        for _ in range(groups):
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
            with _no_broken_pipe():
                self._connection.send(order)
        except OSError:
            raise self._dead() from None

    def _receive(self, seconds: float = math.inf) -> Any:
        until = time.monotonic() + seconds
        silent, worked = 0.0, -1.0
        try:
            while not self._connection.poll(_LOOK_S):  # a copy of this process may hold the other end open
                if time.monotonic() > until or (self._child.poll() is not None and not self._connection.poll()):
                    raise self._dead()
                # counted, since a clock goes on while a job is stopped with all of its processes
                before, worked = worked, self._worked()
                silent = silent + _LOOK_S if worked == before else 0.0
                if silent >= _SILENT_S and not self._connection.poll():
                    self._kill()
                    raise RuntimeError(
                        f"the process that hashes and digests states, {self._child.pid}, did nothing for {silent:g} s: "
                        "it was stopped, or hangs, and has been killed"
                    )
            found = self._connection.recv()
        except (EOFError, ConnectionResetError):
            raise self._dead() from None
        if isinstance(found, Exception):
            raise found
        return found

    def _worked(self) -> float:
        """CPU time of the process and its copies [s]."""
        import psutil  # takes time to load, which nobody waits for where answers come in time

        total = 0.0
        for process in self._processes():
            with suppress(psutil.Error):
                total += sum(process.cpu_times()[:2])
        return total

    def _kill(self) -> None:
        import psutil

        # copies end by themselves when the process is gone, but not one that is stopped
        for process in self._processes():
            with suppress(psutil.Error):
                process.kill()

    def _processes(self) -> list[Any]:
        import psutil

        with suppress(psutil.Error):
            process = psutil.Process(self._child.pid)
            return [*process.children(), process]
        return []

    def _dead(self) -> RuntimeError:
        with suppress(subprocess.TimeoutExpired):
            self._child.wait(_LOOK_S)
        code = self._child.returncode
        how = "gave no answer" if code is None else f"ended with exit code {code}"
        how = f"was killed by signal {-code}" if code and code < 0 else how
        return RuntimeError(f"the process that hashes and digests states {how}")


@contextmanager
def _no_broken_pipe() -> Iterator[None]:
    """No SIGPIPE from the calling thread within the block, which ends a program that has its default action: the
    process may end at any moment. The call fails all the same."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE not in before:
            signal.sigtimedwait({signal.SIGPIPE}, 0)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGPIPE})


def _flags() -> list[str]:
    # its path is given to it; as -I, but that a Python that needs PYTHONHOME does not start without
    return ["-s", "-S", "-P", *(["-B"] if sys.dont_write_bytecode else [])]


def _environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON") or name in _KEPT}
    return {**kept, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def _path() -> list[str]:
    # behind the standard library: first what is loaded here, then the rest of what this process has, since a program
    # may have changed it. A user's logging.py in the working directory is not for the process
    from gpusimbench import schemas

    loaded = Path(schemas.__file__).absolute().parents[2], Path(np.__file__).absolute().parents[1]
    return list(dict.fromkeys([*map(str, loaded), *(str(Path(folder).absolute()) for folder in sys.path)]))


def _plain(fields: Sequence[StateField]) -> tuple[StateField, ...]:
    # names may be of classes of the user's, whose modules the process is not to load
    return tuple(StateField.from_json(json.loads(json.dumps(asdict(field)))) for field in fields)


def _beyond(descriptor: int) -> int:
    # the same beyond the standard ones, which are taken where a program has closed them; the process has its own
    import fcntl

    try:
        return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST)
    finally:
        os.close(descriptor)
