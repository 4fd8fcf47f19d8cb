"""States of functional environments (Brax, MuJoCo Playground), and what a row of a recording has of them."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from gpusimbench.recorder.capture.array_hashes import hashed
from gpusimbench.recorder.simulators.jax.runtime import name_of
from gpusimbench.recorder.vector.device.history import DONE, INFO, TRUNCATION
from gpusimbench.recorder.vector.device.log import About
from gpusimbench.recorder.vector.modes import Mode
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves
from gpusimbench.schemas.vector import NO_SEED, PHYSICS, RESET_KEYS, RESET_SEEDS, keys_said
from gpusimbench.schemas.view.geometry import GEOMETRY, MEDIA_TYPE

_FIRST = "first_obs"  # ends the name of the info that a wrapper resets from
_ORIGINS = {"mujoco_playground": "playground", "brax": "brax"}  # packages, and what they are distributed as
_NAMES = (("qpos", "qvel"), ("q", "qd"))  # of MuJoCo's state, and of that of Brax's own pipelines

Row = dict[str, Any]


def is_functional(env: Any) -> bool:
    """Whether step takes a state and an action, and reset a key, as in Brax and MuJoCo Playground."""
    if hasattr(env, "num_envs") or not callable(getattr(env, "reset", None)):
        return False
    try:
        parameters = list(inspect.signature(env.step).parameters.values())
    except (AttributeError, TypeError, ValueError):
        return False
    return sum(p.default is p.empty and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters) == 2


def hides_the_last(state: Any) -> bool:
    """Whether the environments are reset within step, which returns the next episode's first observation."""
    return any(str(key).endswith(_FIRST) for key in (getattr(state, "info", None) or {}))


class RecordedArrays:
    """Which arrays of a state are recorded.

    infos    names of metrics or infos of the state
    physics  whether qpos and qvel are
    full     a reset within step replaces infos too; the number of steps after which it cuts an episode, or 0
    stacked  whether rows are made of states that a scan stacked, [step, env, ...]; `state` itself is not stacked

    UsageError where the state has them not.
    """

    def __init__(
        self, state: Any, *, infos: Sequence[str], physics: bool, full: int = 0, stacked: bool = False
    ) -> None:
        self._infos, self._full = infos, full
        check_state(state)
        pipeline = _pipeline(state)
        self._physics: tuple[str, ...] = ()
        if physics:
            self._physics = next((names for names in _NAMES if all(hasattr(pipeline, name) for name in names)), ())
            if not self._physics:
                raise UsageError("physics is recorded of states with data or pipeline_state, which have qpos and qvel")
        self._single = not state.reward.shape
        self._zeros: Any = None
        self._axes = (slice(None), None) if stacked else (None,)

    def seen(self, state: Any) -> Row:
        """What a reset replaces: observations and physics, [env, ...]."""
        row = _arrays(state.obs, "observation")
        pipeline = _pipeline(state)
        row |= {f"{PHYSICS}{name}": getattr(pipeline, name) for name in self._physics}
        return self._batched(row)

    def row(self, state: Any, action: Any) -> Row:
        """What a step was given, and what it returned, [env, ...]."""
        info: Mapping[str, Any] = getattr(state, "info", None) or {}
        truncation = info["steps"] >= self._full if self._full and "steps" in info else info.get("truncation")
        told = {f"{INFO}{name}": _scalar(state, name) for name in self._infos}
        done = state.done
        of_step = {DONE: done, TRUNCATION: self._nowhere(done) if truncation is None else truncation}
        acted = self._batched(_arrays(action, "action"))
        return {**acted, **self.seen(state), **self._batched({"reward": state.reward, **of_step, **told})}

    def _nowhere(self, done: Any) -> Any:
        # made once: JAX takes a thread that keeps a device busy 0.1 ms to start a function, however small
        if self._zeros is None or (self._zeros.shape, self._zeros.dtype) != (done.shape, done.dtype):
            self._zeros = done * 0
        return self._zeros

    def first(self, state: Any, action: Any) -> Row:
        """The row of a state that no step led to."""
        import jax.numpy as jnp

        row, seen = self.row(state, action), self.seen(state)
        return {name: array if name in seen else jnp.zeros_like(array) for name, array in row.items()}

    def _batched(self, row: Row) -> Row:
        return {name: array[self._axes] for name, array in row.items()} if self._single else row


def check_state(state: Any) -> None:
    """UsageError where something is no state of an environment."""
    if missing := [name for name in ("obs", "reward", "done") if not hasattr(state, name)]:
        raise UsageError(f"{type(state).__name__} has no {missing[0]}, and is no state of an environment")


