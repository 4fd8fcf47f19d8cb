"""Timed phase of the MuJoCo recorder against a bare mujoco.rollout, in turn.

usage: python -m benchmarks.record_throughput [--pairs 7] [--n-env 16] [--steps 300]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.throughput import frames_per_second


def recorded(folder: Path, n_env: int, steps: int) -> tuple[float, Path]:
    """Env-steps/s of the recorder's timed phase, from the recording."""
    done = subprocess.run(
        [sys.executable, "-m", "gpusimbench.recorder.cli",
         "--sim", "mujoco", "--n-env", str(n_env), "--runs", "1", "--warmup", "0",
         "--timed-steps", str(steps), "--phases", "timed", "--out", str(folder)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    path = Path(done.stdout.strip())
    return frames_per_second(n_env, steps, open_recording(path).timing["timed"].window_s), path


def bare(path: Path, n_env: int, steps: int) -> float:
    """Env-steps/s of mujoco.rollout on the recording's own model, threads and steps."""
    recording = open_recording(path)
    xml = recording.attachment("scene.xml")
    assert xml is not None
    assert recording.simulation is not None
    model = mujoco.MjModel.from_xml_string(xml.decode())
    datas = [mujoco.MjData(model) for _ in range(recording.simulation.options["threads"])]
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, datas[0], state, spec)
    initial = np.tile(state, (n_env, 1))
    out = np.empty((n_env, steps, state.size))
    began = time.perf_counter()
    rollout.rollout(model, datas, initial, nstep=steps, state=out)
    return frames_per_second(n_env, steps, time.perf_counter() - began)


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, pairs=7, n_env=16, steps=300)
    a = p.parse_args()
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(a.pairs):
            fps, path = recorded(Path(folder), a.n_env, a.steps)
            ours.append(fps)
            theirs.append(bare(path, a.n_env, a.steps))
    ratios = [x / y for x, y in zip(ours, theirs, strict=True)]
    print(f"machine                        {machine()}")
    print(f"pairs                          {a.pairs}, {a.n_env} envs, {a.steps} steps of inclined-collision")
    print(f"recorder, timed [env-steps/s]  {spread(ours, 0)}")
    print(f"bare mujoco.rollout            {spread(theirs, 0)}")
    print(f"ratio recorder / bare          {spread(ratios)}   claim: at least 0.95")


if __name__ == "__main__":
    main()
