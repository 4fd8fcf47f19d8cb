"""W1 beside cubes that left the board: against formulas, against scipy over shipped recordings, and as it is shown."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.metrics.lost_cubes import Board, clamped
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.numbers import figure
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.parquet import frames
from gpusimbench.evaluator.results.details import BetweenRuns, OffTheBoard
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate, evaluate_files
from gpusimbench.evaluator.results.group_metrics import CLAMPED
from gpusimbench.evaluator.runs.run import Run
from tests.pages import rows_of, tables_of, text_of
from tests.synthetic import grid, write_recording

H200 = Path(__file__).resolve().parents[2] / "recordings" / "protocol-h200"
BOARD = Board((0.6, 0.6, 0.02), (0.3, 0.0, 0.01))
POINTS = arrays(np.float64, (6, 2), elements=st.floats(-200, 200))


def w1(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """W1 [cm] by scipy, of positions [m]."""
    apart = cdist(a, b)
    return float(100 * apart[linear_sum_assignment(apart)].mean())


@given(POINTS, POINTS)
def test_clamping_only_brings_nearer(one: NDArray[np.float64], other: NDArray[np.float64]) -> None:
    """End within the board, leave what lies within it, and make no distance larger."""
    moved = clamped(one, BOARD)
    assert ((moved >= [0.0, -0.3]) & (moved <= [0.6, 0.3])).all()
    within = ((one >= [0.0, -0.3]) & (one <= [0.6, 0.3])).all(axis=1)
    assert np.array_equal(moved[within], one[within])
    assert w1(moved, clamped(other, BOARD)) <= w1(one, other) + 1e-9


def test_a_cube_that_flew_off(tmp_path: Path) -> None:
    """Count the cube, keep the published value, and clamp it to where it left: 60 m of flight become 10 cm of board."""
    final = grid(4)
    final[1, 26] = (60.0, final[1, 26, 1], -90.0)  # from x = 0.5, past the edge at 0.6
    found = evaluate_files([write_recording(tmp_path, final, run=run) for run in range(2)]).results[0].metrics
    pairs = 3 / 6  # of those with environment 1
    assert found["w1_parallel"].value == pytest.approx(100 * (60.0 - 0.5) / 27 * pairs)
    assert found["w1_parallel_clamped"].value == pytest.approx(100 * (0.6 - 0.5) / 27 * pairs)
    assert found["left_board"].value == 0.25
    assert found["left_board"].of(OffTheBoard).envs_with_any == 2


@pytest.mark.parametrize("name", ["isaaclab-newton-inclined", "mjx-jax-inclined"])
def test_shipped_recordings_against_scipy(name: str) -> None:
    """Recompute both variabilities of two runs, published and clamped, with scipy alone."""
    paths = sorted(H200.glob(f"{name}*.mcap"))[3:5]
    (result,) = evaluate_files(paths).results
    recordings = [Recording(path) for path in paths]
    runs = np.array([r.state("cubes", "position").at_step(500) for r in recordings], dtype=np.float64)
    simulation = recordings[0].simulation
    if simulation.env_origins:
        runs -= np.array(simulation.env_origins)[:, None]
    beside = (runs[..., 0] < 0) | (runs[..., 0] > 0.6) | (np.abs(runs[..., 1]) > 0.3)
    assert result.metrics["left_board"].of(OffTheBoard).total == (beside | (runs[..., 2] < 0.02)).sum()
    for suffix, planar in (("", runs[..., :2]), ("_clamped", np.clip(runs[..., :2], [0.0, -0.3], [0.6, 0.3]))):
        envs = np.mean([[w1(a, b) for a, b in combinations(run, 2)] for run in planar])
        assert result.metrics[f"w1_parallel{suffix}"].value == pytest.approx(envs, rel=1e-9)
        between = w1(planar[0].reshape(-1, 2), planar[1].reshape(-1, 2))
        assert result.metrics[f"w1_run_to_run{suffix}"].value == pytest.approx(between, rel=1e-9)


def test_ten_runs_of_mjx_end_in_five_places() -> None:
    """Hold docs/determinism.md to outcomes that are 0.6 to 14.0 cm apart, and to two runs in which a cube fell."""
    (result,) = evaluate_files(sorted(H200.glob("mjx-jax-inclined*.mcap"))).results
    matrix = result.metrics["w1_run_to_run"].of(BetweenRuns).matrix_cm
    assert matrix is not None
    apart = sorted(set(np.round(matrix, 1).ravel()))
    assert (apart[0], apart[1], apart[-1]) == (0.0, 0.6, 14.0)
    assert [int((row == 0).sum()) for row in matrix] == [4, 4, 2, 1, 1, 4, 2, 2, 4, 2]
    assert result.metrics["left_board"].of(OffTheBoard).per_run == (0, 0, 0, 16, 16, 0, 0, 0, 0, 0)
    shown = (Path(__file__).resolve().parents[2] / "docs" / "determinism.md").read_text(encoding="utf-8")
    assert "five outcomes, 0.6 to 14.0 cm apart" in " ".join(shown.split())


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Three runs of 8 environments with one cube beside the board, and a reference with one more."""
    folder = tmp_path_factory.mktemp("few")
    rng = np.random.default_rng(0)
    files = [write_recording(folder, grid(8) + rng.normal(0, 0.002, (8, 27, 3)) * [1, 1, 0], run=r) for r in (0, 1)]
    final = grid(8)
    final[7, 3] = (3.0, 0.0, -4.0)
    files.append(write_recording(folder, final, run=2))
    away = grid(8)
    away[0, 0] = (-9.0, 0.0, -9.0)
    read = Reader(5.0)
    reference = read(write_recording(folder, away, simulator="other"))
    assert isinstance(reference, Run)
    return evaluate([read(path) for path in files], reference=reference)


