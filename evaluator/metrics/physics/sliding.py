"""Friction of single bodies that slide over level ground."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_ROWS = 5


def sliding_friction(
    velocity: Array, slides: npt.NDArray[np.bool_], *, gravity: float, dt: float
) -> Array:  # fmt: skip
    """Coefficients of friction, one for each stretch of at least FEWEST_ROWS rows in which a body slides, shape [n].

    By the impulses of the stretch, so that a body that hops a little counts with the force that it had:

        mu = (|v_0| - |v_n|) / (g t + w_n - w_0),   v in the plane, w upward

    velocity  [m/s], shape [row, n, 3]
    slides    flat on the ground, touched by nothing else, faster than friction stops it in a row, shape [row, n]
    dt        of a row [s]
    """
    padded = np.pad(slides, ((1, 1), (0, 0)))
    change = np.diff(padded.astype(np.int8), axis=0)
    body, begin = np.nonzero((change == 1).T)
    _, end = np.nonzero((change == -1).T)
    long = end - begin >= FEWEST_ROWS
    body, begin, end = body[long], begin[long], end[long] - 1
    first, last = velocity[begin, body], velocity[end, body]
    lost = np.linalg.norm(first[:, :2], axis=-1) - np.linalg.norm(last[:, :2], axis=-1)
    borne = gravity * (end - begin) * dt + last[:, 2] - first[:, 2]
    good = borne > gravity * (end - begin) * dt / 2  # else it was in the air for half of the time
    return np.asarray(lost[good] / borne[good])
