"""The simulation behind docs/statistics.md, and its tables in docs/statistics-simulation.md."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from tests.conftest import finished

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TABLES = ROOT / "docs" / "statistics-simulation.md"


def tables(text: str) -> dict[str, list[list[str]]]:
    """The rows of each Markdown table, by the first cells of its head."""
    found: dict[str, list[list[str]]] = {}
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        head, _, *rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in block.splitlines()]
        found[", ".join(head[:3])] = rows
    return found


@pytest.fixture(scope="module")
def simulated() -> dict[str, list[list[str]]]:
    """The tables of a short simulation."""
    done = finished([sys.executable, "-m", "benchmarks.coverage", "--replications", "40", "--seed", "1"], cwd=ROOT)
    return tables(done.stdout)


def share(cell: str) -> float:
    """A cell in percent."""
    return float(cell.removesuffix(" %")) / 100


def shares(rows: list[list[str]]) -> dict[str, list[float]]:
    """Cells in percent by the first cell of their row."""
    return {first: [share(cell) for cell in cells] for first, *cells in rows}


def test_pairs_are_not_independent(simulated: dict[str, list[list[str]]]) -> None:
    """Cover with the jackknife what pairs taken for independent miss."""
    rows = {(law, int(runs)): cells for law, runs, *cells in simulated["law, runs, jackknife over runs"]}
    jackknife, pairs, bootstrap, none = (share(cell) for cell in rows["Gaussian clouds", 20])
    assert jackknife > 0.8
    assert pairs < 0.7
    assert bootstrap > 0.75
    assert none == 0
    assert share(rows["two outcomes, 9 : 1", 3][3]) > 0.5


def test_points_of_an_env_are_not_independent(simulated: dict[str, list[list[str]]]) -> None:
    """Reject one law rarely where whole envs are exchanged, and often where points are."""
    rows = shares(simulated["law, energy, whole envs, W1, whole envs"])
    energy, w1, energy_points, w1_points = rows["same law, items of an env alike"]
    assert max(energy, w1) < 0.2 < min(energy_points, w1_points)
    by_unit = shares(simulated["law, whole runs exchanged, whole envs exchanged"])
    runs, envs, points = by_unit["runs that differ as a whole"]
    assert runs < 0.2
    assert runs < envs < points


def test_probabilities_of_regimes_come_true(simulated: dict[str, list[list[str]]]) -> None:
    """Predict with ten runs what comes, to a few percent."""
    rows = {int(runs): cells for runs, *cells in simulated["runs, bootstrap, score, polya, score"]}
    assert share(rows[10][4]) < 0.12
    assert share(rows[20][4]) < 0.12


def test_bound_holds_for_the_worst_law(simulated: dict[str, list[list[str]]]) -> None:
    """Be wrong at most once in twenty with R - 1 trials, more often with R."""
    for runs, _, right, naive in simulated["runs, bound, wrong, R - 1 trials"]:
        assert share(right) <= 0.07, runs
        assert share(naive) >= share(right), runs
    assert share(simulated["runs, bound, wrong, R - 1 trials"][0][3]) > 0.08


def test_page_has_what_the_script_prints(simulated: dict[str, list[list[str]]]) -> None:
    """Show in the page the tables of the script, row for row, with figures that a short simulation bears out."""
    shown = tables(TABLES.read_text())
    for head, rows in simulated.items():
        assert [row[0] for row in shown[head]] == [row[0] for row in rows], head
    coverage = "law, runs, jackknife over runs"
    for here, there in zip(simulated[coverage], shown[coverage], strict=True):
        assert here[:2] == there[:2]
        for a, b in zip(here[2:], there[2:], strict=True):
            # 40 replications, few of them with an interval where runs seldom differ
            assert share(a) == pytest.approx(share(b), abs=0.45), here
    apart = [
        abs(share(a) - share(b))
        for here, there in zip(simulated[coverage], shown[coverage], strict=True)
        for a, b in zip(here[2:], there[2:], strict=True)
    ]
    assert sum(apart) / len(apart) < 0.06
