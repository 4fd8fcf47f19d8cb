"""Any Gymnasium vector environment, recorded in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusimbench.recorder.vector.modes import Mode, mode_of
from gpusimbench.schemas.errors import UsageError

if TYPE_CHECKING:
    from gpusimbench.recorder.vector.wrapper import Recorded


def wrap(
    envs: Any,
    path: str | Path,
    *,
    steps: int,
    dt: float | None = None,
    infos: Sequence[str] = (),
    physics: bool = False,
) -> Recorded | Any:
    """Record a Gymnasium VectorEnv while it is used: the same interface, and a file.

    envs   the vector environment, of Gymnasium 1.0 or later, or the VecEnv of Stable-Baselines3 2
    path   of the recording, which must not exist, in a folder that does; a relative path lies in the folder of the run
           where gsb-run runs the program
    steps  calls of step that are recorded; then the recording is complete, and further calls are only passed on
    dt     simulated time of a step [s]; None: what the task says of it (dt, step_dt, or render_fps of its metadata)
    infos  scalars of the infos that are recorded, such as "success"; "a/b" is b in the dictionary a
    physics  whether MuJoCo's qpos and qvel are recorded, for gsb-replay: of tasks of Gymnasium in this process

    Row 0 is the reset, row k the k-th call of step, of every environment:
    action, observation (that the next action is for), reward, terminated, truncated, final_observation (what step
    returned, before a reset replaced it), episode and episode_step (of the observation), and whether a step was made at
    all, since a call of step that begins the next episode makes none. Each of infos gives info_NAME, what the info of
    the step said, and info_NAME_given, 0 where it said nothing. The autoreset mode is read from the metadata of the
    environment. physics gives physics_qpos and physics_qvel, the state of the observation. Units are unknown.
    Recordings of fewer steps end as failed when the environment is closed.

    A VecEnv gives a VecEnv: the seeds are those that its method seed was given, and the autoreset mode is SameStep.

    Returns the wrapped environment. Raises UsageError where steps or dt cannot be, dt or the autoreset mode is not
    known, or physics of another task is asked for.
    """
    from gpusimbench.recorder.vector.wrapper import Recorded

    if isinstance(infos, str):
        raise UsageError(f'infos is a list of names, such as ("{infos}",)')
    if _is_vec_env(envs):
        from gpusimbench.recorder.vector.stable_baselines import AsGymnasium, RecordedVecEnv

        inner = AsGymnasium(envs, infos)
        return RecordedVecEnv(wrap(inner, path, steps=steps, dt=dt, infos=infos, physics=physics))
    told = dt if dt is not None else step_of(envs)
    if steps < 1:
        raise UsageError(f"at least 1 step is recorded, not {steps}")
    if mode_of(envs) is Mode.NONE:
        raise UsageError("the environment does not say when it is reset: its metadata need an autoreset_mode")
    return Recorded(envs, path, steps=steps, dt=float(told), infos=tuple(dict.fromkeys(infos)), physics=physics)


def step_of(envs: Any) -> float:
    """Simulated time of a step of a vector environment [s]; UsageError where it does not say."""
    told = next(_told(envs), None)
    if told is None:
        raise UsageError("the environment does not say what simulated time a step takes: give dt [s]")
    return float(told)


def _is_vec_env(envs: Any) -> bool:
    # there is none where Stable-Baselines3 was not imported
    module = sys.modules.get("stable_baselines3.common.vec_env")
    return module is not None and isinstance(envs, module.VecEnv)


def _told(envs: Any) -> Iterator[float]:
    # of the vector, and of its first environment where that lives in this process
    whole = envs.unwrapped
    for env in (whole, *(one.unwrapped for one in getattr(whole, "envs", ())[:1])):
        for name in ("dt", "step_dt"):
            if isinstance(value := getattr(env, name, None), (int, float)) and value > 0:
                yield value
    if fps := (envs.metadata or {}).get("render_fps"):
        yield 1 / fps
