"""Density maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gpusimbench.evaluator.metrics.density import HexGrid, log_density, marginal
from gpusimbench.evaluator.metrics.lost_cubes import Board
from gpusimbench.evaluator.results.density_maps import shared_map
from gpusimbench.evaluator.results.evaluate import evaluate_files
from tests.synthetic import grid, write_recording

GRID = HexGrid((-0.2, 0.6, -0.3, 0.3), 0.05)
POINTS = arrays(
    np.float64,
    array_shapes(min_dims=1, max_dims=2, min_side=0, max_side=30).map(lambda s: (*s, 2)),
    elements=st.floats(-1.0, 1.0) | st.sampled_from([np.nan, np.inf, -np.inf]),
)
FEW = settings(max_examples=60, deadline=None)


@FEW
@given(POINTS)
def test_every_point_is_counted_once(points: np.ndarray) -> None:
    """Account for every point, in a bin or off the map."""
    density = GRID.bin(points)
    assert density.counts.sum() + density.off_map == points.size // 2
    assert (density.counts >= 1).all()
    assert len(np.unique(density.centres.round(9), axis=0)) == len(density.counts)


def test_centres_are_the_nearest() -> None:
    """Choose the nearest of all bin centres."""
    points = np.random.default_rng(0).uniform([-0.2, -0.3], [0.6, 0.3], size=(2000, 2))
    centres = GRID.bin(points).centres
    for point in points:
        (own,) = GRID.bin(point[None]).centres
        nearest = np.linalg.norm(centres - point, axis=1).min()
        assert np.linalg.norm(own - point) <= nearest + 1e-12


def test_neighbours_are_one_width_apart() -> None:
    """Space neighbouring centres by the bin width."""
    points = np.random.default_rng(0).uniform([-0.2, -0.3], [0.6, 0.3], size=(5000, 2))
    centres = GRID.bin(points).centres
    distance = np.linalg.norm(centres[:, None] - centres, axis=-1)
    assert distance[distance > 0].min() == pytest.approx(GRID.bin_m)


def test_grid_does_not_depend_on_the_points() -> None:
    """Give a point the same bin whatever else is counted."""
    one = GRID.bin([[0.11, 0.07]]).centres[0]
    both = GRID.bin([[0.11, 0.07], [-0.15, 0.2]]).centres
    assert (both == one).all(axis=1).any()


def test_middle_of_the_map() -> None:
    """Centre one hexagon on the middle of the extent."""
    density = GRID.bin([[0.2, 0.0], [0.21, 0.01]])
    assert density.centres == pytest.approx(np.array([[0.2, 0.0]]))
    assert density.counts.tolist() == [2]


def test_border_belongs_to_the_map() -> None:
    """Count points on the border and send those beyond it off the map."""
    density = GRID.bin([[-0.2, -0.3], [0.6, 0.3], [0.6000001, 0.0]])
    assert (density.counts.sum(), density.off_map) == (2, 1)


def test_nothing_on_the_map() -> None:
    """Return no bins where nothing landed."""
    density = GRID.bin(np.full((3, 2), 9.0))
    assert density.centres.shape == (0, 2)
    assert (len(density.counts), density.off_map) == (0, 3)


def test_corners() -> None:
    """Draw hexagons that share their corners with their neighbours."""
    corners = GRID.corners()
    assert np.linalg.norm(corners, axis=1) == pytest.approx(GRID.bin_m / np.sqrt(3.0))
    assert np.ptp(corners[:, 0]) == pytest.approx(GRID.bin_m)


@pytest.mark.parametrize(
    ("extent", "width"),
    [((0, 0, 0, 1), 0.1), ((0, 1, 1, 0), 0.1), ((0, np.inf, 0, 1), 0.1), ((0, 1, 0, 1), 0.0)],
)
def test_grid_refuses(extent: tuple[float, float, float, float], width: float) -> None:
    """Refuse an empty extent and a bin without width."""
    with pytest.raises(ValueError):
        HexGrid(extent, width)


def test_bin_refuses_spatial_positions() -> None:
    """Refuse positions that are not planar."""
    with pytest.raises(ValueError, match=r"\[\.\.\., 2\]"):
        GRID.bin(np.zeros((4, 3)))


def test_log_density() -> None:
    """Map counts 0 and 1 to zero and 100 to two."""
    assert log_density([0, 1, 10, 100]).tolist() == [0.0, 0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="negative"):
        log_density([-1])


def test_marginal() -> None:
    """Count between edges and leave out what lies beyond them."""
    values = [-1.0, 0.0, 0.5, 1.0, 2.0, 2.1, np.nan, np.inf]
    assert marginal(values, [0.0, 1.0, 2.0]).tolist() == [2, 2]


@pytest.mark.parametrize("edges", [[0.0], [1.0, 0.0], [0.0, 0.0], [0.0, np.nan]])
def test_marginal_refuses(edges: list[float]) -> None:
    """Refuse edges that bound no bins."""
    with pytest.raises(ValueError, match="edges"):
        marginal([0.0], edges)


BOARD = Board((0.6, 0.6, 0.02), (0.3, 0.0, 0.0))


def test_a_group_has_its_positions_on_the_map(tmp_path: Path) -> None:
    """Count all positions of all runs, in the environments' own frames; give none to runs without states."""
    finals = [grid(2), grid(2) + [0.01, 0.02, 0.0]]
    for run, final in enumerate(finals):
        write_recording(tmp_path, final, run=run)
    write_recording(tmp_path, None, n_env=2, simulator="timed")
    there, none = evaluate_files(sorted(tmp_path.glob("*.mcap"))).results
    assert there.cloud is not None and none.cloud is None
    np.testing.assert_array_equal(there.cloud.positions, np.stack(finals)[..., :2])
    assert there.cloud.density.counts.sum() == 2 * 2 * 27
    assert [counts.sum() for counts in there.cloud.marginals] == [2 * 2 * 27] * 2


