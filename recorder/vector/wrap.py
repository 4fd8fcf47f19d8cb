"""Any Gymnasium vector environment, recorded in one line; and what a scan stacked of a functional environment."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.simulators.captured import BLOCK_STEPS
from gpusimbench.recorder.vector.device import states as of_states
from gpusimbench.recorder.vector.device import tensors
from gpusimbench.recorder.vector.device.log import HostLog
from gpusimbench.recorder.vector.device.rows import check_envs
from gpusimbench.recorder.vector.fields import Images
from gpusimbench.recorder.vector.modes import Mode, mode_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import mapped

_TIMES = (
    ("step_dt", False), ("control_timestep", False), ("control_freq", True), ("control_hz", True), ("dt", False),
)  # fmt: skip
"""Attributes that tell the time between two actions [s], or (True) their rate [Hz]. dt is the last: where another is
there, dt may be the step of the physics, several of which make a step of the environment."""


def wrap(
    envs: Any,
    path: str | Path,
    *,
    steps: int | None = None,
    dt: float | None = None,
    infos: Sequence[str] = (),
    physics: bool = False,
    images: str = Images.HASH.value,
) -> Any:
    """Record vector environments while they are used: the same interface, and a file.

    envs   a VectorEnv of Gymnasium 1.0 or later, or the VecEnv of Stable-Baselines3 2; an environment of ManiSkill,
           Isaac Lab or mjlab; or a functional environment on JAX, such as those of Brax and MuJoCo Playground in their
           wrappers for training: reset(rng) gives a state, step(state, action) the next one
    path   of the recording, which must not exist, in a folder that does; a relative path lies in the folder of the run
           where gsb-run runs the program
    steps  calls of step that are recorded; then the recording is complete, and further calls are only passed on. None:
           all calls, until the environment is closed
    dt     simulated time between two actions [s]; None: what the task says of it (step_dt, control_timestep,
           control_freq or control_hz, dt, or render_fps of its metadata)
    infos  scalars of the infos that are recorded, such as "success"; "a/b" is b in the dictionary a. Of functional
           environments, keys of the metrics and infos of the state
    physics  whether MuJoCo's qpos and qvel are recorded, for gsb-replay: of tasks of Gymnasium in this process, and of
           functional environments
    images  what is recorded of observations of uint8 with three axes or more: "hash", a 64-bit hash of each frame (16
            bytes), by which gsb-diff finds the first that differs, or "numbers", all of them in float32

    Row 0 is the reset, row k the k-th call of step, of every environment:
    action, observation (that the next action is for), reward, terminated, truncated, final_observation (what step
    returned, before a reset replaced it), episode and episode_step (of the observation), and whether a step was made at
    all, since a call of step that begins the next episode makes none. Each of infos gives info_NAME, what the info of
    the step said, and info_NAME_given, 0 where it said nothing. The autoreset mode is read from the metadata of the
    environment. physics gives physics_qpos and physics_qvel, the state of the observation. Units are unknown.
    Recordings of fewer than `steps` end as failed when the environment is closed.

    A VecEnv gives a VecEnv: the seeds are those that its method seed was given, and the autoreset mode is SameStep.

    Of functional environments, reset and step are compiled by jax.jit. Of these, and of environments with tensors of
    torch, rows stay on the device until a block of 50 is full; nothing waits for the device in a step. Where
    environments are reset within step and do not tell the last observations of episodes, these are not known:
    final_observation_given is 0 there.

    Returns the wrapped environment. Raises UsageError where steps or dt cannot be, dt or the autoreset mode is not
    known, physics of another task is asked for, or images is another word.
    """
    names = names_of(infos)
    if steps is not None:
        if not isinstance(steps, Integral) or isinstance(steps, bool):
            raise UsageError(f"steps is a whole number, not {steps!r:.40}")
        steps = int(steps)
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"path is the file to write, not {path!r:.40}")
    if not all(callable(getattr(envs, name, None)) for name in ("reset", "step")) or isinstance(envs, type):
        raise UsageError(f"{envs!r:.40} is no environment: it has no reset and step")
    if _is_vec_env(envs):
        from gpusimbench.recorder.vector.stable_baselines import AsGymnasium, RecordedVecEnv

        inner = AsGymnasium(envs, names)
        return RecordedVecEnv(wrap(inner, path, steps=steps, dt=dt, infos=names, physics=physics, images=images))
    if steps is not None and steps < 1:
        raise UsageError(f"at least 1 step is recorded, not {steps}")
    how = Images.of(images)
    if of_states.is_functional(envs):
        from gpusimbench.recorder.vector.device.functional import RecordedFunctional

        told = given_or(dt, of_states.step_of(envs))
        return RecordedFunctional(envs, path, steps=steps, dt=told, infos=names, physics=physics, images=how)
    told = given_or(dt, next(_periods(envs), None))
    if tensors.has_tensors(envs):
        if physics:
            raise UsageError("physics is recorded of MuJoCo's environments, not of those with tensors of torch")
        return tensors.recorded_tensors(envs, path, steps=steps, dt=told, infos=names, images=how)
    if mode_of(envs) is Mode.NONE:
        if getattr(envs, "num_envs", None) is None:
            raise UsageError(
                f"{envs!s:.60} is a single environment; wrap records vector environments: gymnasium.make_vec(name, "
                "num_envs=1) makes one of them"
            )
        raise UsageError("the environment does not say when it is reset: its metadata need an autoreset_mode")
    from gpusimbench.recorder.vector.wrapper import Recorded

    return Recorded(envs, path, steps=steps, dt=told, infos=names, physics=physics, images=how)


def step_of(envs: Any) -> float:
    """Simulated time of a step of a vector environment [s]; UsageError where it does not say."""
    return given_or(None, next(_periods(envs), None))


def given_or(dt: float | None, told: float | None) -> float:
    """The time step that was given, or else the task's own [s]; UsageError where there is neither."""
    if dt is None and told is None:
        raise UsageError(
            "the environment does not say what simulated time a step takes: give it in seconds, such as "
            "wrap(..., dt=0.02), or dt=1 where steps have no time"
        )
    try:
        return float(told if dt is None else dt)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise UsageError(f"dt is a number of seconds, not {dt!r:.40}") from None


