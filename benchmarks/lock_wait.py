"""How long a thread that makes short calls waits for Python's lock while another thread writes states, on Linux.

usage: python -m benchmarks.lock_wait [--n-env 4096] [--blocks 8] [--repeats 3]

An engine that launches its kernels from Python makes such calls. States are hashed by another process and by threads of
this one, in turn; the file is in memory. A thread that sleeps waits for the lock: it has nothing else to sleep for. The
floor is the same thread beside one that does nothing.
"""

from __future__ import annotations

import ctypes
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread, thread_seconds
from gpusimbench.recorder.capture import work_process
from gpusimbench.recorder.capture.ranges import steps_per_block
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.capture.writing import Block, Writing
from gpusimbench.recorder.simulators.captured import Held, States
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_field
from gpusimbench.schemas.fingerprint import expect

_CUBES = 27
_ALIKE = 20  # calls between two looks at the clock
_IDLE_S = 0.5
_COMPILED = 10**9  # bytes from which on hashes are compiled, as in captures of that size


class Calls(NamedTuple):
    """What a thread did: calls, and seconds by the clock and asleep."""

    made: int
    lasted: float
    asleep: float


def calls(until: threading.Event, found: list[Calls]) -> None:
    """Make calls of C, each with some Python, until the event."""
    call = ctypes.CDLL(None).getppid
    began, made, before = time.perf_counter(), 0, sum(thread_seconds())
    while not until.is_set():
        for _ in range(_ALIKE):
            call()
            sum(range(300))
        made += _ALIKE
    lasted = time.perf_counter() - began
    found.append(Calls(made, lasted, lasted - (sum(thread_seconds()) - before)))


def beside(work: Callable[[], None]) -> Calls:
    """The calls of a thread while this one works."""
    until, found = threading.Event(), list[Calls]()
    thread = threading.Thread(target=calls, args=(until, found))
    thread.start()
    work()
    until.set()
    thread.join()
    return found[0]


def written(states: States, fields: list[StateField], blocks: int, *, process: bool) -> Calls:
    """The calls beside the writer of so many blocks."""
    work_process.LEAST_CPUS = 1 if process else 1 << 30
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        sink = Sink(Path(folder) / "states.mcap", compression="none")
        writer = StateWriter(sink, fields, n_env=states[0].shape[1], dt=0.01, stride=1)
        writer.take(Held(states))  # what is started once
        writer.take(Held(states))

        def take(block: Block) -> None:
            writer.take(block.captured)

        writing = Writing[Block](take)

        def write() -> None:
            for _ in range(blocks):
                writing.put(Block(0, Held(states), None))
                writing.wait(0)

        found = beside(write)
        writing.finish()
        writer.workers.end()
        sink.abandon()
    return found


def main() -> None:
    """Measure and print."""
    a = parser(__doc__, n_env=4096, blocks=8, repeats=3).parse_args()
    fields = [body_field("cubes", name, "float32", tuple(map(str, range(_CUBES)))) for name in BODY_FIELDS]
    rows = steps_per_block(a.n_env, fields)
    rng = np.random.default_rng(0)
    states = tuple(rng.standard_normal((rows, a.n_env, _CUBES, f.width), dtype=np.float32) for f in fields)
    expect(_COMPILED)
    idle: list[Calls] = []
    ours: dict[bool, list[Calls]] = {True: [], False: []}
    for number in range(a.repeats):
        idle.append(beside(lambda: time.sleep(_IDLE_S)))
        for process in (True, False) if number % 2 else (False, True):
            ours[process].append(written(states, fields, a.blocks, process=process))
    base = min(one.lasted / one.made for one in idle)
    print(f"machine  {machine()}")
    print(
        f"blocks   {rows} steps, {a.n_env} envs, {_CUBES} cubes, {sum(array.nbytes for array in states) / 1e6:.0f} MB"
    )
    print(f"idle     a call takes {base * 1e6:.2f} us")
    for process, name in ((True, "process"), (False, "threads")):
        found = ours[process]
        print(f"{name}  a call takes, of idle       {spread([one.lasted / one.made / base for one in found])}")
        print(f"{name}  asleep, of the time         {spread([one.asleep / one.lasted for one in found])}")
        print(f"{name}  asleep for a block [ms]     {spread([one.asleep / a.blocks * 1e3 for one in found], 1)}")


if __name__ == "__main__":
    main()