def cloud(n_off: int, *, away: float = 100.0, centre: tuple[float, float] = (0.3, 0.0)) -> Any:
    """Positions around a centre [m], shape [1, 1, 300, 2], the first of which flew off."""
    found = np.random.default_rng(n_off).normal(centre, 0.05, (1, 1, 300, 2))
    found[..., :n_off, :] = away
    return found


@pytest.mark.parametrize("off", [[0], [3], [299, 10], [300, 0], [120, 120]])
def test_what_flew_off_does_not_change_the_map_of_a_board(off: list[int]) -> None:
    """Show the board and its surroundings, whatever some recordings lost, and count what is beside them."""
    shared = shared_map([cloud(n) for n in off], None, "s", BOARD)
    assert shared.grid.extent_m == pytest.approx((-0.2, 0.8, -0.5, 0.5))
    assert [shared.grid.bin(cloud(n)).off_map for n in off] == off


@pytest.mark.parametrize("away", [100.0, -100.0, np.nan, np.inf])
def test_a_map_without_a_board_holds_most_positions(away: float) -> None:
    """Find where positions are, without a board or far from it, in spite of those that flew off or are not finite."""
    for board in (None, BOARD):
        shared = shared_map([cloud(30, away=away, centre=(7.0, 7.0))], None, "s", board)
        x_min, x_max, y_min, y_max = shared.grid.extent_m
        assert 6.6 <= x_min < 6.95 < 7.05 < x_max <= 7.4
        assert 6.6 <= y_min < 6.95 < 7.05 < y_max <= 7.4
        assert shared.grid.bin(cloud(30, away=away, centre=(7.0, 7.0))).off_map == 30
    assert shared_map([cloud(0), cloud(0, centre=(50.0, 0.0))], None, "s") is None
    assert shared_map([None, np.full((1, 1, 4, 2), np.nan)], None, "s") is None