def key_of(state: Any) -> tuple[Any, Any]:
    """What tells by identity whether a state has the observations, and the physics, of another."""
    pipeline = _pipeline(state)
    moved = next((getattr(pipeline, a) for a, _ in _NAMES if hasattr(pipeline, a)), None)
    return [array for _, array in leaves(state.obs, "")], moved


def traced(*trees: Any) -> bool:
    """Whether JAX is tracing a function for which one of the trees stands."""
    import jax

    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def seeds_of(rng: Any) -> dict[str, str]:
    """The option that tells by which keys environments were reset, by seed or hash; that none is known of None.

    UsageError where they are no array of numbers.
    """
    if rng is None:
        return {RESET_SEEDS: NO_SEED}
    import jax

    try:
        data = np.asarray(jax.random.key_data(rng))
    except TypeError as error:
        raise UsageError(f"rng is no key of JAX: {error}") from None
    found = hashed(data, "rng")
    # jax.random.key(seed) has the words 0 and seed; a key that was split has others, but for one of 2**33
    seed = int(data[1]) if data.shape == (2,) and data[0] == 0 and data[1] < 2**31 else None
    return {RESET_KEYS: keys_said(found.arrays[0].rpartition(" ")[0], found.hashes[0], seed)}


def about(env: Any, state: Any, options: Mapping[str, str], infos: Sequence[str], *, physics: bool) -> About:
    """What a recording says of an environment whose states are such, and of which these infos are recorded.

    physics  whether its states of MuJoCo are: then its model is attached, where it tells it
    """
    hidden = hides_the_last(state)
    devices = getattr(state.reward, "devices", None)  # numpy's arrays have none
    device = name_of(next(iter(devices()))) if devices else "cpu"
    whole = getattr(env, "unwrapped", env)
    package = next((root for root in _roots(whole) if root in _ORIGINS), "jax")
    try:
        number = version(_ORIGINS.get(package, package))
    except PackageNotFoundError:
        number = getattr(sys.modules.get(package), "__version__", "unknown")
    wrappers = ", ".join(type(one).__name__ for one in _chain(env) if one is not whole)
    return About(
        simulator=package,
        version=number,
        scene=type(whole).__name__,
        device=device,
        mode=Mode.SAME_STEP if hidden else Mode.DISABLED,
        hidden=hidden,
        options={
            **options,
            **({"infos": ", ".join(infos)} if infos else {}),
            **({"env_wrappers": wrappers} if wrappers else {}),
            "jax": version("jax"),
        },
        attachments=_geometry(whole) if physics else {},
    )


def _geometry(env: Any) -> dict[str, tuple[str, bytes]]:
    model = getattr(env, "mj_model", None) or getattr(getattr(env, "sys", None), "mj_model", None)
    if type(model).__name__ != "MjModel":
        return {}
    from gpusimbench.recorder.simulators.mujoco.geometry import geometry_of

    return {GEOMETRY: (MEDIA_TYPE, geometry_of(model))}


def step_of(env: Any) -> float | None:
    """Simulated time of a step [s], several of the task where a wrapper repeats actions; None where it does not say."""
    dt = getattr(env, "dt", None)
    try:
        return float(dt) * int(getattr(env, "action_repeat", 1)) if dt is not None else None
    except (TypeError, ValueError):
        return None


def cut_after(env: Any) -> int:
    """Steps after which an episode is cut, of a wrapper whose reset replaces infos; 0 where there is none."""
    full = any(getattr(one, "_full_reset", False) for one in _chain(env))
    return int(getattr(env, "episode_length", 0)) if full else 0


def _pipeline(state: Any) -> Any:
    found = getattr(state, "data", None)
    return getattr(state, "pipeline_state", None) if found is None else found


def _scalar(state: Any, name: str) -> Any:
    for told in (getattr(state, "metrics", None) or {}, getattr(state, "info", None) or {}):
        if name in told:
            array = told[name]
            if getattr(array, "shape", None) != state.reward.shape:
                raise UsageError(f"info {name} is no number for each of the environments")
            return array
    raise UsageError(f"the state has no metric or info named {name}")


def _arrays(tree: Any, name: str) -> Row:
    row = dict(leaves(tree, name))
    for found, array in row.items():
        if not hasattr(array, "dtype") or not hasattr(array, "shape"):
            raise UsageError(f"{found} is {type(array).__name__}, and no array")
    return row


def _chain(env: Any) -> Iterator[Any]:
    yield env
    while "env" in getattr(env, "__dict__", {}):
        env = env.env
        yield env


def _roots(env: Any) -> list[str]:
    return [base.__module__.partition(".")[0] for base in type(env).__mro__]
