"""From how many points, runs or exchanges on another method is used: as the documents say, and exactly from there."""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.audit import distribution
from gpusimbench.evaluator.audit.distribution import Unit, exchangeable, least_p, runs_needed, same_law
from gpusimbench.evaluator.compute.mapping import serial
from gpusimbench.evaluator.metrics import cotenants, divergence, memory, variability
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics import exchange, permutation, regimes
from gpusimbench.evaluator.statistics.exchange import count_dealings, dealings
from gpusimbench.evaluator.statistics.permutation import floor

DOCS = Path(__file__).parents[2] / "docs"
(_FEW, _ENOUGH), (_MANY, _SOME) = permutation._PERMUTATIONS

SAID = [
    (
        "audit.md",
        f"if there are at most {distribution.MOST_ARRANGEMENTS}, otherwise in {distribution.PERMUTATIONS} random",
    ),
    ("audit.md", f"If p is at most {distribution.ALPHA:g}, the two are called different"),
    (
        "audit.md",
        "one original needs {} replays, two need {}, three need {}, ten need {}".format(
            *map(runs_needed, (1, 2, 3, 10))
        ),
    ),
    ("compare-tests.md", f"if there are at most {exchange.MOST_DEALINGS:,}; otherwise {exchange.DRAWN:,} are drawn"),
    ("metrics.md", f"{_ENOUGH} permutations up to {_FEW} points a side, {_SOME} up to {_MANY}, and none beyond"),
    (
        "metrics.md",
        f"p-value of {permutation._ENERGY_PERMUTATIONS} permutations, stands beside it for up to "
        f"{permutation._ENERGY_POINTS:,}",
    ),
    ("gpu-memory.md", f"exceeds one of these three by more than {cotenants.UNEXPLAINED_BYTES >> 20} MiB"),
    ("gpu-memory.md", f"{cotenants.UNLIKE_BYTES >> 20} MiB larger than in another run"),
    ("gpu-memory.md", f"above {memory.HOLDS_WITHIN:.0%}, the model".replace("%", " %")),
    ("metrics.md", f"from the first nonzero distance up to {divergence.FIT_LIMIT_M * 1e3:g} mm"),
    ("metrics.md", f"if R squared of its fit is below {divergence.MIN_R_SQUARED:g}"),
    ("statistics.md", f"from the first nonzero one to the last below {divergence.FIT_LIMIT_M * 1e3:g} mm"),
    ("regimes.md", f"below {regimes.PRESENT_FROM_CM} cm"),
    ("scale.md", f"up to {variability.MAX_DISTINCT}, above which {variability.SAMPLED_ENVS} are drawn"),
]


@pytest.mark.parametrize(("page", "said"), SAID)
def test_the_documents_say_it(page: str, said: str) -> None:
    """Let a document and the code have the same numbers."""
    assert said in " ".join((DOCS / page).read_text(encoding="utf-8").split())


def _envs(count: int, items: int = 1, seed: int = 0) -> npt.NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=(count, items, 2))


