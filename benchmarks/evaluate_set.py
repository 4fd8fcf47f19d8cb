"""Evaluation of 10 recordings of 16 environments against hashing the same bytes, in turn.

usage: python -m benchmarks.evaluate_set [--repeats 5]
"""

from __future__ import annotations

import hashlib
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread


def _timed(command: list[str]) -> tuple[float, float]:
    """Seconds by the clock, and of the processors."""
    began, worked = time.perf_counter(), _worked()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began, _worked() - worked


def _worked() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=5)
    a = p.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "gpusimbench.recorder.cli",
             "--sim", "mujoco", "--timed-steps", "100", "--out", folder],
            check=True, capture_output=True,
        )  # fmt: skip
        files = sorted(str(f) for f in Path(folder).glob("*.mcap"))
        size = sum(Path(f).stat().st_size for f in files)
        table, page, known, floor, worked = (list[float]() for _ in range(5))
        time.sleep(3)  # what was written a moment ago is not kept
        for _ in range(a.repeats):
            command = [sys.executable, "-m", "gpusimbench.evaluator.cli.eval", *files]
            seconds, processors = _timed([*command, "--no-cache"])
            table.append(seconds)
            worked.append(processors)
            page.append(_timed([*command, "--no-cache", "--html", f"{folder}/report"])[0])
            kept = [*command, "--cache", f"{folder}/cache"]
            if not known:
                _timed(kept)
            known.append(_timed(kept)[0])
            began = time.perf_counter()
            for file in files:
                hashlib.sha256(Path(file).read_bytes()).hexdigest()
            floor.append(time.perf_counter() - began)
    print(f"machine                     {machine()}")
    print(f"set                         {len(files)} recordings, {size / 1e6:.0f} MB, every byte verified")
    print(f"gsb-eval, table [s]         {spread(table, 2)}   claim: under 5 s")
    print(f"the same, CPU time [s]      {spread(worked, 2)}   claim: 2 s")
    print(f"gsb-eval, table and HTML    {spread(page, 2)}   claim: under 5 s")
    print(f"gsb-eval of known files [s] {spread(known, 2)}")
    print(f"reading and SHA-256 [s]     {spread(floor, 2)}")
    print(f"ratio table / floor         {spread([t / f for t, f in zip(table, floor, strict=True)], 1)}")


if __name__ == "__main__":
    main()
