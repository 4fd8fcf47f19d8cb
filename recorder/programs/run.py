"""One run of a program: a fresh process, its folder, its memory, its end, and the processes that it leaves behind."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import Sampler
from gpusimbench.recorder.process.launch import Interruptions, how_it_died, last_line
from gpusimbench.recorder.programs.folder import VARIABLE, describe
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.commands.parent import signalled_at_its_end
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.writing import create

_INTERVAL_S = 0.1
HOST = "host"

GRACE_S = 10.0
"""How long a program whose time is over may take to end its recordings, before it is killed [s]."""

OUTPUT = "output.txt"
"""In the folder of a run: what the program prints."""

_PATIENCE_S = 5.0  # for processes that the kernel does not let end, such as those that wait for a disk
_SET_CHILD_SUBREAPER = 36  # prctl(2)


class ProgramMemory(Sampler[int]):
    """Reads 10 times a second the resident memory of a process and its descendants, and what each GPU has in use.

    NVML numbers processes by another namespace in most containers, so that memory of a GPU is that of the whole device.
    """

    def __init__(self, pid: int, gpus: Gpus) -> None:
        super().__init__("memory of the program", _INTERVAL_S)
        self._pid = pid
        self._gpus = gpus
        self.peaks: dict[str, int] = {}  # the largest reading of each source so far: "host", "gpu0", ... [bytes]

    def _read(self) -> None:
        self._try(HOST, self._read_host)
        for index in range(len(self._gpus)):
            self._try(f"gpu{index}", partial(self._read_gpu, index))

    def _read_host(self) -> None:
        import psutil

        root = psutil.Process(self._pid)
        total = 0
        for process in (root, *root.children(recursive=True)):
            try:
                total += process.memory_info().rss
            except psutil.Error:  # it has ended
                continue
        self._note(HOST, total)

    def _read_gpu(self, index: int) -> None:
        self._note(f"gpu{index}", self._gpus.device_memory(index)[0])

    def _note(self, source: str, used: int) -> None:
        self.peaks[source] = max(used, self.peaks.get(source, 0))


@dataclass(frozen=True)
class ProgramRun:
    """How a run ended.

    folder      of the run
    status      "ended" with exit code 0, "failed", "timeout" or "interrupted"
    reason      in a sentence; empty where it ended with exit code 0
    seconds     it took, by the clock
    peaks       the most memory [bytes]: "host", of the program and its processes; "gpu0", ..., of the whole device
    recordings  whole files that the program wrote into the folder, sorted
    partial     recordings that it did not end
    """

    folder: str
    status: str
    reason: str
    seconds: float
    peaks_bytes: dict[str, int]
    recordings: tuple[str, ...]
    partial: tuple[str, ...]


def new_folder(out: Path) -> Path:
    """Make the folder of the next run, out/run-K with the first K that is free. UsageError where it cannot be made."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for number in range(1_000_000):
            with suppress(FileExistsError):
                (out / f"run-{number}").mkdir()
                return out / f"run-{number}"
    except OSError as error:
        raise UsageError(f"cannot make a folder of a run in {out}: {error.strerror}") from None
    raise UsageError(f"{out} is full of runs")


def run_program(
    command: Sequence[str], folder: Path, *, time_limit: float, gpus: Gpus, interruptions: Interruptions
) -> ProgramRun:
    """Run a program to its end; what it started ends with it, and so do all other processes of this one.

    On Linux, what made a session of its own ends, too, where this process has adopted it (adopt).

    command     the program and its arguments
    folder      of the run; the environment variable VARIABLE names it to the program
    time_limit  then it is interrupted, and GRACE_S later killed [s]; 0: never

    UsageError where the program cannot be started, GsbError where its folder cannot be written.
    """
    describe(folder, command)
    begun = time.monotonic()
    try:
        child = _start(command, folder)
    except GsbError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    memory = ProgramMemory(child.pid, gpus)
    memory.start()
    interruptions.follow(child)
    late = False
    try:
        late = not _ends(child, time_limit)
        if late:
            _send(child, signal.SIGINT)
            _ends(child, GRACE_S)
    finally:
        _send(child, signal.SIGKILL)  # also what it left running
        child.wait()
        interruptions.follow(None)
        end_all()
        memory.stop()
    status, reason = _end(child.returncode, late, interruptions.count > 0, time_limit, folder)
    return ProgramRun(
        folder=str(folder),
        status=status,
        reason=reason,
        seconds=time.monotonic() - begun,
        peaks_bytes=memory.peaks,
        recordings=_files_with(folder, ".mcap"),
        partial=_files_with(folder, PARTIAL),
    )


def _start(command: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    with create(folder / OUTPUT) as printed:
        try:
            return subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT,
                env={**os.environ, VARIABLE: str(folder.absolute())}, start_new_session=True,
                preexec_fn=signalled_at_its_end(signal.SIGKILL, os.getpid()),
            )  # fmt: skip
        except FileNotFoundError:
            raise UsageError(f"there is no program {command[0]}") from None
        except OSError as error:
            raise UsageError(f"{command[0]} cannot be started: {error.strerror}") from None
        except ValueError as error:  # such as a null byte
            raise GsbError(f"{command[0]} cannot be started: {error}") from None


def _ends(child: subprocess.Popen[bytes], seconds: float) -> bool:
    """Wait for its end, so long at most [s], 0: however long; whether it came."""
    try:
        child.wait(seconds or None)
    except subprocess.TimeoutExpired:
        return False
    return True


def _send(child: subprocess.Popen[bytes], number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, number)


def _end(returncode: int, late: bool, interrupted: bool, time_limit: float, folder: Path) -> tuple[str, str]:
    if interrupted:
        return "interrupted", "interrupted"
    if late:
        return "timeout", f"did not end within {time_limit:g} s"
    if returncode == 0:
        return "ended", ""
    said = last_line(folder / OUTPUT)
    return "failed", how_it_died(returncode) + (f"; the last that it printed: {said}" if said else "")


def _files_with(folder: Path, ending: str) -> tuple[str, ...]:
    return tuple(sorted(str(path) for path in folder.rglob(f"*{ending}") if path.is_file()))


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
    if tell := signalled_at_its_end(signal.SIGUSR1, os.getppid()):
        signal.signal(signal.SIGUSR1, _ended)
        tell()


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
