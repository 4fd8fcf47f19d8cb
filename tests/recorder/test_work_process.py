"""The process that hashes and digests states: the same bytes as by threads, and no hang or silent loss when it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from multiprocessing import connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.capture import ranges, sink, states, work_child, work_process
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.state_work import StateStream
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.vector.device.jax_rows import JaxRows
from gpusimbench.recorder.vector.device.log import About, DeviceLog, HostLog
from gpusimbench.recorder.vector.modes import Mode
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.fields import StateField, body_field
from tests.conftest import has_ended, wait_for
from tests.reading import verified

BODIES = ("red", "blue", "green")
FIELDS = (body_field("cubes", "position", "float32", BODIES), body_field("cubes", "linear_velocity", "float32", BODIES))
KILLED = "the process that hashes and digests states was killed by signal 9"


@pytest.fixture(autouse=True)
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Let a process do the work, whatever this machine has; and leave none behind."""
    monkeypatch.setattr(work_process, "LEAST_CPUS", 1)
    monkeypatch.setattr(work_process, "LEAST_BYTES", 1)
    monkeypatch.setattr(work_process, "_READY_S", 300.0)
    monkeypatch.setattr(states, "_ALONE_BYTES", 1)
    yield monkeypatch
    assert not helpers()


def helpers(of: int | None = None) -> list[psutil.Process]:
    """Processes that work for a process, this one if no other is named."""
    found = []
    for child in psutil.Process(of).children():
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            while not (command := child.cmdline()):  # Popen returns before Linux shows the new program's command
                time.sleep(0.001)
            if "work_child" in " ".join(command):
                found.append(child)
    return found


def helper() -> psutil.Process:
    """The process that works for this one."""
    (found,) = helpers()
    return found


def drawn(n_step: int, n_env: int, fields: Sequence[StateField] = FIELDS) -> list[np.ndarray]:
    """States of some steps."""
    rng = np.random.default_rng(n_step)
    return [rng.standard_normal((n_step, n_env, len(f.items), f.width)).astype(f.dtype) for f in fields]


class Case(NamedTuple):
    """What is fed; `counts` are numbers of rows that come together, `beside` says whether others write small messages
    between them."""

    n_env: int
    counts: tuple[int, ...]
    stride: int = 1
    first_step: int = 0
    dtype: str = "float32"
    not_finite: tuple[int, int] | None = None  # step and environment
    may_fail: frozenset[int] = frozenset()
    compression: str = "none"
    block_bytes: int = 128 << 20
    beside: bool = False
    n_row: int | None = None  # how many are said to follow


CASES = {
    "one range": Case(10, (1, 50, 50)),
    "one range, held": Case(10, (1, 20, 20, 20, 50, 3)),
    "ranges, the last one odd": Case(150, (1, 50, 30, 30, 50)),
    "equal ranges": Case(128, (1, 50, 7)),
    "stride": Case(150, (1, 50, 50, 50, 11), stride=3),
    "stride within a range, from a later step": Case(10, (1, 40, 40, 40), stride=4, first_step=8),
    "float64": Case(150, (1, 50, 9), dtype="float64"),
    "not finite": Case(150, (1, 50, 50), not_finite=(60, 149)),
    "not finite, as it may be": Case(150, (1, 50), not_finite=(5, 3), may_fail=frozenset((3,))),
    "compressed": Case(150, (1, 50, 9), compression="lz4"),
    "beside small messages": Case(150, (1, 50, 50, 20, 50), beside=True),
    "large ones beside small messages": Case(150, (1, 50, 50, 20, 50), dtype="float64", beside=True),
    "hashes by machine code": Case(150, (1, 50, 9), n_row=10**9),
    "few rows a block": Case(3000, (1, 9, 30), block_bytes=1 << 20),
}


