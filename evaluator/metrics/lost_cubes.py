"""Which bodies are lost: no longer on the board that they should lie on, or through what should have held them up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Board:
    """An axis-aligned board.

    size    full edge lengths [m]
    centre  [m]
    """

    size: tuple[float, ...]
    centre: tuple[float, ...]


@dataclass(frozen=True)
class Support:
    """A horizontal face that bodies lie on.

    top       its height [m]
    low, high its extent along x and y [m]; infinite for a ground plane
    """

    top: float
    low: tuple[float, float]
    high: tuple[float, float]


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


class Fallen:
    """Follows bodies, and says which are lower than the top of a board, beside it or through it, after being higher.

    A body that is lower from the beginning, such as one on a floor beside the board, has not fallen.
    """

    def __init__(self, board: Board) -> None:
        self._top = board.centre[2] + board.size[2] / 2
        self._was_higher: npt.NDArray[np.bool_] | None = None

    def feed(self, positions: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Take in the next steps; returns which bodies have fallen, shape [step, env, item].

        positions  of centres in the board's frame [m], shape [step, env, item, 3]
        """
        higher = np.asarray(positions)[..., 2] >= self._top
        was_higher = np.logical_or.accumulate(higher, axis=0)
        if self._was_higher is not None:
            was_higher |= self._was_higher
        self._was_higher = was_higher[-1]
        return np.asarray(was_higher & ~higher)


class Sinking:
    """Follows bodies through time and finds those that end beneath a support after going down through it.

        sank  <=>  z < top - radius at the end, and when z last fell below top, (x, y) was within low .. high

    z is of the body's centre, and no point of the body is further from it than its radius, so that all of the body is
    beneath: soft contacts let a body in by up to its own size for a few steps of an impact, and push it out again. (x,
    y) is that of the two rows before and after the fall, and so of every point between them. What fell over the edge
    was outside of the support in one of them, and is not counted, wherever it went later.

    sank   shape [env, item], after the rows fed so far
    since  row at which each went below the top for the last time, shape [env, item]; -1 where it did not sink
    """

    def __init__(self, first: npt.NDArray[np.floating], supports: Sequence[Support], radii: Array) -> None:
        """Begin with the positions of the first row [m], shape [env, item, 3], and the bodies' radii [m], [item]."""
        self._supports = tuple(supports)
        self._radii = radii
        self._before = np.asarray(first, dtype=np.float64)
        self._through = np.zeros((len(self._supports), *self._before.shape[:2]), dtype=bool)
        self._since = np.full(self._through.shape, -1, dtype=np.int64)
        self._row = 0

    def feed(self, position: npt.NDArray[np.floating]) -> None:
        """The next row [m], shape [env, item, 3]."""
        now = np.asarray(position, dtype=np.float64)
        self._row += 1
        for index, support in enumerate(self._supports):
            was_above, is_above = self._before[..., 2] >= support.top, now[..., 2] >= support.top
            crossed = was_above & (now[..., 2] < support.top)
            crossed &= _within(self._before[..., :2], support) & _within(now[..., :2], support)
            self._through[index] = (self._through[index] | crossed) & ~is_above
            self._since[index][crossed] = self._row
        self._before = now

    @property
    def sank(self) -> npt.NDArray[np.bool_]:
        """Whether each body sank, shape [env, item]."""
        return np.asarray(self._sank().any(axis=0))

    @property
    def since(self) -> npt.NDArray[np.int64]:
        """The row since which it is below, shape [env, item]; -1 where it did not sink."""
        never = np.iinfo(np.int64).max
        rows = np.where(self._sank(), self._since, never).min(axis=0, initial=never)
        return np.asarray(np.where(rows == never, -1, rows))

    def _sank(self) -> npt.NDArray[np.bool_]:
        # by support, [support, env, item]
        beneath = [self._before[..., 2] < support.top - self._radii for support in self._supports]
        return np.asarray(self._through & np.array(beneath, dtype=bool).reshape(self._through.shape))


def may_have_sunk(position: npt.NDArray[np.floating], supports: Sequence[Support], radii: Array) -> bool:
    """Whether any body [m], shape [..., item, 3], is beneath a support: without one, none can have sunk.

    radii  [m], shape [item]
    """
    return any(bool((np.asarray(position)[..., 2] < support.top - radii).any()) for support in supports)


def _within(planar: Array, support: Support) -> npt.NDArray[np.bool_]:
    return np.asarray(((planar >= support.low) & (planar <= support.high)).all(axis=-1))
