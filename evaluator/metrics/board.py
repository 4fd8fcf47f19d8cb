"""Which bodies are no longer on the board that they should lie on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Board:
    """An axis-aligned board.

    size    full edge lengths [m]
    centre  [m]
    """

    size: tuple[float, ...]
    centre: tuple[float, ...]


def left_board(positions: npt.NDArray[np.floating], board: Board) -> npt.NDArray[np.bool_]:
    """Whether each body's centre is beside the board or below its top face.

    The positional metrics are planar, so a cube that fell off the edge would otherwise look like one that slid far.

    positions  of the bodies' centres [m], shape [..., 3], in the frame of the board

    Returns a boolean per body, shape [...]; a position that is not finite counts as left.
    """
    size = np.array(board.size)
    offset = np.asarray(positions, dtype=np.float64) - np.array(board.centre)
    on_board = (np.abs(offset[..., :2]) <= size[:2] / 2).all(axis=-1) & (offset[..., 2] >= size[2] / 2)
    return np.asarray(~on_board)