def made(path: Path, case: Case) -> tuple[bytes, dict[str, str], list[str | None], bool]:
    """Bytes and digests of a file, what was not finite, and whether a process did the work."""
    fields = [replace(field, dtype=case.dtype) for field in FIELDS]
    arrays = drawn(sum(case.counts), case.n_env, fields)
    if case.not_finite:
        arrays[1][(*case.not_finite, 1, 2)] = np.nan
    file = Sink(path, compression=case.compression)
    writer = StateWriter(
        file, fields, n_env=case.n_env, dt=0.1, stride=case.stride, first_step=case.first_step, may_fail=case.may_fail,
        n_row=case.n_row,
    )  # fmt: skip
    found, row, worked = [], 0, bool(helpers())
    file.channel("/beside", "gsb.v1.Event")
    for count in case.counts:
        if case.beside:
            file.write("/beside", b"", sim_ns=row)
        found.append(writer.feed([array[row : row + count] for array in arrays]))
        row += count
    writer.flush()
    digests = file.digest.digests()
    writer.workers.end()
    file.abandon()
    return file.partial.read_bytes(), digests, found, worked


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_bytes_are_those_of_threads(case: Case, tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Write the same file, whoever works on the states."""
    process.setattr(sink, "calendar_ns", lambda: 7)
    process.setattr(ranges, "BLOCK_BYTES", case.block_bytes)
    process.setattr(states, "expect", lambda _: None)  # that this process loads machine code is not the question
    one = made(tmp_path / "process.mcap", case)
    process.setattr(work_process, "LEAST_CPUS", sys.maxsize)
    other = made(tmp_path / "threads.mcap", case)
    assert one[:3] == other[:3]
    assert (one[3], other[3]) == (True, False)
    assert any(one[2]) == (case.not_finite is not None and not case.may_fail)


@pytest.mark.parametrize("n_row", [1000, 10**9])
def test_machine_code_hashes_many_states(n_row: int, tmp_path: Path) -> None:
    """Load machine code before there are states where a recording is large, and not where it is small."""
    pytest.importorskip("numba")
    file = Sink(tmp_path / "a.mcap", compression="none")
    StateWriter(file, FIELDS, n_env=150, dt=0.1, stride=1, n_row=n_row).begin()
    loaded = [part.path for part in helper().memory_maps() if "llvmlite" in part.path]
    assert bool(loaded) == (n_row > 1000)
    file.abandon()


def writer(path: Path, **others: Any) -> RecordingWriter:
    """A writer of 100 environments with an open end."""
    announced = {"simulator": "mine", "version": "1", "scene": "toss", "n_env": 100, "dt": 0.1, "fields": FIELDS}
    return RecordingWriter(path, **{**announced, "steps": None, **others})


def whole(path: Path, n_step: int) -> bool:
    """Whether a recording is complete and as it should be."""
    recording = verified(path)
    same = np.array_equal(recording.state("cubes", "position")[:], drawn(n_step, 100)[0])
    return recording.status == "complete" and same


def test_rows_of_a_device(tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Work on what gpusimbench.record_rollout hands over of environments on a device."""
    contents = []
    for name, cpus in (("process", 1), ("threads", sys.maxsize)):
        process.setattr(work_process, "LEAST_CPUS", cpus)
        about = About("a", "1", "b", "cpu", Mode.NEXT_STEP, False, {})
        log = HostLog(tmp_path / f"{name}.mcap", steps=None, dt=0.1, about=about)
        rng = np.random.default_rng(0)
        for rows in (1, 400, 37):
            columns = {
                "observation": rng.standard_normal((rows, 300, 5)).astype(np.float32),
                "reward": rng.standard_normal((rows, 300)).astype(np.float32),
                "terminated": rng.random((rows, 300)) < 0.1,
                "truncated": np.zeros((rows, 300), dtype=bool),
            }
            log.append(columns, {})
        assert bool(helpers()) == (cpus == 1)
        log.end(None)
        recording = verified(tmp_path / f"{name}.mcap")
        assert recording.status == "complete"
        contents.append({field.name: recording.state(field.group, field.field)[:] for field in recording.fields})
    assert contents[0].keys() == contents[1].keys()
    for name, array in contents[0].items():
        assert len(array) == 438 and np.array_equal(array, contents[1][name]), name


@pytest.mark.parametrize("cpus", [1, sys.maxsize])
def test_while_a_device_steps(cpus: int, tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Rows of gpusimbench.wrap of environments on a device go to processes, or stay with the one thread that writes
    them."""
    jax = pytest.importorskip("jax")
    process.setattr(work_process, "LEAST_CPUS", cpus)
    about = About("a", "1", "b", "cpu", Mode.NEXT_STEP, False, {})
    row = {
        "observation": jax.numpy.ones((300, 5)),
        "reward": jax.numpy.ones(300),
        "terminated": jax.numpy.zeros(300, dtype=bool),
        "truncated": jax.numpy.zeros(300, dtype=bool),
    }
    before = threading.enumerate()
    log = DeviceLog(JaxRows(), 60)
    log.begin(row, HostLog(tmp_path / "a.mcap", steps=60, dt=0.1, about=about))
    for _ in range(60):
        assert bool(helpers()) == (cpus == 1)
        assert not [t for t in threading.enumerate() if t.name.startswith("capture") and t not in before]
        log.make_room()
        log.keep(row)
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"


@pytest.mark.parametrize("when", ["between rows", "at the end"])
@pytest.mark.parametrize("who", [KILLED, "a process that hashes and digests states ended"])
def test_a_process_is_killed(who: str, when: str, tmp_path: Path) -> None:
    """Say that data are lost, and leave an incomplete file and no process, where one that works is killed."""
    path, rows, working = tmp_path / "a.mcap", drawn(200, 100), []

    def record() -> None:
        with writer(path) as log:
            log.append(*(array[:100] for array in rows))
            working.extend([helper(), *helper().children()])
            working[0 if who == KILLED else -1].kill()
            if when == "between rows":
                log.append(*(array[100:] for array in rows))

    with pytest.raises(DataLost, match=f"writing stopped: {who}; what was written is in .*partial"):
        record()
    assert len(working) > 2
    wait_for(lambda: all(map(has_ended, working)))
    assert not path.exists()
    recording = verified(tmp_path / "a.mcap.partial")
    assert recording.status == "incomplete"


@pytest.mark.parametrize("copy", [False, True])
def test_a_process_is_stopped(copy: bool, tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Do not wait for ever where one that works is stopped: kill all of them, and say that data are lost."""
    process.setattr(work_process, "_LOOK_S", 0.05)
    rows, working = drawn(200, 100), []

    def record() -> None:
        with writer(tmp_path / "a.mcap") as log:
            log.append(*(array[:100] for array in rows))
            working.extend([helper(), *helper().children()])
            working[-1 if copy else 0].suspend()
            process.setattr(work_process, "_SILENT_S", 1.0)  # not while it starts, which may take as long
            log.append(*(array[100:] for array in rows))

    with pytest.raises(
        DataLost, match=r"did nothing for 1 s: it was stopped, or hangs, and has been killed; what was wr"
    ):
        record()
    wait_for(lambda: all(map(has_ended, working)))
    recording = verified(tmp_path / "a.mcap.partial")
    assert recording.status == "incomplete"


def test_a_job_that_is_stopped_goes_on(tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Write everything where one that works was stopped for less time than that."""
    process.setattr(work_process, "_LOOK_S", 0.05)
    rows = drawn(200, 100)
    with writer(tmp_path / "a.mcap") as log:
        log.append(*(array[:100] for array in rows))
        stopped = helper()
        stopped.suspend()
        threading.Timer(0.5, stopped.resume).start()
        log.append(*(array[100:] for array in rows))
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"


def test_a_program_that_goes_on_after_that(tmp_path: Path) -> None:
    """Refuse all rows after data were lost."""
    rows = drawn(200, 100)
    with pytest.raises(DataLost, match=KILLED), writer(tmp_path / "a.mcap") as log:
        log.append(*(array[:100] for array in rows))
        helper().kill()
        for begin in (100, 150):
            with pytest.raises(DataLost, match="writing stopped"):
                log.append(*(array[begin : begin + 50] for array in rows))
        raise DataLost(KILLED)


class Struck(BaseException):
    """What a handler of a signal may raise."""


@pytest.mark.parametrize("call", [2, 3, 5])
def test_a_handler_that_raises(call: int, tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Give the file no good end where something strikes between an order and its answer."""
    answers, receive = [], work_process.WorkProcess._receive

    def struck(self: work_process.WorkProcess, *seconds: float) -> Any:
        answers.append(1)
        if len(answers) == call:
            raise Struck
        return receive(self, *seconds)

    process.setattr(work_process.WorkProcess, "_receive", struck)
    rows = drawn(150, 100)
    with pytest.raises(DataLost, match="writing stopped: Struck"), writer(tmp_path / "a.mcap") as log:
        for begin in (0, 50, 100):
            with suppress(Struck, DataLost):
                log.append(*(array[begin : begin + 50] for array in rows))
    assert not (tmp_path / "a.mcap").exists()
    recording = verified(tmp_path / "a.mcap.partial")
    assert recording.status == "incomplete"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_of_the_user(number: signal.Signals, tmp_path: Path) -> None:
    """Leave it to the recording program what an interruption means."""
    with writer(tmp_path / "a.mcap") as log:
        helper().send_signal(number)  # before it has begun to work
        log.append(*(array[:60] for array in drawn(100, 100)))
        helper().send_signal(number)
        log.append(*(array[60:] for array in drawn(100, 100)))
    assert whole(tmp_path / "a.mcap", 100)


@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGQUIT, signal.SIGALRM, signal.SIGTSTP, signal.SIGRTMIN])
def test_signals_to_all_processes_of_a_job(number: signal.Signals, tmp_path: Path) -> None:
    """Go on where a scheduler sends a signal to all processes of a job, for the program to take."""
    rows = drawn(100, 100)
    with writer(tmp_path / "a.mcap") as log:
        log.append(*(array[:60] for array in rows))
        helper().send_signal(number)
        log.append(*(array[60:] for array in rows))
    assert whole(tmp_path / "a.mcap", 100)


def test_a_handler_that_raises_while_the_process_starts(tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Let threads do the work then, of whatever is given from there on."""

    def struck(self: work_process.WorkProcess, *seconds: float) -> Any:
        raise Struck

    process.setattr(work_process.WorkProcess, "_receive", struck)
    with writer(tmp_path / "a.mcap") as log:
        with pytest.raises(Struck):
            log.append(*drawn(60, 100))
        log.append(*drawn(60, 100))
    assert whole(tmp_path / "a.mcap", 60)


def test_modules_of_the_user(tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Load none of the user's modules in the process, whatever they are named and whatever names items have."""
    for name in ("struct", "logging", "random", "hashlib", "mine"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'loaded')!r}, 'w')\n")
    process.syspath_prepend(str(tmp_path))
    body = StrEnum("body", {name.upper(): name for name in BODIES}, module="mine")
    named = tuple(replace(field, items=tuple(body)) for field in FIELDS)
    with writer(tmp_path / "a.mcap", fields=named) as log:
        log.append(*drawn(60, 100))
        assert helper()
    assert whole(tmp_path / "a.mcap", 60)
    assert not (tmp_path / "loaded").exists()


