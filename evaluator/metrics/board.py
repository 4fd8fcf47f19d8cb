"""Which bodies are no longer on the board that they should lie on, and where its edge is nearest to them."""

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


def clamped(planar: npt.NDArray[np.floating], board: Board) -> npt.NDArray[np.float64]:
    """Each position, or the point of the board's rectangle that is nearest to it:

        x' = min(max(x, x_centre - length / 2), x_centre + length / 2), and y' likewise

    A position beside the board goes to its edge; one above or below the board stays, so cubes on the board stay where
    they are. No two positions get further apart, hence no W1 gets larger.

    planar  positions of the bodies' centres [m], shape [..., 2], in the frame of the board
    """
    centre, half = np.array(board.centre[:2]), np.array(board.size[:2]) / 2
    return np.clip(np.asarray(planar, dtype=np.float64), centre - half, centre + half)
