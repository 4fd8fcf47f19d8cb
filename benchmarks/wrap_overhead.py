"""What gpusimbench.wrap costs: calls of step of a wrapped vector environment beside those of a bare one, in turn.

usage: python -m benchmarks.wrap_overhead [--kind gymnasium|playground|brax|mjx] [--task NAME] [--n-env 64]
                                          [--steps 200] [--rounds 9] [--physics]

gymnasium: both vectors live in this process, begin with one seed and are given the same actions, drawn before. Each
step is made by both, one after the other, in an order that changes from step to step, so that whatever else the machine
does meets both. A round gives one ratio, of the time of all steps and of closing. The beginning of the recording, in
which host and software are described once, is in the first step, and is told apart. The last observations are the same,
bit for bit.

playground, brax, mjx: functional environments on JAX, whose rows are written in the background while later steps are
made. So steps are not made in turn, but runs: all steps of the one, until the device has made them and the recording is
closed, then all of the other, in an order that changes from round to round. Both use one compiled step, and the same
actions, which are on the device. Where the last observations differ, an untimed second run of the bare one
has to differ, too: then it is the device that does not repeat itself. mjx needs the packages jax and mujoco-mjx alone.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread, thread_seconds
from gpusimbench import open_recording, wrap

TASKS = {
    "gymnasium": "HalfCheetah-v5",
    "playground": "CartpoleBalance",
    "brax": "inverted_pendulum",
    "mjx": "four legs",
}

Times = np.ndarray[Any, np.dtype[np.float64]]


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[Times, Any]:
    """What it takes [s], and what it returns: by the clock, of the process on all cores, and how long this thread ran
    and waited for a processor, shape [4]."""
    before = np.array([time.perf_counter(), time.process_time(), *thread_seconds()])
    returned = function(*arguments)
    return np.array([time.perf_counter(), time.process_time(), *thread_seconds()]) - before, returned


class Round(NamedTuple):
    """Of the bare and of the wrapped environments: of `timed`, all steps but the first and closing.

    beginning  how much longer the first step of the wrapped environments took [s]
    closing    of the wrapped environments [s]
    """

    bare: Times
    wrapped: Times
    beginning: float
    closing: float


def one_round(task: str, n_env: int, steps: int, path: Path, seed: int) -> Round:
    """Steps of the bare and of the wrapped vector in turn."""
    import gymnasium

    pair = [gymnasium.make_vec(task, num_envs=n_env, vectorization_mode="sync") for _ in range(2)]
    pair[1] = wrap(pair[1], path)  # no number of steps, so that close ends the recording
    for envs in pair:
        envs.reset(seed=seed)
    pair[0].action_space.seed(seed)
    spent, firsts = [np.zeros(4), np.zeros(4)], [0.0, 0.0]
    last: list[Any] = [None, None]
    for step in range(steps):
        action = pair[0].action_space.sample()
        for which in (0, 1) if step % 2 else (1, 0):
            took, returned = timed(pair[which].step, action)
            last[which] = returned[0]
            if step:
                spent[which] += took
            else:
                firsts[which] = took[0]
    closing = [timed(envs.close)[0] for envs in pair]
    for which in (0, 1):
        spent[which] += closing[which]
    assert np.array_equal(*last)
    assert open_recording(path).status == "complete"
    return Round(spent[0], spent[1], beginning=firsts[1] - firsts[0], closing=float(closing[1][0]))


def functional_round(task: Any, n_env: int, steps: int, path: Path, seed: int, *, physics: bool) -> Round:
    """The same of a functional task."""
    import jax

    wrapped = wrap(task, path, physics=physics)
    shape = (steps, n_env, task.action_size)
    actions = list(jax.random.uniform(jax.random.PRNGKey(seed), shape, minval=-1, maxval=1))
    keys = jax.random.split(jax.random.PRNGKey(seed + 1), n_env)
    spent, firsts = [np.zeros(4), np.zeros(4)], [0.0, 0.0]
    last: list[Any] = [None, None]
    closing = 0.0

    def run(env: Any, state: Any) -> Any:
        nonlocal closing
        for action in actions[1:]:
            state = env.step(state, action)
        jax.block_until_ready(state)
        if env is wrapped:
            closing = timed(env.close)[0][0]
        return state.obs

    for which in (0, 1) if seed % 2 else (1, 0):
        env = (task, wrapped)[which]
        state = jax.block_until_ready(env.reset(keys))
        first, state = timed(lambda env=env, state=state: jax.block_until_ready(env.step(state, actions[0])))
        firsts[which] = first[0]
        spent[which], last[which] = timed(run, env, state)
    if not np.array_equal(*last):
        again = run(task, task.step(task.reset(keys), actions[0]))
        assert not np.array_equal(last[0], again), "the wrapped environment ends elsewhere, where the bare one does not"
    assert open_recording(path).status == "complete"
    return Round(spent[0], spent[1], beginning=firsts[1] - firsts[0], closing=closing)


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=64, steps=200, rounds=9)
    p.add_argument("--kind", choices=TASKS, default="gymnasium")
    p.add_argument("--task", default="", help="of the kind's registry")
    p.add_argument("--physics", action="store_true", help="record qpos and qvel too, of functional tasks")
    a = p.parse_args()
    name, functional = a.task or TASKS[a.kind], a.kind != "gymnasium"
    measure, where = partial(one_round, name), ""
    if functional:
        import jax

        from benchmarks.functional_tasks import task

        measure, where = partial(functional_round, task(a.kind, name), physics=a.physics), jax.devices()[0].device_kind
    found, sizes = [], []
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # where MuJoCo logs that a task's model is old
        for number in range(-1 if functional else 0, a.rounds):
            path = Path(f"{number}.mcap")
            measured = measure(a.n_env, a.steps, path, number + 1)
            if number < 0:  # functions were compiled
                continue
            found.append(measured)
            sizes.append(path.stat().st_size / 1e6)
        os.chdir("/")
    print(f"machine           {machine()}{f'; {where}' if where else ''}")
    print(f"steps             {a.kind} {name}, {a.n_env} envs, {a.steps} steps, {a.rounds} rounds")
    print(f"bare [ms / step]  {spread([one.bare[0] / (a.steps - 1) * 1e3 for one in found])}")
    print(f"wrapped / bare    {spread([one.wrapped[0] / one.bare[0] for one in found])}")
    print(f"of CPU time       {spread([one.wrapped[1] / one.bare[1] for one in found])}")
    for word, at in (("ran", 2), ("waited", 3)) if functional else ():
        print(f"stepping {word:<9}{spread([one.wrapped[at] / one.bare[0] for one in found])}, of the bare time; bare "
              f"{spread([one.bare[at] / one.bare[0] for one in found])}")  # fmt: skip
    print(f"without closing   {spread([(one.wrapped[0] - one.closing) / one.bare[0] for one in found])}")
    print(f"closing [s]       {spread([one.closing for one in found])}")
    print(f"beginning [s]     {spread([one.beginning for one in found])}")
    print(f"recording [MB]    {spread(sizes, 1)}")


if __name__ == "__main__":
    main()