def names_of(infos: Sequence[str]) -> tuple[str, ...]:
    """Names of infos, each once; UsageError where they are no list of texts."""
    if isinstance(infos, str):
        raise UsageError(f'infos is a list of names, such as ("{infos}",)')
    listed = tuple(infos) if isinstance(infos, Iterable) else (None,)
    if not all(isinstance(name, str) for name in listed):
        raise UsageError(f"infos is a list of names, not {infos!r:.40}")
    return tuple(dict.fromkeys(listed))


def _is_vec_env(envs: Any) -> bool:
    # there is none where Stable-Baselines3 was not imported
    module = sys.modules.get("stable_baselines3.common.vec_env")
    return module is not None and isinstance(envs, module.VecEnv)


def _periods(envs: Any) -> Iterator[float]:
    # of the vector, and of its first environment where that lives in this process
    whole = getattr(envs, "unwrapped", envs)
    for env in (whole, *(one.unwrapped for one in getattr(whole, "envs", ())[:1])):
        for name, rate in _TIMES:
            value = getattr(env, name, None)
            if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0:
                yield 1 / value if rate else value
    if fps := (getattr(envs, "metadata", None) or {}).get("render_fps"):
        yield 1 / fps


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
        of_states.RecordedArrays(first, infos=names, physics=physics, full=of_states.cut_after(env), stacked=stacked)
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
        for row in range(0, steps, BLOCK_STEPS):
            log.append({name: np.asarray(array[row : row + BLOCK_STEPS]) for name, array in rows.items()}, {})
    except BaseException as error:
        log.end(error)
        raise
    log.end(None)
