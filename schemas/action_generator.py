"""Actions that every engine is given: a pure function of seed, environment and step, which readers draw again."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mixing import GOLDEN32, mix32, mix32_in_place

GRID = 2.0**-13
"""Angles of a robot's joints are whole multiples of this [rad]."""

_TARGETS, _CONTROLS = "murmur3-fmix32-grid13", "murmur3-fmix32"
"""The generators of JointTargets and of Controls, as descriptions name them."""

_WORDS = 1 << 15  # drawn at a time
_WORD_BITS = 16  # of the random word that scales a range; a range of less than 2^16 steps keeps the product in 32 bits
_RANGE_BITS = 15  # steps that a range is divided into, at most
_MANTISSA_BITS = 24  # of a float32
_SMALLEST = 2.0**-102  # whose last bit is a normal float32 still

GENERATOR = "generator"
"""What the metadata of a channel of actions call the description of their generator."""

MAX_RANGE = 1 << _WORD_BITS
"""Steps of its grid that the range of an action has, at most: 8 rad of a joint's target."""

MAX_WIDTH = 256
"""Numbers that an environment is given in a step by a generator that is described in a file."""

COMPILED_BYTES = 500_000_000
"""Of actions, from which on machine code pays: it is loaded before states are captured, and numpy draws 1 GB in as much
time while they are."""

_fill: Callable[..., None] | None = None


