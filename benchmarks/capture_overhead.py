"""Full capture against stepping alone, and the file's bytes against plain writes of the same bytes, in turn.

usage: python -m benchmarks.capture_overhead [--repeats 5] [--n-env 64] [--steps 300]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np

from benchmarks.machine import machine, spread
from evaluator import open_recording
from recorder.capture.sink import Sink
from recorder.capture.states import StateWriter
from schemas.fields import BODY_FIELDS, body_field

_STEPS = 200


def capture_ratio(folder: Path, n_env: int, steps: int) -> float:
    """Wall time of the capture phase over that of the same number of timed steps from the same state."""
    done = subprocess.run(
        [sys.executable, "-m", "recorder.cli", "--sim", "mujoco", "--n-env", str(n_env), "--runs", "1", "--warmup", "0",
         "--timed-steps", str(steps), "--steps", str(steps), "--out", str(folder)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    recording = open_recording(Path(done.stdout.strip()))
    times = {(e.kind, e.phase): e.monotonic_ns for e in recording.events}
    captured = (times["PHASE_END", "capture"] - times["PHASE_BEGIN", "capture"]) * 1e-9
    return captured / recording.timing["timed"].elapsed_s


def write_ratio(folder: Path, n_env: int) -> tuple[float, float]:
    """Rate of the host's write path (hashes, digests, CRCs, file) [MB/s], and its ratio to os.write plus CRC-32."""
    fields = [body_field("cubes", name, "float64", tuple(map(str, range(28)))) for name in BODY_FIELDS]
    rng = np.random.default_rng(0)
    states = [rng.standard_normal((50, n_env, 28, f.width)) for f in fields]
    size = sum(s.nbytes for s in states) * (_STEPS // 50)
    sink = Sink(folder / f"{time.time_ns()}.mcap", compression="none")
    writer = StateWriter(sink, fields, n_env=n_env, dt=0.01, stride=1)
    began = time.perf_counter()
    for _ in range(_STEPS // 50):
        writer.feed(states)
    writer.flush()
    ours = time.perf_counter() - began
    sink.abandon()
    descriptor = os.open(folder / f"{time.time_ns()}.raw", os.O_WRONLY | os.O_CREAT)
    began = time.perf_counter()
    for _ in range(_STEPS // 50):
        for state in states:
            zlib.crc32(state)
            os.write(descriptor, state)
    floor = time.perf_counter() - began
    os.close(descriptor)
    return size / ours / 1e6, floor / ours


def main() -> None:
    """Measure and print."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--repeats", type=int, default=5)
    p.add_argument("--n-env", type=int, default=64)
    p.add_argument("--steps", type=int, default=300)
    a = p.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        captures = [capture_ratio(folder, a.n_env, a.steps) for _ in range(a.repeats)]
        rates, ratios = zip(*(write_ratio(folder, a.n_env) for _ in range(a.repeats)), strict=True)
    print(f"machine                                    {machine()}")
    print(f"capture phase / timed phase, {a.n_env} envs       {spread(captures)}")
    print(f"host write path [MB/s]                     {spread(rates, 0)}")
    print(f"rate of the write path / (os.write + CRC)  {spread(ratios)}")


if __name__ == "__main__":
    main()
