"""A Gymnasium vector environment that is recorded as it is stepped."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.array_hashes import Hashed
from gpusimbench.recorder.interruption import postponed
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.vector.device.rows import check_envs
from gpusimbench.recorder.vector.ending import Ending, Hashes
from gpusimbench.recorder.vector.fields import (
    NO_STEP,
    NOT_GIVEN,
    Images,
    array_name,
    fields_of,
    info_arrays,
    nothing_told,
    recorded_dtype,
)
from gpusimbench.recorder.vector.modes import Ledger, Mode, final_name, five, mode_of, with_final
from gpusimbench.recorder.vector.origin import origin_of, seed_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves, on_host
from gpusimbench.schemas.vector import PHYSICS
from gpusimbench.schemas.view.geometry import GEOMETRY, MEDIA_TYPE

_ROWS = 50  # that are handed to the writer at a time
_FLAGS = ("terminated", "truncated")

Row = dict[str, NDArray[Any]]

OF_MUJOCO = ("qpos", "qvel")
_DRAWN = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "jnt_type",
    "jnt_bodyid",
    "jnt_pos",
    "jnt_axis",
    "qpos0",
    "geom_type",
    "geom_bodyid",
    "geom_dataid",
    "geom_pos",
    "geom_quat",
    "geom_size",
    "mesh_vert",
)
"""Arrays of a model by which one that is drawn is told from another."""


class Recorded(Ending, gymnasium.vector.VectorWrapper):  # type: ignore[misc]
    """See gpusimbench.wrap, which makes it.

    What a step returned becomes a row of the recording when the next step begins: until then, a reset by the user may
    replace its observations.
    """

    def __init__(
        self,
        envs: Any,
        path: str | Path,
        *,
        steps: int | None,
        dt: float,
        infos: tuple[str, ...] = (),
        physics: bool = False,
        images: Images = Images.HASH,
    ) -> None:
        super().__init__(envs)
        self._images, self._of_images = images, dict[str, str]()  # and notes on the arrays of their hashes
        self._physics = Physics(envs) if physics else None
        self._path, self._steps, self._dt, self._infos = path, steps, dt, infos
        self._attached: dict[str, tuple[str, bytes]] = {}
        self._mode = mode_of(envs)
        self._ledger = Ledger(self.num_envs, self._mode)
        self._start: tuple[Row, Any] | None = None  # observations of the first reset, and its seed
        self._log: RecordingWriter | None = None
        self._ended = False
        self._block: Row = {}  # rows that are not written yet, [row, env, ...]
        self._dtypes: dict[str, np.dtype[Any]] = {}  # of what is put into it
        self._filled = 0  # of them; a reset may still replace what the last of them says
        self._made = 0  # steps
        self._hashes = Hashes()

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        """See VectorEnv.reset."""
        mask = (options or {}).get("reset_mask")  # which Gymnasium takes out of the options
        observation, info = self.env.reset(seed=seed, options=options)
        if not self._ended:
            self._recording(lambda: self._reset(observation, seed, mask))
        return observation, info

    def step(self, actions: Any) -> Any:
        """See VectorEnv.step. The first step begins the recording, since it tells what actions are."""
        if self._made == self._steps:
            self._recording(lambda: self._end(None))
        if self._ended:
            return self.env.step(actions)
        given = self._action_row(actions)  # before the environment may change them
        try:
            if self._log is None:
                self._begin(given)
            if self._filled == _ROWS:
                self._write()
            returned = self.env.step(actions)
            self._stepped(given, *five(returned))
        except BaseException as error:
            self._end(error)
            raise
        return returned

    def attach(self, files: Mapping[str, tuple[str, bytes]]) -> None:
        """Keep files in the recording, before its first step: name -> (media type, bytes)."""
        self._attached |= files

    def _hash(self, name: str, arrays: Any) -> None:
        states, begun = self._made + 1 if self._start is not None else 0, self._log is not None
        write = (lambda *found: self._recording(lambda: self._write_hashes(*found))) if begun else None
        self._hashes.take(name, arrays, states=states, ended=self._ended, write=write)

    def _write_hashes(self, name: str, found: Hashed, states: int) -> None:
        assert self._log is not None
        self._log.fingerprint(name, found, states=states)

    def _close(self, **keywords: Any) -> None:
        self.env.close(**keywords)

    def _recording(self, function: Callable[[], Any]) -> Any:
        # an error of the environment, or of the recording, is the recording's end
        try:
            return function()
        except BaseException as error:
            self._end(error)
            raise

    def _reset(self, observation: Any, seed: Any, mask: Any) -> None:
        if self._log is None:
            self._start = {**self._seen(_arrays(observation, "observation")), **self._states()}, seed
            return
        every = np.ones(self.num_envs, dtype=np.bool_)
        self._ledger.reset(every if mask is None else on_host(mask, "reset_mask").astype(np.bool_))
        seen = self._seen(_arrays(observation, "observation", copy=False))
        self._put(self._filled - 1, {**seen, **self._states(), **self._counts()})

    def _action_row(self, actions: Any) -> Row:
        if isinstance(actions, (list, tuple)) and not isinstance(self.action_space, gymnasium.spaces.Tuple):
            try:
                actions = np.array(actions)  # one for each environment
            except ValueError:  # they are of different shapes
                raise UsageError("action is a list of arrays of different shapes") from None
        return _arrays(actions, "action")

    def _begin(self, actions: Row) -> None:
        if self._start is None:
            raise UsageError("a vector environment is reset before it is stepped")
        (seen, seed), n_env = self._start, self.num_envs
        given = {name: np.zeros_like(array) for name, array in actions.items()}
        of_step = {
            "reward": np.zeros(n_env, getattr(self.env, "reward_dtype", None)),
            **{name: np.zeros(n_env, dtype=np.bool_) for name in _FLAGS},
        }
        facts = {"stepped": np.zeros(n_env, dtype=np.bool_), **self._counts()}
        of_info = nothing_told(self._infos, n_env)
        row = {**given, **seen, **of_step, **_final(seen), **facts, **of_info}
        check_envs(row)
        notes = {
            **dict.fromkeys([*given, *of_step], NO_STEP),
            **dict.fromkeys(map(array_name, self._infos), NOT_GIVEN),
            **self._of_images,
            **{final_name(name): note for name, note in self._of_images.items()},
        }
        fields = fields_of(row, notes)
        options = {"autoreset_mode": self._mode.value, **origin_of(self.env)}
        if self._of_images:
            options["images"] = self._images.value
        if self._infos:
            options["infos"] = ", ".join(self._infos)
        number, told_seeds = seed_of(seed)
        options |= told_seeds
        log = RecordingWriter(
            self._path, simulator="gymnasium", version=gymnasium.__version__, scene=_name(self.env), n_env=n_env,
            dt=self._dt, steps=self._steps, fields=fields, seed=number, options=options, view=(),
            attachments={**(self._physics.attachments() if self._physics else {}), **self._attached},
        )  # fmt: skip
        log.__enter__()
        self._log = log
        rows = _ROWS if self._steps is None else min(_ROWS, self._steps + 1)
        self._block = {name: np.empty((rows, *array.shape), recorded_dtype(array.dtype)) for name, array in row.items()}
        self._dtypes = {name: array.dtype for name, array in row.items()}
        self._put(0, row)
        self._filled = 1
        self._hashes.begin(self._write_hashes)

    def _stepped(self, given: Row, observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any) -> None:
        seen = self._seen(_arrays(observation, "observation", copy=False))
        flags = {"terminated": on_host(terminated, "terminated", copy=False)}
        flags["truncated"] = on_host(truncated, "truncated", copy=False)
        done = flags["terminated"] | flags["truncated"]
        last = _final(seen)
        if self._mode is Mode.SAME_STEP and done.any():
            last = self._seen(with_final(observation, info, done))
        began = self._ledger.stepped(done)
        if began.any():  # which ignored their actions
            for array in given.values():
                array[began] = 0
        made = ~began
        of_step = {"reward": on_host(reward, "reward", copy=False), **flags, "stepped": made}
        of_info = info_arrays(self._infos, info, self._mode, done, made)
        self._put(self._filled, {**given, **seen, **self._states(), **of_step, **last, **self._counts(), **of_info})
        self._filled += 1
        self._made += 1
        if self._made == self._steps and not self._hashes.given:
            self._end(None)

    def _seen(self, arrays: Row) -> Row:
        return self._images.recorded(arrays, self._of_images)

    def _states(self) -> Row:
        return self._physics.states() if self._physics else {}

    def _counts(self) -> Row:
        return {"episode": self._ledger.episode, "episode_step": self._ledger.step}

    def _put(self, at: int, row: Row) -> None:
        for name, array in row.items():
            column = self._block[name]
            if array.dtype != self._dtypes[name] and recorded_dtype(array.dtype) > column.dtype:
                raise UsageError(f"{name} is {array.dtype}, and was recorded as {column.dtype} before")
            if array.shape != column.shape[1:]:
                raise UsageError(f"{name} has shape {array.shape}, and had {column.shape[1:]} before")
            column[at] = array

    def _write(self) -> None:
        rows, self._filled = self._filled, 0
        if rows and self._log is not None:
            self._log.append(*(column[:rows] for column in self._block.values()))

    def _end(self, error: BaseException | None) -> None:
        with postponed():  # an interruption would leave rows out of a recording that is complete
            if self._ended or self._log is None:
                return
            self._ended = True
            try:
                self._write()
            except BaseException as second:
                error = error or second
                raise
            finally:
                self._log.__exit__(type(error) if error else None, error, None)


def _arrays(tree: Any, name: str, *, copy: bool = True) -> Row:
    return {found: on_host(value, found, copy=copy) for found, value in leaves(tree, name)}


def _final(seen: Row) -> Row:
    return {final_name(name): array for name, array in seen.items() if name.startswith("observation")}


def _name(envs: Any) -> str:
    whole = envs.unwrapped
    told = getattr(getattr(envs, "spec", None), "id", "")
    return told or type(next(iter(getattr(whole, "envs", ())), whole).unwrapped).__name__


class Physics:
    """The data of all tasks; UsageError where they are no MuJoCo tasks of Gymnasium, or live in other processes."""

    def __init__(self, envs: Any) -> None:
        tasks = [one.unwrapped for one in getattr(envs.unwrapped, "envs", ())]
        if not tasks or not all(hasattr(getattr(task, "data", None), name) for task in tasks for name in OF_MUJOCO):
            raise UsageError("physics is recorded of Gymnasium's MuJoCo tasks in a SyncVectorEnv")
        self._tasks = tasks

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """What the bodies look like, for viewers, where all tasks have one model; see geometry_of."""
        from gpusimbench.recorder.simulators.mujoco.geometry import geometry_of

        models = [task.model for task in self._tasks if hasattr(task, "model")]
        if len(models) < len(self._tasks) or any(not _alike(models[0], other) for other in models[1:]):
            return {}
        return {GEOMETRY: (MEDIA_TYPE, geometry_of(models[0]))}

    def states(self) -> dict[str, NDArray[np.float64]]:
        """The present states, [env, ...], by the names of their arrays."""
        return {f"{PHYSICS}{name}": np.stack([getattr(task.data, name) for task in self._tasks]) for name in OF_MUJOCO}


def _alike(one: Any, other: Any) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in _DRAWN)
