"""A model file recorded by gsb-record against mjwarp-testspeed, MuJoCo Warp's own, on the same file. Needs a GPU.

usage: python -m benchmarks.model_speed FILE.xml [--n-env 8192] [--steps 1000] [--rounds 4]

Both begin in the same state, leave all controls at zero, and have the same buffers, those that gsb-record sized by
counting on MuJoCo C. mjwarp-testspeed adds up the time of each step, with a synchronisation after each; gsb-record
synchronises after every tenth step. A round is gsb-record, testspeed, testspeed, gsb-record.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=8192, steps=1000, rounds=4)
    p.add_argument("model", type=Path)
    asked = p.parse_args()
    buffers: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = [], []
        for number in range(asked.rounds):
            first, sizes, device = _recorded(asked, Path(folder) / f"{number}-a")
            buffers = buffers or sizes
            both = [_testspeed(asked, buffers) for _ in range(2)]
            second, _, _ = _recorded(asked, Path(folder) / f"{number}-b")
            ours += [first, second]
            theirs += both
            print(f"round {number}: gsb-record {first:,.0f} {second:,.0f}, testspeed {both[0]:,.0f} {both[1]:,.0f}")
    print(f"{machine()}; {device}; {asked.model.name}, {asked.n_env} envs, {asked.steps} steps, buffers {buffers}")
    print(f"gsb-record [env-steps/s]: {spread(ours, 0)}")
    print(f"testspeed  [env-steps/s]: {spread(theirs, 0)}")
    print(f"gsb-record / testspeed: {spread([a / b for a, b in zip(ours, theirs, strict=True)])}")


def _recorded(asked: argparse.Namespace, out: Path) -> tuple[float, dict[str, int], str]:
    subprocess.run(
        [sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", "warp", "--model", asked.model, "--runs", "1",
         "--n-env", str(asked.n_env), "--phases", "timed", "--warmup", "0", "--timed-steps", str(asked.steps),
         "--actions", "none", "--out", out],
        check=True, capture_output=True,
    )  # fmt: skip
    (path,) = out.glob("*.mcap")
    recording = open_recording(path)
    assert recording.simulation is not None
    rate = asked.n_env * asked.steps / recording.timing["timed"].window_s
    return rate, {buffer.name: buffer.asked for buffer in recording.simulation.buffers}, recording.simulation.device


def _testspeed(asked: argparse.Namespace, buffers: dict[str, int]) -> float:
    done = subprocess.run(
        [sys.executable, "-m", "mujoco_warp.testspeed", asked.model, "--nworld", str(asked.n_env), "--nstep",
         str(asked.steps), "--noise_std", "0", "--format", "json", "--nconmax", str(buffers["nconmax"]), "--njmax",
         str(buffers["njmax"])],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return float(found["steps_per_second"])


if __name__ == "__main__":
    main()
