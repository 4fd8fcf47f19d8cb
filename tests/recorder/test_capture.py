"""Blocks of captured steps on their way to a file: in order, whole, and never lost in silence."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import FrameType, SimpleNamespace

import numpy as np
import psutil
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench import RecordingWriter
from gpusimbench.recorder.capture.ranges import env_block
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.capture.writing import Block, CaptureClock, Writing, step_and_capture
from gpusimbench.recorder.failure import NoHostMemory, cause_of
from gpusimbench.recorder.run.capture_phase import StatesInMemory
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Held
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.fields import BODY_FIELDS, body_field
from gpusimbench.schemas.fingerprint import fingerprint
from tests.conftest import SMALL, Command, run_python, wait_for
from tests.reading import verified

FIELDS = [body_field("cubes", name, "float32", ("a", "b")) for name in BODY_FIELDS]


def states(steps: int, n_env: int, seed: int = 0) -> tuple[NDArray[np.float32], ...]:
    """Random states [step, env, item, width] of FIELDS."""
    rng = np.random.default_rng(seed)
    return tuple(rng.standard_normal((steps, n_env, 2, f.width), dtype=np.float32) for f in FIELDS)


class Released(Held):
    """A block that counts how often it was given back, and may fail at that."""

    def __init__(self, error: Exception | None = None) -> None:
        super().__init__(states(1, 1))
        self.count = 0
        self._error = error

    def release(self) -> None:
        self.count += 1
        if self._error:
            raise self._error


def test_blocks_are_written_in_order_and_released_once() -> None:
    """Write what was put in the order in which it was put, and give each block back once."""
    written: list[int] = []
    writing = Writing(lambda block: written.append(block.first_step))
    blocks = [Released() for _ in range(20)]
    for number, block in enumerate(blocks):
        writing.put(Block(number, block, None))
    writing.finish()
    assert written == list(range(20))
    assert [block.count for block in blocks] == [1] * 20
    assert writing.unwritten == 0


def test_other_threads_help_where_the_writer_is_behind() -> None:
    """Work alone where that is asked for; share where a block waits, and at the end."""
    workers, begin, used = Workers(small=False), threading.Event(), []

    def write(block: Block) -> None:
        begin.wait()
        used.append({*workers.start(lambda _: threading.current_thread().name, range(20))})

    writing = Writing(write, alone=True)
    writing.put(Block(0, Released(), None))
    begin.set()
    writing.wait(0)
    begin.clear()
    for number in range(1, 4):  # the first of them, or the first two, may be begun when the others are not there yet
        writing.put(Block(number, Released(), None))
    begin.set()
    writing.wait(0)
    writing.put(Block(4, Released(), None))
    writing.wait(0)
    writing.finish()
    alone = [names == {"writing"} for names in used]
    assert alone[0] and alone[3] and alone[4]
    assert not all(alone)
    assert {*workers.start(lambda _: threading.current_thread().name, range(20))} != {threading.current_thread().name}


def test_a_handler_that_raises_while_blocks_are_written() -> None:
    """Wait for the thread that writes, whatever the handler of a signal raises meanwhile: its file has one writer."""
    written, taken = [], []

    def taken_by_who_waits(number: int) -> bool:
        main_thread = sys._current_frames()[threading.main_thread().ident or 0]
        if len(taken) <= number and main_thread.f_code is threading.Condition.wait.__code__:
            os.kill(os.getpid(), signal.SIGALRM)  # again where it came just before the thread slept: that wakes nobody
        return len(taken) > number

    def write(block: Block) -> None:
        wait_for(lambda: taken_by_who_waits(block.first_step))
        written.append(block.first_step)

    def late(*_: object) -> None:
        taken.append(1)
        raise TimeoutError("late")

    writing, blocks = Writing(write), [Released(), Released()]
    for number, block in enumerate(blocks):
        writing.put(Block(number, block, None))
    before = signal.signal(signal.SIGALRM, late)
    try:
        with pytest.raises(TimeoutError, match="late"):
            writing.finish()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert written == [0, 1]
    assert [block.count for block in blocks] == [1, 1]


def test_a_handler_that_raises_before_the_writer_is_waited_for() -> None:
    """Wait for the thread that writes also where the handler raises in the first call of the wait."""
    begin, written = threading.Event(), []

    def write(block: Block) -> None:
        begin.wait()
        time.sleep(0.05)
        written.append(block.first_step)

    def strike(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_back is not None and frame.f_back.f_code is Writing._wait_to_the_end.__code__:
            sys.setprofile(None)
            begin.set()
            raise TimeoutError("late")

    writing = Writing(write)
    writing.put(Block(0, Released(), None))
    sys.setprofile(strike)
    try:
        with pytest.raises(TimeoutError, match="late"):
            writing.finish()
    finally:
        sys.setprofile(None)
    assert written == [0]


@pytest.mark.parametrize("n_env", [4, 700])  # written by one thread, and by several
@pytest.mark.parametrize("call", [1, 2, 40])
def test_states_whose_hashes_cannot_be_made(
    n_env: int, call: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Leave an incomplete file where states and their hashes have parted, even if the program goes on."""
    calls = []

    def failing(states: object) -> object:
        calls.append(states)
        if len(calls) == call:
            raise MemoryError
        return fingerprint(states)  # type: ignore[arg-type]

    monkeypatch.setattr("gpusimbench.recorder.capture.state_work.fingerprint", failing)
    rows = states(60, n_env)
    path, stopped = (
        tmp_path / "a.mcap",
        r"writing stopped: out of host memory; what was written is in .*a\.mcap\.partial",
    )
    log = RecordingWriter(path, simulator="a", version="1", scene="b", n_env=n_env, dt=1.0, steps=None, fields=FIELDS)
    with pytest.raises(DataLost, match=stopped), log:
        for row in range(60):
            try:
                log.append(*(array[row] for array in rows))
            except DataLost:
                assert len(calls) >= call
    assert len(calls) >= call and not path.exists()
    recording = verified(tmp_path / "a.mcap.partial")
    assert recording.status == "incomplete"


