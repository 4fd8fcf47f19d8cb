"""Why MuJoCo Warp's environment 0 depends on how many environments there are.

MuJoCo Warp adds up the Hessian J^T D J of an environment by atomic additions of a few groups of threads, and the fewer
environments there are, the more groups each gets (solver.py, `_jtdaj_groups_per_world`). Sums of other groups round
otherwise. With the number of groups fixed, environment 0 has to be the same whatever the number of environments.

    python -m benchmarks.warp_batch        the table of docs/probe-results.md
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.warp.options import WarpOptions
from gpusimbench.recorder.simulators.warp.simulator import MujocoWarp

GROUPS = "_jtdaj_groups_per_world"


def trajectory(n_env: int, steps: int, device: str) -> list[NDArray[Any]]:
    """The states of environment 0 of inclined-collision after each step, one array a step."""
    scene = make_scene("inclined-collision")
    simulator = MujocoWarp(scene, n_env=n_env, dt=scene.dt, seed=0, options=WarpOptions(device=device))
    simulator.build()
    simulator.compile("capture")
    return of_first(simulator, steps)


def of_first(simulator: Simulator, steps: int) -> list[NDArray[Any]]:
    """The states of environment 0 of a simulator that was built, after each step, one array a step; closes it."""
    states = simulator.states(steps)
    simulator.close()
    return [np.concatenate([array[step, 0].ravel() for array in states]) for step in range(steps)]


def first_difference(one: list[NDArray[Any]], other: list[NDArray[Any]]) -> str:
    """The first step at which two trajectories differ in any bit."""
    differ = (step for step, (a, b) in enumerate(zip(one, other, strict=True), 1) if a.tobytes() != b.tobytes())
    return str(next(differ, "never"))


def main() -> None:
    """Run each number of environments as shipped, and with one group each."""
    p = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    p.add_argument("--numbers", default="1,2,3,4,6,64", help="of environments, each against 16")
    p.add_argument("--steps", type=int, default=30)
    p.add_argument("--device", default="auto")
    arguments = p.parse_args()
    from mujoco_warp._src import solver

    shipped: Callable[..., int] = getattr(solver, GROUPS)
    groups: dict[int, int] = {}

    def counted(nworld: int, *more: Any) -> int:
        groups[nworld] = shipped(nworld, *more)
        return groups[nworld]

    numbers = [int(number) for number in arguments.numbers.split(",")]
    found: dict[int, list[str]] = {number: [] for number in numbers}
    for replaced in (counted, lambda *_: 1):
        with mock.patch.object(solver, GROUPS, replaced):
            base = trajectory(16, arguments.steps, arguments.device)
            for number in numbers:
                found[number].append(first_difference(base, trajectory(number, arguments.steps, arguments.device)))
    print("| environments | groups each | differs from 16 environments, from step | with one group each |")
    print("| --- | --- | --- | --- |")
    for number, (as_shipped, fixed) in found.items():
        print(f"| {number} | {groups[number]} | {as_shipped} | {fixed} |")
    print(f"\n16 environments have {groups[16]} group each.")


if __name__ == "__main__":
    main()