def test_clamped_distances_are_compared_with_none() -> None:
    """Keep them from gsb-compare, whose family of tests would grow, and from the radar, which has published ones."""
    assert len(CLAMPED) == 3
    assert all(metric.axis is None and metric.radar is None and not metric.published for metric in CLAMPED)


def test_one_cube_of_many_is_shown(few: Evaluation) -> None:
    """Show one cube of 24 environments, and both distances, in text, JSON, HTML, tables and Parquet."""
    found = to_json(few)["groups"][0]["metrics"]
    assert found["left_board"]["value"] == 1 / 24
    assert found["w1_parallel_clamped"]["value"] < found["w1_parallel"]["value"]
    assert found["w1_real_clamped"]["value"] < found["w1_real"]["value"]

    assert "bodies off the board [bodies per env]" in text_of(few)
    assert "<small>in 1 of 24 envs</small>" in render_html(few, published=False, command="")
    made = tables_of(few)
    (row,) = rows_of(made["variability-others"]).values()
    assert row["bodies off the board [bodies per env]"].text == "0.04"
    assert any(line.startswith("clamped:") for line in made["variability-distances"].legend)
    (row,) = rows_of(made["variability-distances"]).values()
    clamped = [cell.text for title, cell in row.items() if title.startswith("clamped W1")]
    assert len(clamped) == 3
    assert all(text.startswith("0.") for text in clamped)
    (row,) = rows_of(made["remade-variability"]).values()
    assert any("clamped to the board: 0." in note for note in row["parallel [cm]"].notes)

    table = frames(few)["metrics.parquet"]
    by_name = {record["metric"]: record for record in table.iter_rows(named=True)}
    assert by_name["w1_parallel_clamped"]["value"] == found["w1_parallel_clamped"]["value"]


def test_floor_and_p_stand_beside_runs(tmp_path: Path) -> None:
    """Show the permutation floor and p of W1 between runs in text, JSON, HTML, tables and Parquet."""
    rng = np.random.default_rng(1)
    files = [write_recording(tmp_path, grid(4) + rng.normal(0, 0.002, (4, 27, 3)) * [1, 1, 0], run=r) for r in range(3)]
    found = evaluate_files(files)
    floor = to_json(found)["groups"][0]["metrics"]["w1_run_to_run"]["extra"]["permutation_test"]["w1"]
    shown = f"{floor['observed_cm']:.3f}; {floor['floor_mean_cm']:.3f}; {floor['p_value']:.2g}"
    assert shown in text_of(found)
    assert shown in render_html(found, published=False, command="")
    table = tables_of(found)["variability-distances"]
    (row,) = table.rows
    assert row.cells[[one.title for one in table.columns].index("first two: W1 [cm]; floor [cm]; p")].text == shown
    assert any(line.startswith("first two: ") for line in table.legend)
    assert not any(line.startswith("clamped") for line in table.legend)  # no cube left the board: there is no column
    rows = {record["metric"]: record for record in frames(found)["metrics.parquet"].iter_rows(named=True)}
    assert rows["w1_run_to_run"]["floor"] == floor["floor_mean_cm"]
    assert rows["w1_run_to_run"]["p_value"] == floor["p_value"]
    assert rows["fps"]["p_value"] is None


def test_why_there_is_no_floor(tmp_path: Path) -> None:
    """Say in text and HTML why environments were not exchanged between runs that differ."""
    files = [write_recording(tmp_path, grid(2) + [0.0, y, 0.0], run=run) for run, y in enumerate((0.0, 0.03))]
    found = evaluate_files(files)
    why = "the environments of a side are identical: there is nothing to exchange"
    assert f"no floor: {why}" in text_of(found)
    assert f"no floor: {why}" in render_html(found, published=False, command="")


def test_no_board_no_clamping(tmp_path: Path) -> None:
    """Say that a scene without a board has none, and keep the published value."""
    (result,) = evaluate_files([write_recording(tmp_path, grid(2), scene="free-fall")]).results
    assert result.metrics["w1_parallel"].value == 0
    assert result.metrics["w1_parallel_clamped"].value == Missing("scene.json names no board (a fixed box)")
    assert json.dumps(to_json(evaluate_files([])))


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        *((value, "bodies per env", shown) for value, shown in ((0.0, "0"), (1 / 750, "0.001"), (0.2, "0.20"))),
        *((value, "bodies per env", shown) for value, shown in ((1.0, "1"), (26.975, "26.98"))),
        *((value, "s", shown) for value, shown in ((0.0, "0"), (-0.5, "-0.5"), (3.2e-6, "< 0.001"), (99.7, "100"))),
        *((value, "MB", shown) for value, shown in ((0.0, "0.00"), (0.003, "0.003"), (-1.2, "-1.20"))),
        *((value, "env-steps/s", shown) for value, shown in ((0.0, "0"), (0.3, "0.3"), (1234.6, "1,235"))),
    ],
)
def test_no_value_is_rounded_to_nothing(value: float, unit: str, shown: str) -> None:
    """Round a value by its unit, with its sign, and never to zero."""
    assert figure(value, unit) == shown
