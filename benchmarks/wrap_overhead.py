"""What gpusimbench.wrap costs: calls of step of a wrapped vector environment beside those of a bare one, in turn.

usage: python -m benchmarks.wrap_overhead [--task HalfCheetah-v5] [--n-env 64] [--steps 200] [--rounds 9]

Both vectors live in this process, begin with one seed and are given the same actions, drawn before. A round steps each
of them in turn, the bare one first in every second round, and gives one ratio; the end of the recording counts as well.
On a machine that is busy with other things, the ratio of CPU times is the steadier one.
The last observations of both are the same, bit for bit.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.machine import machine, spread
from gpusimbench import open_recording, wrap


def seconds(envs: Any, actions: list[Any]) -> tuple[float, float, Any]:
    """Time of all steps and of closing, by the clock and of the process on all cores [s]; the last observations."""
    begin, worked = time.perf_counter(), time.process_time()
    for action in actions:
        observation = envs.step(action)[0]
    envs.close()
    return time.perf_counter() - begin, time.process_time() - worked, observation


def main() -> None:
    """Measure and print."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--task", default="HalfCheetah-v5")
    p.add_argument("--n-env", type=int, default=64)
    p.add_argument("--steps", type=int, default=200)
    p.add_argument("--rounds", type=int, default=9)
    a = p.parse_args()
    ratios, of_work, bare_s, sizes = [], [], [], []
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)  # where MuJoCo logs that a task's model is old
        for number in range(a.rounds):
            path = Path(f"{number}.mcap")
            envs = [gymnasium.make_vec(a.task, num_envs=a.n_env, vectorization_mode="sync") for _ in range(2)]
            envs[1] = wrap(envs[1], path, steps=a.steps)
            for one in envs:
                one.reset(seed=number)
            envs[0].action_space.seed(number)
            actions = [envs[0].action_space.sample() for _ in range(a.steps)]
            order = (0, 1) if number % 2 else (1, 0)
            found = {which: seconds(envs[which], actions) for which in order}
            assert np.array_equal(found[0][2], found[1][2])
            assert open_recording(path).status == "complete"
            ratios.append(found[1][0] / found[0][0])
            of_work.append(found[1][1] / found[0][1])
            bare_s.append(found[0][0])
            sizes.append(path.stat().st_size / 1e6)
    print(f"machine           {machine()}")
    print(f"steps             {a.task}, {a.n_env} envs, {a.steps} steps, {a.rounds} rounds")
    print(f"bare [ms / step]  {spread([s / a.steps * 1e3 for s in bare_s])}")
    print(f"wrapped / bare    {spread(ratios)}")
    print(f"of CPU time       {spread(of_work)}")
    print(f"recording [MB]    {spread(sizes, 1)}")


if __name__ == "__main__":
    main()
