"""Rigid bodies from row to row: how energy and momentum may change, and whether places follow from velocities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gpusimbench.evaluator.metrics.physics.solids import length, square

Array = npt.NDArray[np.float64]


def mechanical_energy(
    height: Array, linear: Array, angular: Array, *, mass: Array, inertia: Array, gravity: float
) -> Array:
    """Sum over bodies of m v^2 / 2 + I w^2 / 2 + m g z [J], shape [row, env].

    height           of the centres [m], shape [row, env, body]
    linear, angular  velocities [m/s], [rad/s], shape [row, env, body, 3]
    mass, inertia    [kg], [kg m2], shape [body]; the inertia of a solid ball is 2/5 m r^2 and of a cube m edge^2 / 6,
                     about any axis
    """
    kinetic = square(linear) @ mass + square(angular) @ inertia
    return np.asarray(kinetic / 2.0 + gravity * (height @ mass))


class Rises:
    """Follows the energy of isolated bodies, which contacts may take, and give back in part.

    A contact that yields stores what bodies lose while it is compressed; a restitution e gives back e^2 of it.
    So a rise is paid for by what was lost shortly before:

        unpaid = E(k+1) - E(k) - e^2 (max(E(k-n+1), ..., E(k)) - E(k))

    above_start  largest E(t) - E(0) [J], shape [env]
    unpaid       largest of a row [J], shape [env]
    """

    def __init__(self, restitution: float, window: int) -> None:
        """restitution: the largest e of any pair; window: the n rows in which a loss can come back, one or more."""
        self._share, self._window = restitution**2, window
        self._start: Array | None = None
        self._before = self.above_start = self.unpaid = np.zeros(0)

    def feed(self, energy: Array) -> None:
        """The next rows [J], shape [row, env]."""
        if self._start is None:
            self._start = energy[0]
            self.above_start = np.zeros(energy.shape[1])
            self.unpaid = np.full(energy.shape[1], -np.inf)
            self._before = np.full((self._window, energy.shape[1]), -np.inf)
            self._before[-1] = energy[0]
            energy = energy[1:]
        whole = np.concatenate([self._before, energy])
        self._before = whole[-self._window :]
        if not len(energy):
            return
        self.above_start = np.maximum(self.above_start, (energy - self._start).max(axis=0))
        rows = whole[self._window - 1 : -1]
        highest = sliding_window_view(whole[:-1], self._window, axis=0).max(axis=-1)
        unpaid = energy - rows - self._share * (highest - rows)
        self.unpaid = np.maximum(self.unpaid, unpaid.max(axis=0))


class FrictionCone:
    """Follows the momentum of bodies that touch nothing but level ground, and each other.

    Contacts between the bodies cancel. What is left of a change of momentum is the impulse J of the ground,

        J = P(k+1) - P(k) + M g dt,   with  |J_xy| <= mu J_z  and  J_z >= 0

    by Coulomb's law for every contact, hence for their sum.

    excess  largest |J_xy| - mu max(J_z, 0) [N s], shape [env]
    pull    largest -J_z [N s], shape [env]
    rows    intervals that could be judged, shape [env]
    """

    def __init__(self, friction: float, weight: float, dt: float) -> None:
        """friction: the largest coefficient of any pair; weight: M g of all bodies [N]; dt: of a row [s]."""
        self._friction, self._fall = friction, weight * dt
        self._before: tuple[Array, npt.NDArray[np.bool_]] | None = None
        self.excess = self.pull = np.zeros(0)
        self.rows = np.zeros(0, dtype=np.int64)

    def feed(self, momentum: Array, judged: npt.NDArray[np.bool_]) -> None:
        """The next rows: momentum [N s], [row, env, 3], and whether only level ground is touched, [row, env]."""
        if self._before is None:
            self.excess = np.full(momentum.shape[1], -np.inf)
            self.pull = np.full(momentum.shape[1], -np.inf)
            self.rows = np.zeros(momentum.shape[1], dtype=np.int64)
        else:
            momentum = np.concatenate([self._before[0][None], momentum])
            judged = np.concatenate([self._before[1][None], judged])
        self._before = momentum[-1], judged[-1]
        impulse = np.diff(momentum, axis=0)
        up = impulse[..., 2] + self._fall
        excess = np.linalg.norm(impulse[..., :2], axis=-1) - self._friction * np.maximum(up, 0.0)
        both = judged[1:] & judged[:-1]
        self.rows = self.rows + both.sum(axis=0)
        self.excess = np.maximum(self.excess, np.where(both, excess, -np.inf).max(axis=0, initial=-np.inf))
        self.pull = np.maximum(self.pull, np.where(both, -up, -np.inf).max(axis=0, initial=-np.inf))


class Displacements:
    """Follows how far bodies moved beyond what their velocities account for.

        beyond = |x(k+1) - x(k) - (v(k) + v(k+1)) dt / 2| - |v(k+1) - v(k)| dt / 2

    A one-step method of whatever order moves a body by a mean of velocities between those of the two rows, which makes
    `beyond` zero or less. What is left is a correction of positions that no velocity tells.

    largest  [m], shape [env]
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._before: tuple[Array, Array] | None = None
        self.largest = np.zeros(0)

    def feed(self, position: Array, velocity: Array) -> None:
        """The next rows [m], [m/s], shape [row, env, body, 3]."""
        if self._before is None:
            self.largest = np.full(position.shape[1], -np.inf)
        else:
            position = np.concatenate([self._before[0][None], position])
            velocity = np.concatenate([self._before[1][None], velocity])
        self._before = position[-1], velocity[-1]
        half = self._dt / 2.0
        moved = np.diff(position, axis=0) - (velocity[1:] + velocity[:-1]) * half
        beyond = length(moved) - length(np.diff(velocity, axis=0)) * half
        self.largest = np.maximum(self.largest, beyond.max(axis=(0, 2), initial=-np.inf))