def test_an_error_of_the_writer_ends_the_stepping() -> None:
    """Raise it where the engine steps, write nothing behind it, and still release all blocks."""

    def write(block: Block) -> None:
        if block.first_step == 1:
            raise DataLost("the disk is full")
        assert block.first_step == 0

    writing = Writing(write)
    blocks = [Released() for _ in range(5)]
    for number, block in enumerate(blocks):
        writing.put(Block(number, block, None))
    with pytest.raises(DataLost, match="the disk is full"):
        writing.wait(0)
    with pytest.raises(DataLost, match="the disk is full"):
        writing.finish()
    assert [block.count for block in blocks] == [1] * 5


def test_an_engine_that_cannot_take_a_block_back() -> None:
    """Raise its error instead of waiting for ever."""
    writing = Writing(lambda block: None)
    writing.put(Block(0, Released(RuntimeError("it is gone")), None))
    with pytest.raises(RuntimeError, match="it is gone"):
        writing.wait(0)
    with pytest.raises(RuntimeError, match="it is gone"):
        writing.finish()


_INTERRUPTED = """
import os, signal, threading, time
from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.writing import Block, Writing
from gpusimbench.recorder.simulators.captured import Held

interruption.install()
written = []
def write(block):
    time.sleep(0.5)
    written.append(block)
    if len(written) == 1:
        os.kill(os.getpid(), signal.SIGINT)
writing = Writing(write)
for number in range(3):
    writing.put(Block(number, Held(()), None))
try:
    writing.finish()
except KeyboardInterrupt:
    print(len(written), [t.name for t in threading.enumerate() if t.name == "writing"])
"""


def test_an_interruption_waits_for_the_writer() -> None:
    """Be interrupted only once the thread that writes is gone: two must not write one file."""
    done = run_python(_INTERRUPTED, code=None)
    assert done.stdout == "3 []\n", done.stderr


@pytest.mark.parametrize(
    "spoil",
    [
        lambda arrays: (arrays[0][:, :1], *arrays[1:]),  # an environment is missing
        lambda arrays: (arrays[0].astype(np.float64), *arrays[1:]),
        lambda arrays: (arrays[0][:-1], *arrays[1:]),  # a step
        lambda arrays: (arrays[0][..., :2], *arrays[1:]),  # a component
    ],
)
def test_arrays_are_what_was_declared(tmp_path: Path, spoil: object) -> None:
    """Refuse an adapter's arrays of another shape or type; nothing is cast or broadcast."""
    sink = Sink(tmp_path / "x.mcap", compression="none")
    writer = StateWriter(sink, FIELDS, n_env=2, dt=0.01, stride=1)
    with pytest.raises(ValueError, match="the simulator gives cubes/"):
        writer.take(Held(spoil(states(4, 2))))  # type: ignore[operator]
    sink.abandon()


@given(
    n_env=st.sampled_from([1, 3, 64, 65, 130, 6 * 64, 9 * 64 + 5]),
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=5),
    apart=st.lists(st.booleans(), min_size=6, max_size=6),
    stride=st.integers(1, 7),
    alone=st.booleans(),
)
@example(n_env=3, sizes=[50], apart=[True, *[False] * 5], stride=1, alone=True)
def test_however_states_are_fed(
    tmp_path_factory: pytest.TempPathFactory, n_env: int, sizes: list[int], apart: list[bool], stride: int, alone: bool
) -> None:
    """Write the same numbers, hashes and digests for any blocks (whole or strewn), strides, environments and threads.

    A whole block in one piece behind a strewn one had the digest of the memory that the strewn one was read into.
    """
    folder = tmp_path_factory.mktemp("fed")
    whole = states(1 + sum(sizes), n_env)
    sink = Sink(folder / "x.mcap", compression="none")
    writer = StateWriter(sink, FIELDS, n_env=n_env, dt=0.01, stride=stride)
    writer.workers = Workers(small=alone)
    first = 0
    for size, strewn in zip((1, *sizes), apart, strict=False):
        part = tuple(array[first : first + size].copy(order="F" if strewn else "C") for array in whole)
        writer.feed(part)
        for array in part:
            array[:] = np.nan  # an engine uses its memory again
        first += size
    writer.flush()
    found = sink.digest.digests()
    for field, array in zip(FIELDS, whole, strict=True):
        other = Sink(folder / f"{field.field}.mcap", compression="none")
        other.digest.state(field, n_env, array[::stride])
        assert other.digest.digests()[f"state {field.name}"] == found[f"state {field.name}"]
        other.abandon()
    assert writer.last_recorded_step == (len(whole[0]) - 1) // stride * stride
    sink.abandon()
    assert fingerprint(whole).shape == (first, n_env)


