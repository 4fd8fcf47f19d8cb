"""States of a few environments of a recording, some rows at a time, in each environment's own frame; and what all
checks of a run share beside them: its world, its step, and the tolerances that follow."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.read.streams import Fingerprints
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Revision
from gpusimbench.evaluator.runs.physics.world import World
from gpusimbench.evaluator.runs.positions import in_env_frame
from gpusimbench.schemas.initial import drawn
from gpusimbench.schemas.text import ordinal

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

MOST_ENVS = 64
"""Of which more are looked at in no run."""

SEED = 0
"""Of the draw of environments."""

_RANGES = 4  # that the environments are drawn in: each takes a block of the file to be read
_CHUNK_ROWS = 50  # a block's rows, so that none is decoded twice
_CHUNK_BYTES = 16 << 20  # of positions in float64

SHARE = 0.05
"""Of the smallest body, to which physics-2 limits tolerances of lengths: docs/physics.md says why."""


@dataclass(frozen=True)
class States:
    """Rows of all moving bodies.

    step         simulator step of each row, as float64
    position     [m], shape [row, env, body, 3]
    orientation  quaternions wxyz, shape [row, env, body, 4]; None where one group has none
    linear       velocity [m/s], shape [row, env, body, 3], or None
    angular      velocity [rad/s], shape [row, env, body, 3], or None
    distinct     environments no two of which are known to have the same states in these rows
    which        for each environment, the one of `distinct` that has its states: an index into that
    """

    step: Array
    position: Array
    orientation: Array | None
    linear: Array | None
    angular: Array | None
    distinct: Index
    which: Index


def drawn_envs(n_env: int) -> tuple[tuple[int, int], ...]:
    """First and last environment of the ranges to look at: all of up to MOST_ENVS, else equal ranges.

    One is drawn from each part of the run, at a place that SEED decides, so that neighbours in the file, which can be
    read together, and environments far apart are both there.
    """
    if n_env <= MOST_ENVS:
        return ((0, n_env - 1),)
    size = MOST_ENVS // _RANGES
    draw = np.random.default_rng(SEED)
    bounds = [n_env * k // _RANGES for k in range(_RANGES + 1)]
    starts = [int(draw.integers(low, high - size + 1)) for low, high in zip(bounds, bounds[1:], strict=False)]
    return tuple((start, start + size - 1) for start in starts)


class Walk:
    """The states of some environments of a recording, in order of time.

    groups  of bodies, in recording order
    items   group and name of each body, in the order of the arrays
    """

    def __init__(self, recording: Recording, envs: tuple[tuple[int, int], ...]) -> None:
        self._recording = recording
        self._envs = envs
        self.groups = tuple(
            dict.fromkeys(f.group for f in recording.fields if f.field == "position" and len(f.components) == 3)
        )
        self._fields = {
            (f.group, f.field): recording.state(f.group, f.field) for f in recording.fields if f.group in self.groups
        }
        self.items = tuple((g, name) for g in self.groups for name in self._fields[g, "position"].field.items)

    def __len__(self) -> int:
        """Rows that every field has."""
        return min((len(array) for array in self._fields.values()), default=0)

    @property
    def env_numbers(self) -> Index:
        """Of the environments that are read, in the order of the arrays."""
        return np.concatenate([np.arange(first, last + 1) for first, last in self._envs])

    @property
    def epsilon(self) -> float:
        """Spacing of the numbers just above 1, of the coarsest type that positions have."""
        arrays = [self._fields[g, "position"] for g in self.groups]
        return max(float(np.finfo(array.dtype).eps) for array in arrays)

    @property
    def offset(self) -> float:
        """Largest coordinate of the origin of any environment that is read [m]: recorded numbers are as large."""
        simulation = self._recording.simulation
        origins = np.array(simulation.env_origins) if simulation and simulation.env_origins else np.zeros((0, 3))
        return float(max((np.abs(origins[a : b + 1]).max(initial=0.0) for a, b in self._envs), default=0.0))

    def chunks(self) -> Iterator[States]:
        """All rows, a block of the file at a time, or less where that is many megabytes; the initial state, a block of
        its own, is with the first of the others."""
        n_env = sum(last - begin + 1 for begin, last in self._envs)
        rows = max(1, min(_CHUNK_ROWS, _CHUNK_BYTES // (n_env * max(1, len(self.items)) * 3 * 8)))
        begin = 0
        while begin < len(self):
            after = min(len(self), 1 + rows * (1 + max(0, begin - 1) // rows))
            yield self.rows(begin, after)
            begin = after

    def rows(self, first: int, stop: int) -> States:
        """Some rows at once; the caller bounds them."""
        steps = self._fields[self.groups[0], "position"].steps[first:stop].astype(np.float64)
        position = self._read("position", first, stop)
        assert position is not None
        return States(
            steps,
            position,
            self._read("orientation", first, stop),
            self._read("linear_velocity", first, stop),
            self._read("angular_velocity", first, stop),
            *self._distinct(steps, position.shape[1]),
        )

    def _distinct(self, steps: Array, n_env: int) -> tuple[Index, Index]:
        # by the state hashes, which are held against the states when a file is verified
        if self._hashes is not None:
            at = np.searchsorted(self._hashes.steps, steps)
            if np.array_equal(self._hashes.steps[at[at < len(self._hashes.steps)]], steps):
                _, first, which = np.unique(self._hashes.hashes[at], axis=1, return_index=True, return_inverse=True)
                return first, which.reshape(-1)
        return np.arange(n_env), np.arange(n_env)

    @cached_property
    def _hashes(self) -> Fingerprints | None:
        # where all environments are read, and lie at one place
        n_env, simulation = self._recording.configuration.n_env, self._recording.simulation
        if self._envs != ((0, n_env - 1),) or simulation is None or len(set(simulation.env_origins)) > 1:
            return None
        return self._recording.fingerprints("capture")

    def _read(self, field: str, first: int, stop: int) -> Array | None:
        arrays = [self._fields.get((group, field)) for group in self.groups]
        if any(array is None for array in arrays):
            return None
        parts = [
            _joined([self._in_env_frame(array, first, stop, begin, last) for begin, last in self._envs], axis=1)
            for array in arrays
            if array is not None
        ]
        return _joined(parts, axis=2)

    def _in_env_frame(self, array: StateArray, first: int, stop: int, begin: int, last: int) -> Array:
        read = array.read(slice(first, stop), slice(begin, last + 1))
        if array.field.field != "position":
            return read.astype(np.float64, copy=False)
        return in_env_frame(self._recording, array.field, read, slice(begin, last + 1))


def _joined(parts: list[Array], axis: int) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=axis)


@dataclass(frozen=True)
class Slack:
    """A tolerance of a length [m], and its formula in words."""

    size: float
    of: str


@dataclass(frozen=True)
class Setting:
    """A run that is being looked at.

    walk         over its states
    world        its scene
    dt           step of the simulator [s]
    stride       steps between rows
    sample_time  when the scene's outcome is read [s]
    initial      how the run began, as RunConfiguration.initial; empty: in the scene's first state
    revision     of the tolerances
    """

    walk: Walk
    world: World
    dt: float
    stride: int
    sample_time: float
    initial: str = ""
    revision: Revision = NEWEST

    @property
    def begun_otherwise(self) -> Missing | None:
        """Why nothing can be said of a motion that is known from the scene's first state; None where it can."""
        return Missing("the run did not begin in the scene's first state") if self.initial else None

    @property
    def row_time(self) -> float:
        """Simulated time from row to row [s]."""
        return self.dt * self.stride

    @property
    def fall(self) -> float:
        """g dt^2 [m]: how far gravity moves a body from rest in a step of semi-implicit Euler."""
        return self.world.gravity * self.dt**2

    @property
    def limit(self) -> float:
        """The largest tolerance of a length [m]: SHARE of the smallest edge or diameter of a body that moves."""
        if self.revision is Revision.FIRST:
            return math.inf
        return SHARE * min(2.0 * (body.radius or body.half) for body in self.world.moving)

    def slack(self, method: float, rounding: float, of: str) -> Slack | Missing:
        """The tolerance of a length, at most `limit`; Missing where rounding alone is more.

        method    what the step accounts for [m], by the formula `of`
        rounding  what the number type accounts for [m]
        """
        coarse = self.too_coarse(rounding)
        return self.capped(method + rounding, of) if coarse is None else coarse

    def too_coarse(self, rounding: float) -> Missing | None:
        """Why lengths that are rounded by so much [m] can show nothing; None where they can."""
        if rounding <= self.limit:
            return None
        return Missing(
            f"positions are rounded by up to {rounding:.2g} m, more than {SHARE:.0%} of the smallest body "
            f"({self.limit:.2g} m)"
        )

    def capped(self, length: float, of: str) -> Slack:
        """A tolerance [m] by the formula `of`, or `limit` where that is less."""
        if length > self.limit:
            return Slack(self.limit, f"{SHARE:.0%} of the smallest body, less than {of}")
        return Slack(length, of)

    def resolution(self, place: npt.NDArray[np.float64]) -> float:
        """What the number type may add to a distance between two of some places [m], shape [...], in env frames.

        Each coordinate was recorded from the environment's origin, rounded by half a unit in the last place: eps times
        the largest for two of them, less than twice that for three coordinates.
        """
        largest = float(np.abs(place).max(initial=0.0))
        return 2.0 * self.walk.epsilon * (self.walk.offset + largest)

    @property
    def fastest(self) -> float | Missing:
        """sqrt(2 g H) [m/s], with H from the lowest floor to the highest centre at the start, and what was drawn for
        the velocities; or why there is no bound."""
        spread = drawn(self.initial)
        if spread is None and (otherwise := self.begun_otherwise) is not None:
            return otherwise
        tops = [body.top for body in self.world.floors]
        if not tops:
            return Missing("the scene has no level floor")
        highest = max(body.start[2] for body in self.world.moving)
        fall = float((2.0 * self.world.gravity * max(0.0, highest - min(tops))) ** 0.5)
        return fall if spread is None else float(np.hypot(fall, 3**0.5 * spread.spread))

    @property
    def sparse(self) -> str:
        """Why nothing can be said of what happens between rows; empty where every step was recorded."""
        return "" if self.stride == 1 else f"only every {ordinal(self.stride)} state was recorded"