@pytest.mark.parametrize(
    ("points", "permutations"), [((4, 4), 9), ((4, 5), 3), ((5, 4), 3), ((6, 6), 3), ((7, 6), None), ((6, 7), None)]
)
def test_permutations_of_the_floor(
    points: tuple[int, int], permutations: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draw as many as the larger side allows, and say why where it allows none; in cm, of points in m."""
    monkeypatch.setattr(permutation, "_PERMUTATIONS", ((4, 9), (6, 3)))
    a, b = _envs(points[0]), _envs(points[1], seed=1)
    w1 = floor(a, b, serial).w1
    if permutations is None:
        assert w1.reason.startswith(f"{max(points)} points a side are too many")
    else:
        assert not isinstance(w1, Missing)
        assert (w1.n_permutation, w1.seed) == (permutations, 0)
        again = floor(100 * a, 100 * b, serial).w1
        assert not isinstance(again, Missing)
        assert again.observed == pytest.approx(100 * w1.observed)
        assert w1.observed == pytest.approx(100 * _w1(a, b)) or len(a) != len(b)


def _w1(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    # the cheapest assignment
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    cost = cdist(a.reshape(-1, 2), b.reshape(-1, 2))
    return float(cost[linear_sum_assignment(cost)].mean())


def test_points_of_the_energy_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute it of as many points on both sides together as are allowed, in cm, and say why not of one more."""
    from scipy.spatial.distance import cdist

    monkeypatch.setattr(permutation, "_ENERGY_POINTS", 10)
    a, b = _envs(2, 2), _envs(3, 2, seed=1)
    found = floor(a, b, serial).energy
    assert not isinstance(found, Missing)
    p, q = a.reshape(-1, 2), b.reshape(-1, 2)
    squared = 2 * cdist(p, q).mean() - cdist(p, p).mean() - cdist(q, q).mean()
    assert found.v_statistic in (pytest.approx(100 * squared), pytest.approx(10 * math.sqrt(squared)))
    assert found.n_permutation == permutation._ENERGY_PERMUTATIONS
    more = floor(a, _envs(4, 2, seed=1), serial).energy
    assert more.reason.startswith("12 points are too many")


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 2)), min_size=2, max_size=7))
def test_dealings_are_all_that_there_are(runs: list[tuple[bool, int]]) -> None:
    """List every way to deal the runs once, the observed one first; draw where there is one more than is looked at."""
    head, blocks = np.array([h for h, _ in runs]), np.array([b for _, b in runs])
    expected = {
        side
        for size in range(len(runs) + 1)
        for side in map(frozenset, combinations(range(len(runs)), size))
        if all(sum(blocks[i] == k for i in side) == (head & (blocks == k)).sum() for k in set(blocks))
    }
    count = count_dealings(head, blocks)
    assert count == len(expected)
    for most in {count, count + 1, count - 1}:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(exchange, "MOST_DEALINGS", most)
            patch.setattr(exchange, "DRAWN", 30)
            patch.setattr(exchange, "_FEWEST_DRAWN", 10)
            found = dealings(head, blocks)
        assert found.exhaustive is (count <= most)
        assert found.head[0].tolist() == head.tolist()
        rows = [frozenset(np.flatnonzero(row)) for row in found.head]
        assert set(rows) <= expected
        assert len(rows) == (count if found.exhaustive else 31)
        assert not found.exhaustive or len(set(rows)) == count


@pytest.mark.parametrize(
    ("runs", "envs", "alike", "unit"),
    [
        ((1, 1), 1, "", Unit.RUNS),
        ((1, 1), 2, "", Unit.ENVIRONMENTS),
        ((1, 1), 9, "", Unit.ENVIRONMENTS),
        ((1, 1), 9, "in a run", Unit.RUNS),
        ((1, 1), 9, "by number", Unit.RUNS),
        ((1, 18), 3, "", Unit.ENVIRONMENTS),
        ((1, 19), 3, "", Unit.RUNS),
        ((2, 4), 3, "", Unit.ENVIRONMENTS),
        ((2, 5), 3, "", Unit.RUNS),
        ((3, 4), 3, "", Unit.RUNS),
    ],
)
def test_what_an_audit_exchanges(runs: tuple[int, int], envs: int, alike: str, unit: Unit) -> None:
    """Exchange environments where runs are too few to reject and no two environments are equal, and runs otherwise."""
    made = [_envs(envs, seed=seed) for seed in range(sum(runs))]
    if alike == "in a run":
        made[0][1] = made[0][0]
    elif alike == "by number":
        made[1][-1] = made[0][-1]
    assert exchangeable(made[: runs[0]], made[runs[0] :]) is unit


def test_arrangements_of_an_audit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at all arrangements of as many as are allowed, and draw some of one more."""
    a, b = [_envs(2, seed=s) for s in range(3)], [_envs(2, seed=s) for s in range(3, 7)]
    monkeypatch.setattr(distribution, "PERMUTATIONS", 19)
    for most, exhaustive, n, least in ((35, True, 35, 1 / 35), (34, False, 19, 1 / 20)):
        monkeypatch.setattr(distribution, "MOST_ARRANGEMENTS", most)
        found = same_law(a, b, time=1.0)
        assert (found.exhaustive, found.n_permutation, found.least_p) == (exhaustive, n, pytest.approx(least))
        assert least_p(3, 4) == pytest.approx(least)
