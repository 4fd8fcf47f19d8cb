"""Cubes through the floor: found from states alone, and told apart from a fall over the edge."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.lost_cubes import Sinking, Support, may_have_sunk
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.results.details import SunkCubes
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.metric import Estimate
from tests.synthetic import grid, write_recording

GROUND = Support(0.0, (-math.inf, -math.inf), (math.inf, math.inf))
BOARD = Support(0.02, (0.0, -0.3), (0.6, 0.3))

RADIUS = np.array([0.0173])


def follow(path: list[tuple[float, float, float]], support: Support) -> tuple[bool, int]:
    """Whether one cube sank on its path [m], and since which row."""
    rows = np.array(path)[:, None, None]
    following = Sinking(rows[0], [support], RADIUS)
    for row in rows[1:]:
        following.feed(row)
    return bool(following.sank[0, 0]), int(following.since[0, 0])


@pytest.mark.parametrize(
    ("path", "support", "expected"),
    [
        ([(0, 0, 0.5), (0, 0, 0.01), (0, 0, 0.01)], GROUND, (False, -1)),  # it rests
        ([(0, 0, 0.5), (0, 0, -0.1), (0, 0, -1)], GROUND, (True, 1)),  # it falls through
        ([(0, 0, 0.5), (0, 0, -0.001), (0, 0, 0.01)], GROUND, (False, -1)),  # it comes back
        ([(0, 0, 0.5), (0, 0, -0.1), (0, 0, 0.1), (0, 0, -0.1)], GROUND, (True, 3)),  # since the last time
        ([(0.3, 0, 0.03), (0.3, 0, 0.01)], BOARD, (False, -1)),  # half in
        ([(0.3, 0, 0.03), (0.3, 0, 0.01), (0.3, 0, 0.0)], BOARD, (True, 1)),  # since it went below the top
        ([(0.3, 0, 0.5), (0.3, 0, -4.0)], BOARD, (True, 1)),  # through all of it between two rows
        ([(0.61, 0, 0.03), (0.62, 0, 0.0), (0.7, 0, -4)], BOARD, (False, -1)),  # over the edge
        ([(0.61, 0, 0.03), (0.61, 0, -0.1), (0.5, 0, -1)], BOARD, (False, -1)),  # over the edge and back below it
        ([(0.59, 0, 0.5), (0.99, 0, -0.5)], BOARD, (False, -1)),  # the edge lies before the height
        ([(0.3, 0, -1), (0.3, 0, -2)], BOARD, (False, -1)),  # never was above
        ([(0.3, 0, 0.03), (0.3, 0, math.nan)], BOARD, (False, -1)),
    ],
)
def test_paths(path: list[tuple[float, float, float]], support: Support, expected: tuple[bool, int]) -> None:
    """Count what went down through the surface and stayed below it, and nothing else."""
    assert follow(path, support) == expected


@given(st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=2, max_size=12))
@example([(0.0, 0.0, 0.0), (0.0, 0.0, -5e-324)])
def test_only_what_is_below_can_have_sunk(path: list[tuple[float, float, float]]) -> None:
    """Agree with the shortcut that looks at the last row alone."""
    for support in (GROUND, BOARD):
        sank, since = follow(path, support)
        assert not sank or may_have_sunk(np.array(path[-1:]), [support], RADIUS)
        assert sank == (since > 0)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.001, 2), st.floats(-2, -0.02))
def test_a_ground_plane_has_no_edge(x: float, y: float, above: float, below: float) -> None:
    """Find every fall through a plane, wherever it is."""
    assert follow([(x, y, above), (y, x, below)], GROUND) == (True, 1)


def sank(path: Path) -> Estimate:
    """The metric of one file."""
    (result,) = evaluate_files([path]).results
    return result.metrics["sank"]


@pytest.mark.parametrize(("scene", "left"), [("inclined-collision", 1.0), ("free-fall", None)])
def test_cubes_through_the_floor(tmp_path: Path, scene: str, left: float | None) -> None:
    """Count them per environment on both scenes with the first step, and say so in a note."""
    final = grid(2)
    final[0, :3] = (0.3, 0.0, -1.0)

    def fall(start: np.ndarray, step: int) -> Any:
        rows = np.array(start)
        if step >= 3:
            rows[0, :3] = (0.3, 0.0, -0.1 * step)
        return rows

    path = write_recording(tmp_path, final, scene=scene, steps=6, path_of=fall)
    found = sank(path)
    assert found.value == 1.5
    assert found.details.record() == {
        "total": 3, "of": 54, "cubes": 27, "per_run": [3], "last_step": 6, "first_step": 3
    }  # fmt: skip
    (result,) = evaluate_files([path]).results
    assert "bodies through the floor: 1.5 of 27 per env by step 6, the first at step 3" in result.notes


def test_every_body_sinks_by_its_own_size(tmp_path: Path) -> None:
    """Count a cube that is all beneath the board however large another body of its group is."""
    final = grid(1)
    final[0, 3, 2] = -0.01  # 3 cm below the top of the board

    def larger(name: str, record: dict[str, Any]) -> None:
        if name == "scene.json":
            (body,) = (b for b in record["bodies"] if b["name"] == record["bodies"][-1]["name"])
            body["shape"]["size"] = [0.3, 0.3, 0.3]

    assert sank(write_recording(tmp_path, final, change=larger)).value == 1


def test_a_fall_over_the_edge_is_not_sinking(tmp_path: Path) -> None:
    """Leave cubes that fell off the board to the metric that counts those."""
    final = grid(1)
    final[0, 0] = (0.9, 0.0, -5.0)

    def fall(start: np.ndarray, step: int) -> Any:
        rows = np.array(start)
        rows[0, 0] = (0.6 + 0.05 * step, 0.0, 0.1)
        return rows

    (result,) = evaluate_files([write_recording(tmp_path, final, path_of=fall)]).results
    assert result.metrics["sank"].value == 0
    assert result.metrics["left_board"].value == 1


def test_origins_and_strides(tmp_path: Path) -> None:
    """Follow cubes in each environment's own frame, at the recorded steps only."""
    origins = ((0.0, 0.0, 0.0), (4.0, -8.0, 2.0))
    final = grid(2) + np.array(origins)[:, None]
    final[1, 5] += (0.0, 0.0, -1.0)
    found = sank(write_recording(tmp_path, final, origins=origins, steps=6, stride=3,
                                 path_of=lambda start, step: grid(2) + np.array(origins)[:, None]))  # fmt: skip
    assert (found.of(SunkCubes).total, found.of(SunkCubes).first_step) == (1, 6)


def test_a_real_scene_holds(small_set: list[Path]) -> None:
    """Lose no cube through the board of a real recording."""
    for path in small_set:
        assert sank(path).value == 0


def test_why_it_cannot_be_said(tmp_path: Path) -> None:
    """Give a reason without states, and for a scene of which nothing level is known."""
    assert "no states were recorded" in why_missing(sank(write_recording(tmp_path, None)).value)

    def no_floor(name: str, record: dict[str, Any]) -> None:
        if name == "scene.json":
            record["bodies"] = [b for b in record["bodies"] if b.get("mass")]
            record["board"] = ""

    assert "no level surface" in why_missing(sank(write_recording(tmp_path, grid(1), change=no_floor)).value)
