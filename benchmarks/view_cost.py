"""What a view in the recording costs: bytes, and CPU seconds of the whole run, with and without in turn.

usage: python -m benchmarks.view_cost [--sim mujoco] [--scene inclined-collision] [--n-env 16,4096] [--steps 500,20]
           [--rounds 5] [--envs 1,4] [--option NAME=VALUE ...]

Each recording is a process of its own that captures and times nothing else. CPU seconds are of all of its threads, from
its start to its end. Ratios are of medians, against --no-view in the same run; "still" is the part of the capture in
which the engine waited for the writer.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording


@dataclass(frozen=True)
class Cost:
    """Of one recording: its bytes, CPU seconds of its process, seconds of the capture, share of them stood still."""

    size: int
    cpu_s: float
    capture_s: float
    still: float


def record(arguments: list[str], folder: str) -> Cost:
    """Make a recording, and read what it cost."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "gpusimbench.recorder.cli",
         "--runs", "1", "--phases", "capture", *arguments, "--out", folder],
        capture_output=True, text=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(done.stderr)
    path = Path(done.stdout.strip())
    timing = open_recording(path).timing
    captured = timing["capture"].elapsed_s
    cost = Cost(
        size=path.stat().st_size,
        cpu_s=after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        capture_s=captured,
        still=timing["stall"].total_s / captured if "stall" in timing else 0.0,
    )
    path.unlink()
    return cost


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, rounds=5)
    p.add_argument("--sim", default="mujoco")
    p.add_argument("--scene", default="inclined-collision")
    p.add_argument("--n-env", default="16,4096")
    p.add_argument("--steps", default="500,20", help="one for each number of environments")
    p.add_argument("--envs", default="1,4", help="environments in the view")
    p.add_argument("--option", action="append", default=[])
    a = p.parse_args()
    print(f"machine     {machine()}")
    for n_env, steps in zip(a.n_env.split(","), a.steps.split(","), strict=True):
        common = ["--sim", a.sim, "--scene", a.scene, "--n-env", n_env, "--steps", steps]
        common += [word for option in a.option for word in ("--option", option)]
        modes = {"no view": ["--no-view"]}
        for count in (count for count in map(int, a.envs.split(",")) if count <= int(n_env)):
            modes[f"{count} in view"] = [word for env in range(count) for word in ("--view-env", str(env))]
        found: dict[str, list[Cost]] = {mode: [] for mode in modes}
        with tempfile.TemporaryDirectory() as folder:
            record([*common, "--no-view"], folder)  # caches of the disk
            for _ in range(a.rounds):
                for mode, costs in found.items():
                    costs.append(record([*common, *modes[mode]], folder))
        print(f"recordings  {a.sim}, {a.scene}, {n_env} envs, {steps} steps captured, {a.rounds} rounds")
        _print(found)


def _print(found: dict[str, list[Cost]]) -> None:
    base = found["no view"]
    size, cpu = base[0].size, statistics.median(c.cpu_s for c in base)
    wall = statistics.median(c.capture_s for c in base)
    for mode, costs in found.items():
        own = statistics.median(c.cpu_s for c in costs)
        print(f"  {mode:10} file     {costs[0].size / 1e6:.2f} MB, {costs[0].size / size:.4f} of that without")
        print(f"  {'':10} CPU [s]  {spread([c.cpu_s for c in costs])}, {own / cpu:.3f} of that without")
        took = statistics.median(c.capture_s for c in costs)
        print(f"  {'':10} capture [s] {spread([c.capture_s for c in costs])}, {took / wall:.3f} of that without")
        print(f"  {'':10} still    {spread([c.still for c in costs])}")


if __name__ == "__main__":
    main()