def test_the_first_number_that_is_not_finite(tmp_path: Path) -> None:
    """Name the first step, and of it the first environment that may not fail, whatever threads look at together."""
    n_env = 6 * 64 + 5
    fed = states(9, n_env)
    for step, env in ((5, 3), (4, 130), (4, 386), (2, 70)):
        fed[0][step, env] = np.nan
    sink = Sink(tmp_path / "x.mcap", compression="none")
    writer = StateWriter(sink, FIELDS, n_env=n_env, dt=0.01, stride=1, may_fail=frozenset({70, 130}))
    writer.workers = Workers(small=False)
    found = writer.take(Held(fed))
    assert found
    assert found.startswith("a state is not finite: step 4, env 386, ")
    sink.abandon()


def test_modes_give_the_same_recording(gsb_record: Command, tmp_path: Path) -> None:
    """Record the same states, hashes and actions whether they are written meanwhile or afterwards."""
    found = []
    for mode in ("lossless", "memory"):
        done = gsb_record(
            "--sim", "mujoco", "--scene", "franka", "--n-env", 70, "--runs", 1, *SMALL, "--phases", "capture",
            "--capture", mode, "--out", tmp_path, code=0,
        )  # fmt: skip
        recording = verified(done.stdout.strip())
        assert recording.configuration.capture == mode
        hashes = recording.fingerprints("capture")
        assert {"capture", "drain"} <= set(recording.timing)
        (name,) = recording.action_names
        found.append((np.asarray(recording.state("robot", "qpos")), hashes.hashes, recording.actions(name)))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


def test_kept_blocks_have_all_that_was_shown() -> None:
    """Keep states, counts and the engine's own actions, in memory of their own."""
    n_env, given = 130, states(5, 130)
    counts, actions = np.arange(5 * n_env).reshape(5, n_env), np.ones((5, n_env, 3), dtype=np.float32)
    kept = StatesInMemory(FIELDS, n_env=n_env, rows=5, n_action=3, workers=Workers(small=False))
    expected = [array.copy() for array in given]
    kept.keep(Block(0, Held(given, Evidence({"contacts": counts}), actions), None))
    for array in (*given, counts, actions):
        array[:] = 0
    written: list[Block] = []
    kept.write(written.append)
    (block,) = written
    for array, before in zip(block.captured.states(slice(None)), expected, strict=True):
        assert np.array_equal(array, before)
    shown, held = block.captured.evidence(), block.captured.actions(slice(env_block(n_env), None))
    assert shown.counts["contacts"][-1, -1] == 5 * n_env - 1
    assert held.shape == (5, n_env - env_block(n_env), 3)
    assert (held == 1).all()


def test_memory_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse to keep states that the machine has no memory for, before the first step."""
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
    with pytest.raises(NoHostMemory, match="capture fewer steps, or lossless") as raised:
        StatesInMemory(FIELDS, n_env=10, rows=100, n_action=0, workers=Workers(small=True))
    assert cause_of(raised.value) == "HOST_MEMORY"


def test_a_slow_disk_stops_the_engine_and_is_told() -> None:
    """Hold no more blocks than the ring has, lose none, and keep how long the engine stood still."""
    scene = make_scene("free-fall")
    simulator = MujocoC(scene, n_env=2, dt=scene.dt, seed=0, options=MujocoC.Options())
    simulator.build()
    most, written = [], []

    def write(block: Block) -> None:
        if block.first_step <= 25:  # later there are not as many blocks to come
            wait_for(lambda: writing.unwritten == RING_BLOCKS)
        most.append(writing.unwritten)
        written.append(block.first_step)

    writing, clock = Writing(write), CaptureClock()
    step_and_capture(
        simulator, writing, clock, first=0, last=45, block_steps=5, prepare=lambda first, count: None,
        progress=lambda done: None, stopped=lambda: False,
    )  # fmt: skip
    writing.finish()
    simulator.close()
    assert written == [0, *range(1, 46, 5)]
    assert max(most) <= RING_BLOCKS
    assert clock.blocks.shape == (2, 9)
    assert (clock.blocks[0, 1:] == clock.blocks[1, :-1]).all()
    assert clock.stalls.shape[1] >= 3
    assert (clock.stalls[1] >= clock.stalls[0]).all()
