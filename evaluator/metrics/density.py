"""Density maps: where items end up, counted in hexagons of fixed size on a fixed extent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Density:
    """Counts of a density map; empty bins are left out.

    centres   bin centres [m], shape [n_bin, 2]
    counts    points in each bin, shape [n_bin], every entry >= 1
    off_map   points outside the extent, non-finite ones included
    """

    centres: npt.NDArray[np.float64]
    counts: npt.NDArray[np.int64]
    off_map: int


@dataclass(frozen=True)
class HexGrid:
    """A hexagonal grid that depends on nothing but its own two numbers.

    Bins from different simulators therefore coincide and their counts compare. One hexagon is
    centred on the middle of the extent; hexagons stand on a corner, in rows along x.

    extent_m   x_min, x_max, y_min, y_max [m]; the border belongs to the map
    bin_m      width of a hexagon across its flat sides [m] = distance of neighbouring centres
    """

    extent_m: tuple[float, float, float, float]
    bin_m: float

    def __post_init__(self) -> None:
        x_min, x_max, y_min, y_max = self.extent_m
        if not (all(map(math.isfinite, self.extent_m)) and x_min < x_max and y_min < y_max):
            raise ValueError(f"extent must be finite and not empty, got {self.extent_m}")
        if not (math.isfinite(self.bin_m) and self.bin_m > 0.0):
            raise ValueError(f"bin width must be positive and finite, got {self.bin_m} m")

    def bin(self, positions: npt.ArrayLike) -> Density:
        """Count positions per hexagon.

        A point belongs to the hexagon whose centre is nearest. In axial coordinates (q, r) the
        centre is w * (q + r/2, r * sqrt(3)/2) for bins of width w; a point is rounded there by
        rounding all of q, r and -q-r and recomputing the one that moved most.

        Args:
            positions: planar positions [m], shape [..., 2]; all leading axes are counted together.

        Raises:
            ValueError: the last axis is not of width 2.
        """
        points = np.asarray(positions, dtype=np.float64)
        if points.ndim < 1 or points.shape[-1] != 2:
            raise ValueError(f"positions must have shape [..., 2], got {list(points.shape)}")
        points = points.reshape(-1, 2)
        x_min, x_max, y_min, y_max = self.extent_m
        x, y = points.T
        # Written so that NaN fails it: what blew up is off the map, not lost.
        on_map = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
        cells = self._cells(points[on_map])
        cells, counts = np.unique(cells, axis=0, return_counts=True)
        off_map = len(points) - int(on_map.sum())
        return Density(self._centres(cells), counts.astype(np.int64), off_map)

    def corners(self) -> npt.NDArray[np.float64]:
        """Corners of a hexagon around its centre [m], counter-clockwise, shape [6, 2]."""
        angle = np.pi / 6.0 + np.arange(6) * np.pi / 3.0
        radius = self.bin_m / math.sqrt(3.0)
        return radius * np.column_stack([np.cos(angle), np.sin(angle)])

    def _middle(self) -> npt.NDArray[np.float64]:
        x_min, x_max, y_min, y_max = self.extent_m
        return np.array([(x_min + x_max) / 2.0, (y_min + y_max) / 2.0])

    def _cells(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Axial coordinates of the hexagon of every point, shape [n, 2] -> [n, 2]."""
        u, v = ((points - self._middle()) / self.bin_m).T
        r = v * 2.0 / math.sqrt(3.0)
        q = u - r / 2.0
        exact = np.column_stack([q, r, -q - r])
        cell = np.rint(exact)
        moved = np.abs(cell - exact).argmax(axis=1)
        rows = np.arange(len(cell))
        cell[rows, moved] -= cell.sum(axis=1)  # the three must sum to zero
        axial: npt.NDArray[np.int64] = cell[:, :2].astype(np.int64)
        return axial

    def _centres(self, cells: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        q, r = cells.astype(np.float64).T
        planar = np.column_stack([q + r / 2.0, r * (math.sqrt(3.0) / 2.0)])
        return self._middle() + self.bin_m * planar


def log_density(counts: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Colour value of density bins (GPUSimBench definition): D_b = log10(max(c_b, 1)).

    Args:
        counts: points in each bin, shape [n_bin].

    Raises:
        ValueError: a count is negative.
    """
    counts = np.asarray(counts)
    if (counts < 0).any():
        raise ValueError("counts must not be negative")
    density: npt.NDArray[np.float64] = np.log10(np.maximum(counts, 1).astype(np.float64))
    return density


def marginal(values: npt.ArrayLike, edges: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """One-dimensional marginal of a density map: counts between fixed edges.

    Args:
        values: coordinates along one axis [m], any shape.
        edges: increasing bin edges [m], shape [n_bin + 1]; bins include their lower edge, the last
            one its upper edge too. What lies outside, or is not finite, is not counted.

    Returns:
        counts, shape [n_bin].

    Raises:
        ValueError: fewer than two edges, or edges that are not finite and increasing.
    """
    values = np.asarray(values, dtype=np.float64).ravel()
    edges = np.asarray(edges, dtype=np.float64)
    if edges.ndim != 1 or len(edges) < 2:
        raise ValueError("edges must be a list of at least two")
    if not (np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
        raise ValueError("edges must be finite and increasing")
    counts, _ = np.histogram(values[np.isfinite(values)], bins=edges)
    return counts.astype(np.int64)