def test_a_program_that_a_broken_pipe_ends(tmp_path: Path) -> None:
    """Tell a program that SIGPIPE ends, as command-line tools often let it, that the process was killed."""
    begins = _DIES[: _DIES.index("print")].replace("import drawn", "import drawn, helper")
    code = f"""{begins}
import signal
signal.signal(signal.SIGPIPE, signal.SIG_DFL)
worker = helper()
worker.kill()
while worker.status() != "zombie":
    pass
log.append(*drawn(60, 100))
"""
    command = [sys.executable, "-c", code, str(tmp_path / "a.mcap")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1 and f"DataLost: writing stopped: {KILLED}" in ended.stderr


def test_a_program_without_standard_streams(tmp_path: Path) -> None:
    """Work for a program that has closed its standard input and output, whose numbers other files then have."""
    begins = _DIES[: _DIES.index("print")].replace("import drawn", "import drawn, helper")
    code = f"import os; os.close(0); os.close(1)\n{begins}assert helper()\nlog.__exit__(*[None] * 3)"
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.mcap")], check=False).returncode == 0
    assert whole(tmp_path / "a.mcap", 60)


def test_a_copy_of_the_program(tmp_path: Path) -> None:
    """Refuse rows of a forked process, which leaves the recording as it is."""
    rows = drawn(100, 100)
    with writer(tmp_path / "a.mcap") as log:
        log.append(*(array[:60] for array in rows))
        copy = os.fork()
        if not copy:
            code = 1
            try:
                log.append(*(array[60:] for array in rows))
            except DataLost:
                log.__exit__(None, None, None)
                log._sink.abandon()
                code = 0
            finally:
                os._exit(code)
        assert os.waitpid(copy, 0)[1] == 0
        log.append(*(array[60:] for array in rows))
    assert whole(tmp_path / "a.mcap", 100)


def test_it_is_killed_while_a_copy_of_the_program_runs(tmp_path: Path) -> None:
    """Do not wait for ever where a copy of the program holds all connections open."""
    rows = drawn(200, 100)
    with pytest.raises(DataLost, match=KILLED), writer(tmp_path / "a.mcap") as log:
        log.append(*(array[:100] for array in rows))
        copy = os.fork()
        if not copy:
            time.sleep(60)
            os._exit(0)
        try:
            helper().kill()
            log.append(*(array[100:] for array in rows))
        finally:
            os.kill(copy, signal.SIGKILL)
            os.waitpid(copy, 0)


_DIES = """
import os, sys
from pathlib import Path
from gpusimbench.recorder.capture import states, work_process
from tests.recorder.test_work_process import drawn, writer

work_process.LEAST_CPUS = work_process.LEAST_BYTES = states._ALONE_BYTES = 1
log = writer(Path(sys.argv[1])).__enter__()
log.append(*drawn(60, 100))
print("begun", flush=True)
sys.stdin.read()
"""


def test_the_program_is_killed(tmp_path: Path) -> None:
    """End with the program that is worked for, and leave what was written."""
    path = str(tmp_path / "a.mcap")
    with subprocess.Popen([sys.executable, "-c", _DIES, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stdout.readline() == b"begun\n"
        (working,) = helpers(child.pid)
        child.kill()
    wait_for(lambda: has_ended(working))
    recording = verified(tmp_path / "a.mcap.partial")
    assert recording.status == "incomplete"


def test_no_process_can_be_started(tmp_path: Path, process: pytest.MonkeyPatch) -> None:
    """Let threads do the work where there is no such Python, one that fails, and no memory for two processes."""
    fails = tmp_path / "fails" / "python3"
    fails.parent.mkdir()
    fails.write_text("#!/bin/sh\nexit 3\n")
    fails.chmod(0o755)
    for number, executable in enumerate((tmp_path / "none" / "python3", fails, Path("/bin/sh"))):
        process.setattr(sys, "executable", str(executable))
        with writer(tmp_path / f"{number}.mcap") as log:
            log.append(*drawn(60, 100))
            assert not helpers()
        assert whole(tmp_path / f"{number}.mcap", 60)
    process.setattr(sys, "executable", str(fails))
    names = tuple(f"body-{i:030d}" for i in range(10_000))  # more than a connection holds that nobody reads
    with writer(tmp_path / "names.mcap", n_env=1, fields=[body_field("cubes", "position", "float32", names)]) as log:
        log.append(np.zeros((3, 1, len(names), 3), np.float32))
    verify(open_recording(tmp_path / "names.mcap"))
    process.undo()

    def refused(*given: Any, **named: Any) -> Any:
        raise OSError if named else RuntimeError  # as a hook of sys.addaudithook may

    process.setattr(work_process, "LEAST_CPUS", 1)
    process.setattr(work_process, "LEAST_BYTES", 1)
    process.setattr(states, "_ALONE_BYTES", 1)
    for where, what in ((subprocess, "Popen"), (connection, "Pipe"), (os, "memfd_create")):
        before = len(os.listdir("/proc/self/fd"))
        process.setattr(where, what, refused)
        with writer(tmp_path / f"{what}.mcap") as log:
            log.append(*drawn(60, 100))
            assert not helpers()
        assert whole(tmp_path / f"{what}.mcap", 60)
        assert len(os.listdir("/proc/self/fd")) <= before  # connections of other tests may be closed meanwhile


def test_one_of_several_processes_cannot_be_started(process: pytest.MonkeyPatch) -> None:
    """Leave none of those that were, as where a limit of processes is reached: threads then start in their place."""
    fork, answers = os.fork, [True, False]

    def forked() -> int:
        if not answers.pop(0):
            raise BlockingIOError
        return fork()

    process.setattr(os, "fork", forked)
    stream = StateStream(FIELDS, 100, 50, 0.1, 1, frozenset(), 0)
    memory = os.memfd_create("states")
    ours, theirs = connection.Pipe()
    before = {*psutil.Process().children()}
    with ours, theirs, pytest.raises(BlockingIOError):
        work_child._Sharing(stream, work_child.Shared(memory, stream), ranges.Ranges(100), theirs)
    os.close(memory)
    assert not answers
    assert {*psutil.Process().children()} <= before


def test_what_is_loaded_without_a_process() -> None:
    """Load what connects to the process only where one is started: it takes longer than the rest of the modules."""
    code = "import sys; from gpusimbench import RecordingWriter; sys.exit('multiprocessing.connection' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_is_worth_a_process(process: pytest.MonkeyPatch) -> None:
    """Start none for little data, and none where the engine would need its processors."""
    process.setattr(work_process, "LEAST_BYTES", 100)
    assert work_process.worthwhile(100) and work_process.worthwhile(None)
    assert not work_process.worthwhile(99)
    process.setattr(work_process, "LEAST_CPUS", len(os.sched_getaffinity(0)) + 1)
    assert not work_process.worthwhile(None)
    process.setattr(work_process, "LEAST_CPUS", 1)
    for name in ("python", "python3", "python3.13t"):
        process.setattr(sys, "executable", f"/usr/bin/{name}")
        assert work_process.worthwhile(None)
    process.setattr(sys, "frozen", True, raising=False)  # the program itself would start once more
    assert not work_process.worthwhile(None)
    process.delattr(sys, "frozen")
    for name in (None, "", "/opt/kit", "/opt/python-viewer", "/opt/my_python"):
        process.setattr(sys, "executable", name)
        assert not work_process.worthwhile(None)
