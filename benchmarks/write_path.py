"""The host's write path (hashes, digests, CRCs, file) against os.write and CRC-32 of the same bytes, in turn.

usage: python -m benchmarks.write_path [--repeats 7] [--n-env 64] [--megabytes 1000] [--rows cubes|mjx]
                                       [--by processes|threads|thread]

Rows are states of 28 cubes, or what gpusimbench.wrap records of the MJX task of benchmarks/wrap_overhead.py. Without
--by, work is done as a recorder has it done on this machine: by processes where it has four processors, otherwise by
threads. One thread does it where gpusimbench.wrap records environments on a device, and there are fewer processors.

Where threads hash 2 GB or more, hashes are compiled, as in a capture of that size. Rates by the clock depend on what
else the machine does; the CPU time for each byte, of all threads and processes, depends on it less. Processes start
before the clock, as they do in a recorder, which captures when they work; their CPU time counts.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.capture import work_process
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.capture.workers import alone
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, array_field, body_field
from gpusimbench.schemas.fingerprint import fingerprint

_BLOCK = 50
_BLOCKS = 4  # that differ

_MJX = {"observation": 29, "action": 8, "reward": 1, "terminated": 1, "truncated": 1, "final_observation": 29,
        "final_given": 1, "stepped": 1}  # fmt: skip
_MJX_COUNTS = ("episode", "episode_step")  # float64

Blocks = list[list[NDArray[np.floating]]]


def fields_of(rows: str) -> list[StateField]:
    """The fields of the rows that are named."""
    if rows == "mjx":
        numbers = [array_field(name, "float32", (width,)) for name, width in _MJX.items()]
        return [*numbers, *(array_field(name, "float64", ()) for name in _MJX_COUNTS)]
    return [body_field("cubes", name, "float32", tuple(map(str, range(28)))) for name in BODY_FIELDS]


def ours(path: Path, blocks: Blocks, fields: list[StateField], n_env: int, beginning: list[float]) -> float:
    """Seconds for all blocks, as a recording is written; the time before that is appended to `beginning`."""
    sink = Sink(path, compression="none")
    created = time.perf_counter()
    writer = StateWriter(sink, fields, n_env=n_env, dt=0.01, stride=1, n_row=_BLOCK * len(blocks))
    writer.begin()
    began = time.perf_counter()
    beginning.append(began - created)
    for states in blocks:
        writer.feed(states)
    writer.flush()
    took = time.perf_counter() - began
    sink.abandon()
    return took


def floor(path: Path, blocks: Blocks) -> float:
    """Seconds for the same bytes, with one CRC and nothing else."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT)
    began = time.perf_counter()
    for states in blocks:
        for state in states:
            zlib.crc32(state.data)
            os.write(descriptor, state.data)
    took = time.perf_counter() - began
    os.close(descriptor)
    return took


def hashed(blocks: Blocks) -> float:
    """Seconds for the state hashes alone, in one thread."""
    began = time.perf_counter()
    for states in blocks:
        fingerprint(states)
    return time.perf_counter() - began


def cpu_seconds() -> float:
    """CPU time of this process and of those that it started and that have ended."""
    used = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=7, n_env=64)
    p.add_argument("--megabytes", type=int, default=1000, help="of states, at least")
    p.add_argument("--rows", choices=("cubes", "mjx"), default="cubes")
    p.add_argument("--by", choices=("processes", "threads", "thread"), help="who does the work")
    a = p.parse_args()
    if a.by:
        work_process.LEAST_CPUS = 1 if a.by == "processes" else sys.maxsize
    fields = fields_of(a.rows)
    rng = np.random.default_rng(0)
    blocks: Blocks = [
        [rng.standard_normal((_BLOCK, a.n_env, len(f.items), f.width)).astype(f.dtype) for f in fields]
        for _ in range(_BLOCKS)
    ]
    blocks *= -(-a.megabytes * 10**6 // sum(state.nbytes for states in blocks for state in states))
    size = sum(state.nbytes for states in blocks for state in states)
    beginning: list[float] = []
    times: dict[str, list[float]] = {"ours": [], "floor": [], "hashed": []}
    work_of_cores: dict[str, list[float]] = {name: [] for name in times}
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "file.mcap"
        partial = path.with_name(path.name + ".partial")
        work: dict[str, Callable[[], float]] = {
            "ours": lambda: ours(path, blocks, fields, a.n_env, beginning),
            "floor": lambda: floor(path, blocks),
            "hashed": lambda: hashed(blocks),
        }
        for _ in range(a.repeats):
            for what, run in work.items():
                worked = cpu_seconds()
                with alone() if a.by == "thread" else nullcontext():
                    times[what].append(run())
                work_of_cores[what].append((cpu_seconds() - worked) / size * 1e9)
                for written in (path, partial):
                    written.unlink(missing_ok=True)
    print(f"machine                                     {machine()}")
    print(
        f"states                                      {a.n_env} envs, {_BLOCK * len(blocks)} steps, {size / 1e6:.0f} MB"
    )
    print(f"write path [MB/s]                           {spread([size / t / 1e6 for t in times['ours']], 0)}")
    print(f"os.write + CRC-32 [MB/s]                    {spread([size / t / 1e6 for t in times['floor']], 0)}")
    ratios = [f / o for f, o in zip(times["floor"], times["ours"], strict=True)]
    print(f"rate of the write path / (os.write + CRC)   {spread(ratios)}   claim: at least 0.5, and 0.7 on 16 cores")
    print(f"CPU time of the write path [ns/byte]        {spread(work_of_cores['ours'], 2)}")
    print(f"CPU time of os.write + CRC-32 [ns/byte]     {spread(work_of_cores['floor'], 2)}")
    print(f"until processes work [s]                    {spread(beginning, 2)}")
    print(f"state hashes alone, one thread [MB/s]       {spread([size / t / 1e6 for t in times['hashed']], 0)}")


if __name__ == "__main__":
    main()
