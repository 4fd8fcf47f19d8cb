"""Recorded actions, fed to a vector environment open loop and recorded again, from a given state where the task can
begin in that: here, MuJoCo tasks of Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.fields import field_of, given
from gpusimbench.recorder.vector.modes import Mode, mode_of
from gpusimbench.recorder.vector.origin import ACTION, GivenEpisode, State, attachments
from gpusimbench.recorder.vector.wrap import wrap
from gpusimbench.recorder.vector.wrapper import OF_MUJOCO, Recorded
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import few
from gpusimbench.schemas.trees import leaves, mapped


class Started(gymnasium.Wrapper):  # type: ignore[misc]
    """A task whose next reset ends in `start`, where that is given."""

    start: GivenEpisode | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """See Env.reset. UsageError where the task cannot be brought into the state."""
        observation, info = self.env.reset(seed=seed, options=options)
        start, self.start = self.start, None
        return (observation if start is None or start.state is None else self.begun(start.state)), info

    def begun(self, state: State) -> Any:
        """Bring the task into a state; returns its observation. UsageError as of reset."""
        task = self.unwrapped
        if not all(callable(getattr(task, name, None)) for name in ("set_state", "_get_obs")):
            raise UsageError(
                f"{type(task).__name__} has no set_state, so that no episode can begin in a recorded state"
            )
        shapes = {name: getattr(task.data, name).shape for name in ("qpos", "qvel")}
        if odd := [name for name, shape in shapes.items() if state[name].shape != shape]:
            raise UsageError(
                f"the recorded {odd[0]} has {state[odd[0]].size} numbers, and the task {shapes[odd[0]][0]}"
            )
        task.set_state(np.asarray(state["qpos"], np.float64), np.asarray(state["qvel"], np.float64))
        return task._get_obs()


def begin_at(envs: Any, starts: Mapping[int, GivenEpisode]) -> None:
    """Have the next reset of some environments end in a state; UsageError where that cannot be.

    starts  by the number of the environment
    """
    tasks = getattr(envs.unwrapped, "envs", ())
    for env, start in starts.items():
        if env >= len(tasks) or not hasattr(tasks[env], "start"):
            raise UsageError(
                "episodes begin in a recorded state only in tasks that --env names: of MuJoCo in Gymnasium, of "
                "ManiSkill, and of robosuite"
            )
        tasks[env].start = start


_SHOWN = 8  # numbers of an action, in an error


@dataclass
class _Place:
    """Where an environment is: which part, and how many of its actions were fed."""

    parts: Sequence[GivenEpisode]
    part: int = 0
    step: int = 0
    ended: bool = False
    last: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def over(self) -> bool:
        return self.ended or self.part >= len(self.parts) or self.step >= len(self.parts[self.part])

    @property
    def next(self) -> GivenEpisode | None:
        return self.parts[self.part] if self.part < len(self.parts) else None

    def take(self) -> dict[str, NDArray[Any]]:
        """The next action; where none is left, the last again."""
        if not self.over:
            self.last = {name: array[self.step] for name, array in self.parts[self.part].actions.items()}
            self.step += 1
        return self.last

    def begin(self) -> None:
        """The next episode."""
        self.part, self.step, self.ended = self.part + 1, 0, False


def replay(
    envs: Any,
    path: Path,
    parts: Sequence[Sequence[GivenEpisode]],
    *,
    seed: Any,
    infos: Sequence[str] = (),
    needed: str = "",
    dt: float,
    images: str = "hash",
) -> None:
    """Reset an environment, feed it the actions of every episode in order, and record what it does.

    envs   a vector environment of as many environments as there are sequences; it is closed afterwards
    path   of the recording, as of wrap
    parts  the episodes of each environment, [env][episode]
    seed   of the first reset: a number, one for each environment, or None
    infos  as of wrap
    needed  an info that some environment gives in its first step; an empty one: none is needed
    dt, images  as of wrap; physics is recorded where parts begin in states of MuJoCo

    An environment whose episode ends earlier than its actions goes on with its next episode. With the autoreset mode
    Disabled, one whose episode has not ended after its last action is reset; in other modes it is fed the last action
    again, and has no further episodes. UsageError where the environment takes other actions, or does not give the info
    that is needed.
    """
    mode = mode_of(envs)
    if envs.num_envs != len(parts):
        envs.close()
        raise UsageError(f"the environment has {envs.num_envs} environments, and the recording {len(parts)}")
    between = 1 if mode is Mode.NEXT_STEP else 0  # calls that begin an episode
    steps = max(sum(len(part) + between for part in of_env) - between for of_env in parts)
    places = [_Place(of_env) for of_env in parts]
    spare = next(of_env[0] for of_env in parts if of_env)
    for place in places:
        place.last = {name: array[0] for name, array in spare.actions.items()}
    physics = any(part.state is not None and set(OF_MUJOCO) <= set(part.state) for of_env in parts for part in of_env)
    with wrap(envs, path, steps=steps, dt=dt, infos=infos, physics=physics, images=images) as recorded:
        if isinstance(recorded, Recorded):  # so that a replay of the replay begins alike
            recorded.attach(attachments(parts))
        form = _Form(recorded.action_space)
        form.check(part for of_env in parts for part in of_env)
        begin_at(envs, _starts(places))
        recorded.reset(seed=seed)
        for step in range(1, steps + 1):
            ended = np.array([place.ended for place in places])
            rows = [place.last if place.ended else place.take() for place in places]
            _, _, terminated, truncated, info = recorded.step(form.filled(rows))
            if needed and step == 1 and not given(info, needed, envs.num_envs).any():
                raise UsageError(f"the environment gives no info {needed}, which was recorded from the first step on")
            if mode is Mode.NEXT_STEP:
                for place in (place for place, over in zip(places, ended, strict=True) if over):
                    place.begin()
            done = (np.asarray(terminated) | np.asarray(truncated)) & ~ended
            for place, over in zip(places, done, strict=True):
                place.ended = bool(over)
            if mode is Mode.SAME_STEP:
                for place in (place for place in places if place.ended):
                    place.begin()
            if mode is Mode.DISABLED and step < steps:
                _reset(recorded, places)


def _reset(envs: Any, places: Sequence[_Place]) -> None:
    mask = np.array([place.over for place in places])
    if not mask.any():
        return
    for place in (place for place, over in zip(places, mask, strict=True) if over):
        place.begin()
    seeds = [place.next.seed if over and place.next else None for place, over in zip(places, mask, strict=True)]
    begin_at(envs, {env: part for env, part in _starts(places).items() if mask[env]})
    seeded = any(seed is not None for seed in seeds)
    envs.reset(options={"reset_mask": mask}, **({"seed": seeds} if seeded else {}))


def _starts(places: Sequence[_Place]) -> dict[int, GivenEpisode]:
    return {env: place.next for env, place in enumerate(places) if place.next and place.next.state is not None}


class _Form:
    """How an environment takes actions: arrays in the order of its action space, nested as that is."""

    def __init__(self, space: Any) -> None:
        self._space, self._sample = space, space.sample()
        self._leaves = [
            (field_of(name, np.asarray(value).dtype, np.shape(value)[1:]).field, np.shape(value)[1:])
            for name, value in leaves(self._sample, ACTION)
        ]

    def check(self, parts: Iterable[GivenEpisode]) -> None:
        """UsageError where real numbers were recorded and the environment takes integers, or not those."""
        of_array = {name: array for part in parts for name, array in part.actions.items()}  # all of one dtype
        for name, value in leaves(self._sample, ACTION):
            array = of_array.get(field_of(name, np.asarray(value).dtype, ()).field)
            if array is not None and array.dtype.kind == "f" and np.asarray(value).dtype.kind != "f":
                raise UsageError(f"the environment takes integers as {name}, and real numbers were recorded")

    def filled(self, rows: Sequence[Mapping[str, NDArray[Any]]]) -> Any:
        """Actions of one step, from those of each environment by name."""
        arrays = []
        for name, shape in self._leaves:
            if name not in rows[0]:
                raise UsageError(f"the environment takes {name}; the recording has {', '.join(rows[0]) or 'none'}")
            found = np.stack([row[name] for row in rows])
            if found[0].size != int(np.prod(shape)):
                raise UsageError(
                    f"the environment takes {name} of shape {shape}, and {found[0].size} numbers were recorded"
                )
            arrays.append(found.reshape(len(rows), *shape))
        remaining = iter(arrays)
        made = mapped(lambda _: next(remaining), self._sample)
        if isinstance(self._space, gymnasium.spaces.MultiDiscrete) and not self._space.contains(made):
            raise UsageError(f"the environment has no action {few(list(map(str, np.ravel(made))), _SHOWN)}")
        return made
