"""What a scan stacked of a functional environment, as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.capture.ranges import STEPS_PER_BLOCK
from gpusimbench.recorder.vector.device import states as of_states
from gpusimbench.recorder.vector.device.log import HostLog
from gpusimbench.recorder.vector.device.rows import check_envs
from gpusimbench.recorder.vector.wrap import given_or, names_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import mapped


def record_rollout(
    env: Any,
    path: str | Path,
    first: Any,
    states: Any,
    actions: Any,
    *,
    dt: float | None = None,
    infos: Sequence[str] = (),
    physics: bool = False,
    rng: Any = None,
) -> None:
    """Write a recording of the states that jax.lax.scan stacked: of environments that are stepped in compiled code.

        def step(state, key):
            action = policy(state.obs, key)
            following = env.step(state, action)
            return following, (following, action)

        last, (states, actions) = jax.lax.scan(step, first, keys)
        record_rollout(env, "a.mcap", first, states, actions, rng=keys_of_the_reset)

    env      that made them, as of wrap; it is not stepped, and says what it is and how long a step takes
    path     as of wrap
    first    the state before the first step, [env, ...]
    states   the state after each step, [step, env, ...]: obs, reward, done, and of info and metrics what is recorded
    actions  that led to them, [step, env, ...]
    dt, infos, physics  as of wrap
    rng      keys that reset was given for the first state; for gsb-compare, rollouts with the same keys are repetitions
             of each other, and a rollout without keys is a repetition of no other

    The recording is the one of wrap. Arrays come to the host 50 steps at a time. Returns nothing. Raises UsageError
    where arrays are not of the same steps, or as of wrap.
    """
    if of_states.traced(first, states, actions, rng):
        raise UsageError("record_rollout is called behind the scan, outside of functions that JAX compiles")
    of_states.check_state(states)
    names = names_of(infos)
    layout, alone = (
        of_states.Layout(first, infos=names, physics=physics, full=of_states.cut_after(env), stacked=stacked)
        for stacked in (True, False)
    )
    rows = layout.row(states, actions)
    if 0 in (*rows["reward"].shape[:1], *(len(array) for array in rows.values() if array.ndim)):
        raise UsageError("the scan stacked no states: at least 1 step is recorded")
    begin = alone.first(first, mapped(lambda array: array[0], actions))
    check_envs(begin)
    steps = len(rows["reward"])
    for name, array in rows.items():
        if tuple(array.shape[1:]) != tuple(begin[name].shape) or len(array) != steps:
            raise UsageError(f"{name} has shape {tuple(array.shape)}, and not {(steps, *begin[name].shape)}")
    about = of_states.about(env, first, of_states.seeds_of(rng), names, physics=physics)
    log = HostLog(path, steps=steps, dt=given_or(dt, of_states.step_of(env)), about=about)
    try:
        log.append({name: np.asarray(array)[None] for name, array in begin.items()}, {})
        for row in range(0, steps, STEPS_PER_BLOCK):
            log.append({name: np.asarray(array[row : row + STEPS_PER_BLOCK]) for name, array in rows.items()}, {})
    except BaseException as error:
        log.end(error)
        raise
    log.end(None)