def expect(size: int) -> None:
    """Actions of `size` bytes are going to be drawn by this process: from COMPILED_BYTES on by machine code, where
    numba is installed, and from a tenth of that on where it is loaded anyway. They are the same."""
    global _fill
    if size >= (COMPILED_BYTES // 10 if "numba" in sys.modules else COMPILED_BYTES):
        with suppress(Exception):  # Pythons of engines have no numba, or a broken one: see schemas.fingerprint
            from gpusimbench.schemas.compiled import action_loop

            _fill = action_loop()


@dataclass(frozen=True)
class Streams:
    """The stream of actions that each environment is given, by two counters of the generator.

    env    the environment whose actions it is given, uint32 [env]
    begun  the step with which its actions begin anew, as if it were step 0, uint32 [env]; 0: they never do
    """

    env: NDArray[np.uint32]
    begun: NDArray[np.uint32]

    @classmethod
    def usual(cls, n_env: int, first: int = 0) -> Streams:
        """Every environment, from the first on, is given its own actions, which never begin anew."""
        return cls(np.arange(first, first + n_env, dtype=np.uint32), np.zeros(n_env, dtype=np.uint32))

    def of(self, envs: range) -> Streams:
        """Those of consecutive environments."""
        return Streams(self.env[envs.start : envs.stop], self.begun[envs.start : envs.stop])

    def steps(self, first_step: int, n_step: int) -> NDArray[np.uint32]:
        """The generator's step of each step and environment, [step, env]."""
        steps = np.arange(first_step, first_step + n_step, dtype=np.uint32)[:, None]
        return np.where(steps >= self.begun, steps - self.begun, steps)

    def describe(self) -> dict[str, Any]:
        """What differs from the usual: by how many places environments are shifted, and with which steps actions begin
        anew. Empty where nothing does."""
        shift = int(self.env[0]) if self.env.size else 0
        begun = sorted({int(step) for step in self.begun} - {0})
        return {**({"shift": shift} if shift else {}), **({"begun": begun} if begun else {})}


@dataclass(frozen=True)
class JointTargets:
    """A target position for each joint at each step, uniform within its limits (to within its grid).

    Targets are whole multiples of a power of two, the joint's grid: every float32 operation that makes one is exact,
    whatever device does it and whether or not it fuses a multiplication with an addition.

    The generator is counter-based, in 32-bit wrapping integers, so that any step of any environment can be made
    anywhere, in any order, on any device:

        w = mix(seed_low + G);  w = mix(w + seed_high + G)
        w = mix(w + (env + 1) * G);  w = mix(w + (step + 1) * G);  w = mix(w + (joint + 1) * G)
        target = (first[joint] + ((w >> 16) * count[joint] >> 16)) * grid[joint]

    with mix the finaliser of MurmurHash3 and G = 0x9E3779B9 (``schemas.mixing``). Where an environment began in the
    initial state of another slot, or was reset, env and step are those of Streams.

    name          of the topic
    joints        names, in the robot's order
    lower, upper  limits [unit]
    unit          of the targets
    meaning       what an engine does with them
    """

    unit: ClassVar[str] = "rad"
    meaning: ClassVar[str] = "target position of each joint, held during the step"

    name: str
    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def grids_of(self) -> tuple[float, ...]:
        """The numbers of which the targets of each joint are whole multiples [unit]."""
        return (GRID,) * len(self.joints)

    def grid(self) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.float32]]:
        """`first`, `count` and `grid` for each joint: the targets are grid times first .. first + count - 1."""
        grids = self.grids_of()
        first = np.array([math.ceil(x / grid) for x, grid in zip(self.lower, grids, strict=True)], dtype=np.int32)
        last = np.array([math.floor(x / grid) for x, grid in zip(self.upper, grids, strict=True)], dtype=np.int32)
        return first, (last - first + 1).astype(np.uint32), np.array(grids, dtype=np.float32)

    def seed_word(self, seed: int) -> int:
        """The word that `seed` begins the chain with, for generators on a device."""
        low, high = seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF
        golden = np.uint32(GOLDEN32)
        word = mix32(np.array([low], dtype=np.uint32) + golden)
        return int(mix32(word + np.uint32(high) + golden)[0])

    def draw(
        self, seed: int, *, n_env: int, first_step: int, n_step: int, streams: Streams | None = None
    ) -> NDArray[np.float32]:
        """Targets [rad], shape [step, env, joint], of n_env environments; row i leads from the state of step
        first_step + i to the next.

        streams  of these environments; None: each is given its own
        """
        given = Streams.usual(n_env) if streams is None else streams
        env, step, joint = (
            (counter + np.uint32(1)) * np.uint32(GOLDEN32)
            for counter in (given.env, given.steps(first_step, n_step), np.arange(len(self.joints), dtype=np.uint32))
        )
        words = mix32(mix32(np.uint32(self.seed_word(seed)) + env) + step).reshape(-1)
        targets = np.empty((n_step, n_env, len(self.joints)), dtype=np.float32)
        rows = targets.reshape(len(words), len(self.joints))
        if _fill is not None:
            _fill(words, joint, *self.grid(), rows)
            return targets
        first, count, grid = (each[:, None] for each in self.grid())
        size = min(len(words), max(1, _WORDS // len(self.joints)))
        scratch = np.empty((2, size * len(self.joints)), dtype=np.uint32)
        for begin in range(0, len(words), size or 1):
            # [joint, row]: rows run fastest, in a core's cache, which is faster than rows of a few joints
            some = words[begin : begin + size]
            word, spare = (flat[: joint.size * some.size].reshape(joint.size, some.size) for flat in scratch)
            np.add(some, joint[:, None], out=word)
            mix32_in_place(word, spare)
            np.right_shift(word, np.uint32(32 - _WORD_BITS), out=word)
            np.multiply(word, count, out=word)
            np.right_shift(word, np.uint32(_WORD_BITS), out=word)
            index, scaled = word.view(np.int32), spare.view(np.float32)
            np.add(index, first, out=index)
            np.copyto(scaled, index, casting="unsafe")
            np.multiply(scaled, grid, out=scaled)
            rows[begin : begin + size] = scaled.T
        return targets

    def describe(self, seed: int, streams: Streams) -> str:
        """The generator with all that it depends on (JSON)."""
        return json.dumps({"generator": _TARGETS, **self._known(seed), **streams.describe()})

    def _known(self, seed: int) -> dict[str, Any]:
        return {"name": self.name, "seed": seed, "joints": self.joints, "lower": self.lower, "upper": self.upper}


@dataclass(frozen=True)
class Controls(JointTargets):
    """A number for each actuator of a model at each step, whatever the actuator makes of it.

    joints        names of the actuators
    lower, upper  limits, which are float32; where both are the same, the number is that
    grids         of each actuator, as of grid_of
    """

    unit = "of the actuator"
    meaning = "control of each actuator, held during the step"

    grids: tuple[float, ...]

    @classmethod
    def within(cls, name: str, ranges: Mapping[str, tuple[float, float]]) -> Controls:
        """Numbers within these ranges, by the names of the actuators; ValueError for a range that is none."""
        found = [(_number(low), _number(high)) for low, high in ranges.values()]
        grids = tuple(grid_of(low, high) for low, high in found)
        lower, upper = tuple(low for low, _ in found), tuple(high for _, high in found)
        return cls(name, tuple(ranges), lower, upper, grids)

    def grids_of(self) -> tuple[float, ...]:
        """See JointTargets.grids_of."""
        return self.grids

    def describe(self, seed: int, streams: Streams) -> str:
        """See JointTargets.describe."""
        known = {"generator": _CONTROLS, **self._known(seed), "grids": self.grids}
        return json.dumps({**known, **streams.describe()})


def _number(value: float) -> float:
    # in float32, of which what is too small for 24 bits is zero
    return float(np.float32(value)) if abs(value) >= _SMALLEST else 0.0


def grid_of(lower: float, upper: float) -> float:
    """The finest power of two that divides a range into at most 2^15 steps, and of which the multiples within the range
    are float32. ValueError for a range that is none."""
    if not (math.isfinite(lower) and math.isfinite(upper) and lower <= upper):
        raise ValueError(f"{lower} to {upper} is no range")
    largest = max(abs(lower), abs(upper))
    if largest == 0:
        return GRID
    exponent = math.frexp(largest)[1] - _MANTISSA_BITS
    if lower < upper:
        exponent = max(exponent, math.ceil(math.log2((upper - lower) / 2**_RANGE_BITS)))
    return 2.0**exponent


class Generator(NamedTuple):
    """What a file says of the actions that it does not hold."""

    actions: JointTargets
    seed: int

    def draw(self, streams: Streams, first_step: int, n_step: int) -> NDArray[np.float32]:
        """See JointTargets.draw."""
        return self.actions.draw(
            self.seed, n_env=len(streams.env), first_step=first_step, n_step=n_step, streams=streams
        )


def undrawable(actions: JointTargets) -> str:
    """The first range of which a generator would not draw uniformly, or not in whole multiples; empty where none is."""
    for low, high, grid in zip(actions.lower, actions.upper, actions.grids_of(), strict=True):
        # what the generator's words of 32 bits hold, and a float32
        held = 2.0**-126 <= grid <= 2.0**127 and max(abs(low), abs(high)) <= min(grid * 2.0**30, 2.0**127)
        if not (held and 0 <= math.floor(high / grid) - math.ceil(low / grid) < MAX_RANGE):
            return f"the range {low:g} to {high:g} in steps of {grid:g}"
    return ""


def describe_generator(actions: JointTargets, seed: int) -> str:
    """The generator of these actions for `read_generator`; empty where that cannot make them, as those of a file."""
    text = actions.describe(seed, Streams.usual(0))
    try:
        return text if read_generator(text) == (actions, seed) else ""
    except DamagedRecording:
        return ""


@lru_cache(maxsize=16)
def read_generator(text: str) -> Generator:
    """The generator that a description says (see JointTargets.describe), its streams aside.

    DamagedRecording where it is none, or none that is known.
    """
    record = checks.load("the generator of actions", text)
    kind = checks.text(record, "generator")
    if kind not in (_TARGETS, _CONTROLS):
        raise DamagedRecording(f"actions are made by the generator {kind[:60]!r}, not known here; update gpusimbench")
    name, joints = checks.text(record, "name"), checks.texts(record, "joints")
    if not 0 < len(joints) <= MAX_WIDTH:
        raise DamagedRecording(f"a generator makes {len(joints)} numbers for an environment, not 1 to {MAX_WIDTH}")
    lower, upper = (checks.vector(record.get(key), len(joints), f"{key} of a generator") for key in ("lower", "upper"))
    actions = JointTargets(name, joints, lower, upper)
    if kind == _CONTROLS:
        grids = checks.vector(record.get("grids"), len(joints), "grids of a generator")
        actions = Controls(name, joints, lower, upper, grids)
    if refused := undrawable(actions):
        raise DamagedRecording(f"a generator has {refused}")
    return Generator(actions, checks.whole(record, "seed", 0, 2**64 - 1))
