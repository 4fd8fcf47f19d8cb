"""Distances in joint space: how far the joints of two environments, or of two runs, are from each other.

Joints have names, so each is compared with itself; nothing is transported as in W1. Joints that turn [rad] and joints
that slide [m] are never in one number: a JointSpace has joints of one unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_ENVS = 4096
"""Of more environments, so many are drawn: the pairs of all of them would take minutes."""

_SEED = 0
_CHUNK_PAIRS = 1 << 21


@dataclass(frozen=True)
class JointSpace:
    """Joints of one unit in several environments.

    coordinates  of hinges [rad] or slides [m], shape [env, joint]
    balls        orientations of ball joints, unit quaternions wxyz, shape [env, ball, 4]; none of slides
    """

    coordinates: Array
    balls: Array

    def __len__(self) -> int:
        return len(self.coordinates)

    @property
    def joints(self) -> int:
        """How many joints."""
        return int(self.coordinates.shape[1] + self.balls.shape[1])

    def of(self, envs: npt.NDArray[np.int64] | slice) -> JointSpace:
        """Some of the environments."""
        return JointSpace(self.coordinates[envs], self.balls[envs])


@dataclass(frozen=True)
class BetweenEnvs:
    """Distances between the environments of one run, in the unit of the joints.

    mean   over pairs e < e'
    drawn  environments that were drawn with `seed`; None where all were compared
    """

    mean: float
    drawn: int | None
    seed: int = _SEED


def joint_distance(one: JointSpace, other: JointSpace) -> Array:
    """Root mean square over joints of their difference, env by env, shape [env].

        d(q, q') = sqrt(mean over joints j of delta_j^2)

    delta_j is q_j - q'_j of a hinge or a slide, turns counted, and of a ball joint the angle of the rotation that leads
    from one orientation to the other, 4 asin(|q - s q'| / 2) with the sign s that makes it smaller.

    ValueError where the two have different shapes.
    """
    if one.coordinates.shape != other.coordinates.shape or one.balls.shape != other.balls.shape:
        raise ValueError("the joints of two environments are the same, in the same order")
    squares = ((one.coordinates - other.coordinates) ** 2).sum(axis=1)
    squares = squares + (_angle(one.balls, other.balls) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(squares / one.joints))


def distance_between_envs(space: JointSpace) -> BetweenEnvs:
    """Mean distance over all pairs of environments; ValueError for fewer than two, or without a joint."""
    if len(space) < 2 or not space.joints:
        raise ValueError(f"needs two environments and a joint, got {len(space)} and {space.joints}")
    drawn = None
    if len(space) > MAX_ENVS:
        drawn = MAX_ENVS
        chosen = np.random.default_rng(_SEED).choice(len(space), MAX_ENVS, replace=False)
        space = space.of(np.sort(chosen))
    count = len(space)
    total = 0.0
    rows = max(1, _CHUNK_PAIRS // (count * max(space.joints, 1)))
    for begin in range(0, count - 1, rows):
        some = space.of(slice(begin, begin + rows))
        total += _after(some, space, begin)
    return BetweenEnvs(total / (count * (count - 1) / 2), drawn)


def distances_between_runs(runs: list[JointSpace]) -> Array:
    """Mean over environments of the distance between the same environment of two runs, shape [run, run].

    ValueError where the runs have different joints or numbers of environments.
    """
    matrix = np.zeros((len(runs), len(runs)))
    for i, one in enumerate(runs):
        for j in range(i + 1, len(runs)):
            matrix[i, j] = matrix[j, i] = float(joint_distance(one, runs[j]).mean())
    return matrix


def _after(some: JointSpace, space: JointSpace, begin: int) -> float:
    # sum over pairs of an environment of `some`, which begins at `begin`, and one behind it
    squares = ((some.coordinates[:, np.newaxis] - space.coordinates[np.newaxis]) ** 2).sum(axis=-1)
    squares += (_angle(some.balls[:, np.newaxis], space.balls[np.newaxis]) ** 2).sum(axis=-1)
    behind = np.arange(len(space))[np.newaxis] > np.arange(begin, begin + len(some))[:, np.newaxis]
    return float(np.sqrt(squares[behind] / space.joints).sum())


def _angle(one: Array, other: Array) -> Array:
    """The angle between unit quaternions, in [0, pi] [rad]; exactly zero for equal ones, and for q and -q."""
    # at most the root of two
    apart = np.minimum(np.linalg.norm(one - other, axis=-1), np.linalg.norm(one + other, axis=-1))
    return np.asarray(4.0 * np.arcsin(apart / 2.0))
