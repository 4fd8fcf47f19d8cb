"""What capturing every state costs beside stepping alone, for each mode in turn, from real recordings.

usage: python -m benchmarks.capture_overhead [--sim mujoco] [--scene inclined-collision] [--n-env 64] [--steps 300]
           [--rounds 3] [--modes lossless,memory,stride] [--option NAME=VALUE ...] [--out DIR]

Each recording steps twice from the same initial state: timed, with nothing captured, and captured. The ratio is that of
the two. "stand still" is the part of the capture in which the engine waited for the writer, "then writing" what was
left to write after the last step, as a part of the capture. "memory" is by how much the process grew while capturing.
"disk" is the time that one thread takes to write as many bytes as the recording has into the same folder with os.write,
right after it, over the time of the timed steps: no capture in which the engine goes on can be faster. "flushed" adds
fdatasync, which a capture waits for at its end alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording
from gpusimbench.recorder.capture.ranges import row_bytes

_PIECE = 4 << 20  # bytes, as the largest messages have

MODES = {
    "lossless": ("--capture", "lossless"),
    "memory": ("--capture", "memory"),
    "stride": ("--capture", "lossless", "--stride", "10"),
}


@dataclass(frozen=True)
class Cost:
    """Of one recording.

    ratio   capture / timed, time of the same steps
    still   share of the capture in which the engine stood still
    writing time after the last step, over that of the capture
    rate    states [MB/s]
    grown   resident set, largest of the capture phase minus that at its begin [MB]
    timed   time of the same steps, without capture [s]
    same    whether the states after the last step are those of the timed phase, bit for bit; None: not deterministic
    """

    ratio: float
    still: float
    writing: float
    rate: float
    grown: float
    timed: float
    same: bool


def cost_of(path: Path) -> Cost:
    """Read from a recording with both phases, of equally many steps."""
    recording = open_recording(path)
    c, timing, host = recording.configuration, recording.timing, recording.memory["host"]
    stall = timing.get("stall")
    captured = timing["capture"].elapsed_s
    used = [int(u) for u, p in zip(host.used_bytes, host.phase, strict=True) if p == "capture"]
    timed_hashes, hashes = recording.fingerprints("timed"), recording.fingerprints("capture")
    assert timed_hashes is not None
    assert hashes is not None
    return Cost(
        ratio=captured / timing["timed"].window_s,
        still=stall.total_s / captured if stall else 0.0,
        writing=timing["drain"].elapsed_s / captured,
        rate=c.steps // c.stride * row_bytes(c.n_env, recording.fields) / captured / 1e6,
        grown=(max(used) - used[0]) / 1e6,
        timed=timing["timed"].elapsed_s,
        same=bool(np.array_equal(timed_hashes.hashes[-1], hashes.hashes[-1])),
    )


@dataclass(frozen=True)
class Disk:
    """What the folder takes, over the timed steps' time.

    written  time of os.write for the recording's size
    flushed  the same and fdatasync
    rate     of os.write [MB/s]
    """

    written: float
    flushed: float
    rate: float


def disk_of(path: Path, timed: float) -> Disk:
    """Write as many bytes beside a recording, in its largest messages' size; `timed` [s]."""
    size, piece = path.stat().st_size, memoryview(os.urandom(_PIECE))
    beside = path.with_name(path.name + ".disk")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
    try:
        began, left = time.perf_counter(), size
        while left:
            left -= os.write(descriptor, piece[: min(left, _PIECE)])
        written = time.perf_counter() - began
        os.fdatasync(descriptor)
        flushed = time.perf_counter() - began
    finally:
        os.close(descriptor)
        beside.unlink()
    return Disk(written / timed, flushed / timed, size / written / 1e6)


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=64, steps=300, rounds=3)
    p.add_argument("--sim", default="mujoco")
    p.add_argument("--scene", default="inclined-collision")
    p.add_argument("--modes", default=",".join(MODES))
    p.add_argument("--option", action="append", default=[])
    p.add_argument("--out", type=Path, help="keep the recordings here")
    a = p.parse_args()
    options = [word for option in a.option for word in ("--option", option)]
    found: dict[str, list[Cost]] = {mode: [] for mode in a.modes.split(",")}
    disks: dict[str, list[Disk]] = {mode: [] for mode in found}
    with tempfile.TemporaryDirectory() as name:
        for _ in range(a.rounds):
            for mode, costs in found.items():
                done = subprocess.run(
                    [sys.executable, "-m", "gpusimbench.recorder.cli",
                     "--sim", a.sim, "--scene", a.scene, "--n-env", str(a.n_env),
                     "--runs", "1", "--warmup", "0", "--timed-steps", str(a.steps), "--steps", str(a.steps),
                     *MODES[mode], *options, "--out", str(a.out or name)],
                    stdout=subprocess.PIPE, text=True,
                )  # fmt: skip
                path = Path(done.stdout.strip())
                if done.returncode:
                    sys.exit(f"{mode}: the run did not complete")
                costs.append(cost_of(path))
                print(f"{mode}, round {len(costs)}: capture / timed {costs[-1].ratio:.3f}", file=sys.stderr)
                disks[mode].append(disk_of(path, costs[-1].timed))
                device = open_recording(path).simulation
                if a.out is None:
                    path.unlink()
    print(f"machine           {machine()}, {device.device if device else ''}")
    print(
        f"recordings        {a.sim} {' '.join(a.option)}, {a.scene}, {a.n_env} envs, {a.steps} steps, {a.rounds} rounds"
    )
    for mode, costs in found.items():
        print(f"{mode:9} capture / timed         {spread([c.ratio for c in costs])}")
        print(f"{'':9} stand still, of capture {spread([c.still for c in costs])}")
        print(f"{'':9} then writing            {spread([c.writing for c in costs])}")
        print(f"{'':9} states [MB/s]           {spread([c.rate for c in costs], 0)}")
        print(f"{'':9} memory [MB]             {spread([c.grown for c in costs], 0)}")
        print(f"{'':9} disk / timed            {spread([d.written for d in disks[mode]])}")
        print(f"{'':9} disk, flushed / timed   {spread([d.flushed for d in disks[mode]])}")
        print(f"{'':9} disk [MB/s]             {spread([d.rate for d in disks[mode]], 0)}")
        ratios = [c.ratio / d.written for c, d in zip(costs, disks[mode], strict=True)]
        print(f"{'':9} capture / disk          {spread(ratios)}")
        print(f"{'':9} same last state         {sum(c.same for c in costs)} of {len(costs)}")


if __name__ == "__main__":
    main()
