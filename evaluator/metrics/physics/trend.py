"""Constant acceleration, fitted to places on a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_ROWS = 5


@dataclass(frozen=True)
class Trend:
    """The parabola  x(t) = c0 + lead t + acceleration t^2 / 2  of least squares.

    An Euler method of step dt puts a body that starts at rest at a t^2 / 2 + a t dt / 2 (semi-implicit) or
    a t^2 / 2 - a t dt / 2 (explicit) at its steps, exactly. The first-order error is all in `lead`, so `acceleration`
    is a for either of them, and lead / (a dt) tells which it was.

    acceleration  [m/s2], shape of one row
    lead          [m/s], the same shape
    gain          error of the acceleration for an error of at most 1 m in any of the places [1/s2]
    """

    acceleration: Array
    lead: Array
    gain: float


def trend(time: Array, place: Array) -> Trend:
    """Fit places [m], shape [row, ...], at times [s], shape [row]; ValueError with fewer than FEWEST_ROWS rows."""
    if len(time) < FEWEST_ROWS:
        raise ValueError(f"{len(time)} rows are too few for a fit")
    scale = float(np.abs(time).max())
    share = time / scale
    weights = np.linalg.pinv(np.stack([np.ones_like(share), share, share**2 / 2], axis=1))
    _, lead, acceleration = np.tensordot(weights, place, axes=(1, 0))
    gain = float(np.abs(weights[2]).sum()) / scale**2
    return Trend(acceleration / scale**2, lead / scale, gain)


def rounding(steps: int, dt: float, *, largest_place: float, largest_speed: float, epsilon: float) -> float:
    """How far rounding alone can carry a body in a number of steps [m].

    Every step rounds the place and the speed once, by half a unit in the last place at most; an error of the speed
    moves every later place.

    epsilon  of the engine's type: 2^-23 for float32, 2^-52 for float64
    """
    return epsilon / 2 * (steps * largest_place + steps**2 / 2 * dt * largest_speed)
