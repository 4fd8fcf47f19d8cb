"""Which bodies are no longer on the board that they should lie on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def left_board(
    positions: npt.NDArray[np.floating], *, size: npt.NDArray[np.float64], centre: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """Whether each body's centre is beside the board or below its top face.

    The positional metrics are planar, so a cube that fell off the edge would otherwise look like one that slid far.

    positions  of the bodies' centres [m], shape [..., 3], in the frame of `centre`
    size       full edge lengths of the axis-aligned board [m], shape [3]
    centre     of the board [m], shape [3]

    Returns a boolean per body, shape [...]; a position that is not finite counts as left.
    """
    offset = np.asarray(positions, dtype=np.float64) - centre
    on_board = (np.abs(offset[..., :2]) <= size[:2] / 2).all(axis=-1) & (offset[..., 2] >= size[2] / 2)
    return np.asarray(~on_board)
