"""Reading a whole uncompressed recording, every CRC checked, against copies and CRCs of the same mapped bytes, in turn.

usage: python -m benchmarks.read_path [--repeats 5] [--n-env 1024] [--steps 340]

The file is in the page cache. Each rate is given by the clock, which other programs share, and for each second that a
core worked on it, whatever their number.
"""

from __future__ import annotations

import hashlib
import mmap
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs import validation
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_field
from gpusimbench.schemas.fingerprint import fingerprint

ROWS, ENVS = 50, 64
"""Of a block; the initial state is one of its own."""

_BODIES = tuple(map(str, range(28)))


def write(path: Path, *, n_env: int, steps: int) -> None:
    """A recording of random states of 28 bodies."""
    rng = np.random.default_rng(0)
    fields: tuple[StateField, ...] = tuple(body_field("cubes", name, "float32", _BODIES) for name in BODY_FIELDS)
    states = [[rng.standard_normal((n_env, 28, f.width), dtype=np.float32) for f in fields] for _ in range(7)]
    with RecordingWriter(
        path, simulator="random", version="1", scene="none", n_env=n_env, dt=0.01, steps=steps, fields=fields
    ) as log:
        for step in range(steps + 1):
            log.append(*states[step % len(states)])


def read_states(path: Path) -> None:
    """Every state, in an array each field; the file is opened anew, so that every chunk is checked."""
    recording = open_recording(path)
    for field in recording.fields:
        np.asarray(recording.state(field.group, field.field))


def view_states(path: Path) -> None:
    """Every state where it lies in the file, block by block, without a copy."""
    recording = open_recording(path)
    for field in recording.fields:
        array = recording.state(field.group, field.field)
        for first in (0, *range(1, len(array), ROWS)):
            for env in range(0, array.shape[1], ENVS):
                found = array.read(slice(first, first + ROWS if first else 1), slice(env, env + ENVS), copy=False)
                assert not found.flags.owndata


def verify(path: Path) -> None:
    """Everything that verifying does: CRCs, digests, state hashes."""
    validation.verify(open_recording(path))


def copy(path: Path) -> None:
    """The file as one array."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        np.frombuffer(mapped, dtype=np.uint8).copy()


def crc(path: Path) -> None:
    """The file's CRC-32."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        zlib.crc32(mapped)


def sha(path: Path) -> None:
    """The file's SHA-256, which is the most of what digests cost."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        hashlib.sha256(mapped)


def hashes(path: Path) -> None:
    """State hashes of every environment and step."""
    recording: Recording = open_recording(path)
    arrays = [recording.state(field.group, field.field) for field in recording.fields]
    for first in range(0, len(arrays[0]), 50):
        fingerprint([array.read(slice(first, first + 50), slice(None)) for array in arrays])


WORK: dict[str, Callable[[Path], None]] = {
    "StateArray, all states": read_states,
    "the same, in place": view_states,
    "Recording.verify": verify,
    "copy of the mapped file": copy,
    "zlib.crc32 of it": crc,
    "SHA-256 of it": sha,
    "reading and state hashes": hashes,
}


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=5, n_env=1024, steps=340)
    a = p.parse_args()
    clock: dict[str, list[float]] = {name: [] for name in WORK}
    cores: dict[str, list[float]] = {name: [] for name in WORK}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.mcap"
        write(path, n_env=a.n_env, steps=a.steps)
        size = path.stat().st_size
        for _ in range(a.repeats):
            for name, work in WORK.items():
                began, worked = time.perf_counter(), time.process_time()
                work(path)
                clock[name].append(size / (time.perf_counter() - began) / 1e9)
                cores[name].append(size / (time.process_time() - worked) / 1e9)
    print(f"machine                    {machine()}")
    print(f"recording                  {a.n_env} envs, {a.steps} steps, {size / 1e6:.0f} MB, not compressed")
    print(f"{'[GB/s]':<26} {'by the clock':<34} per second of a core")
    for name in WORK:
        print(f"{name:<26} {spread(clock[name], 2):<34} {spread(cores[name], 2)}")
    read, copied, checked = (
        clock[name] for name in ("StateArray, all states", "copy of the mapped file", "zlib.crc32 of it")
    )
    ratios = [r * (1 / c + 1 / k) for r, c, k in zip(read, copied, checked, strict=True)]
    print(f"rate of reading / (copy + CRC)   {spread(ratios)}   claim: at least 1")
    print(f"best rate of reading [GB/s]      {max(read):.2f}   claim: at least 1, on a machine that does nothing else")


if __name__ == "__main__":
    main()
