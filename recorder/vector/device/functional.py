"""A functional environment on JAX that is recorded as it is stepped: reset(rng) and step(state, action)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from gpusimbench.recorder.vector.device import states
from gpusimbench.recorder.vector.device.history import Which
from gpusimbench.recorder.vector.device.jax_rows import JaxRows
from gpusimbench.recorder.vector.device.log import DeviceLog, HostLog
from gpusimbench.recorder.vector.ending import Ending
from gpusimbench.recorder.vector.fields import Images
from gpusimbench.schemas.errors import UsageError

_TRACED = (
    "{0} is called while JAX compiles a function (jit, vmap or scan), where a recording sees no numbers: call {0} "
    "outside of it, where it is compiled anyway, or give the states of a scan to gpusimbench.record_rollout"
)


class RecordedFunctional(Ending):
    """See gpusimbench.wrap, which makes it. All else than reset, step and close is the environment's own.

    reset and step are those of the environment, compiled by jax.jit if they are not yet. The rows of steps stay on the
    device; the recording begins with the first call of step, in the state that it is given.
    """

    def __init__(
        self,
        env: Any,
        path: str | Path,
        *,
        steps: int | None,
        dt: float,
        infos: tuple[str, ...] = (),
        physics: bool = False,
        images: Images = Images.HASH,
    ) -> None:
        import jax

        self._env = env
        self._path, self._steps, self._dt, self._infos, self._physics = path, steps, dt, infos, physics
        self._images = images
        own = (env.reset, env.step)
        again = isinstance(env, RecordedFunctional)  # which JAX cannot compile, and which has compiled them
        self._reset, self._step = (f if again or hasattr(f, "lower") else jax.jit(f) for f in own)
        self._log = DeviceLog(JaxRows(), steps)
        self._layout: states.RecordedArrays | None = None
        self._key: Any = None  # of the state that the last call of step returned
        self._began: Any = None  # of that of the last reset, to which the user may come back
        self._began_with = states.seeds_of(None)

    def __getattr__(self, name: str) -> Any:
        if name == "_env":  # in a copy that is not made yet
            raise AttributeError(name)
        return getattr(self._env, name)

    def reset(self, rng: Any) -> Any:
        """See the environment. The hash of the first keys is an option of the recording."""
        if states.traced(rng):
            raise UsageError(_TRACED.format("reset"))
        state = self._reset(rng)
        if not self._log.ended:
            self._began = states.key_of(state)
            if not self._log.begun:
                self._began_with = states.seeds_of(rng)
        return state

    def step(self, state: Any, action: Any) -> Any:
        """See the environment."""
        if self._log.ended:
            return self._step(state, action)
        if states.traced(getattr(state, "obs", None), getattr(state, "reward", None), action):
            raise UsageError(_TRACED.format("step"))
        self._log.past_the_end()
        if self._log.ended:
            return self._step(state, action)
        try:
            layout = self._begin(state, action)
            self._log.make_room()
            returned = self._step(state, action)
            self._key = states.key_of(returned)
            self._log.keep(layout.row(returned, action))
        except BaseException as error:
            self._log.end(error)
            raise
        return returned

    def _hash(self, name: str, arrays: Any) -> None:
        self._log.fingerprint(name, arrays, reset=self._began is not None)

    def _end(self, error: BaseException | None) -> None:
        self._log.end(error)

    def _close(self, **keywords: Any) -> None:
        if callable(close := getattr(self._env, "close", None)):
            close(**keywords)

    def _begin(self, state: Any, action: Any) -> states.RecordedArrays:
        """Bring the rows that are there to the state that a step begins in."""
        if self._layout is None:
            layout = states.RecordedArrays(
                state, infos=self._infos, physics=self._physics, full=states.cut_after(self._env)
            )
            about = replace(
                states.about(self._env, state, self._began_with, self._infos, physics=self._physics),
                images=self._images,
            )
            self._log.begin(
                layout.first(state, action), HostLog(self._path, steps=self._steps, dt=self._dt, about=about)
            )
            self._layout = layout
        elif self._key is not None:
            now = states.key_of(state)
            if not _same(now, self._key):
                self._log.replace(self._layout.seen(state), self._which(now, hidden=states.hides_the_last(state)))
        return self._layout

    def _which(self, now: Any, *, hidden: bool) -> Which:
        began, before = self._began, self._key[1]
        if began is not None and (_same(now, began) or (now[1] is not None and now[1] is began[1] is not before)):
            return Which.ALL
        moved = now[1] is not self._key[1] if now[1] is not None else True
        return Which.ENDED if moved and not hidden else Which.NONE


def _same(one: Any, other: Any) -> bool:
    return (
        one[1] is other[1]
        and len(one[0]) == len(other[0])
        and all(a is b for a, b in zip(one[0], other[0], strict=True))
    )
