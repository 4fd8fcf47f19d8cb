"""Certified W1 of large sets: bounds that hold the exact value, a dual that stands alone, one result for one input."""

from __future__ import annotations

import json
import os
import sys
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from gpusimbench.evaluator.transport.kd_tree import (
    DEPTH,
    LEAF,
    LIFT,
    Tree,
    _bound,
    build,
    lift_planes,
    search,
    set_planes,
)
from gpusimbench.evaluator.transport.large import (
    COARSEST,
    RATIO,
    SAME_POINTS,
    Certified,
    Solution,
    certified_wasserstein1,
    solve,
)
from tests.conftest import run_python

COORDINATE = st.floats(-10.0, 10.0, width=32)
# Few distinct values: ties and duplicates are the rule.
COARSE = st.integers(-2, 2).map(float)
SOME = settings(max_examples=60, deadline=None)


def pairs(elements: st.SearchStrategy[float], most: int = 24):
    """Strategy: two planar point sets of one size, shape [2, n, 2]."""
    return st.integers(1, most).flatmap(lambda n: arrays(np.float64, (2, n, 2), elements=elements))


def exact(a: np.ndarray, b: np.ndarray) -> float:
    """W1 by scipy's dense assignment."""
    distance = cdist(a, b)
    rows, columns = linear_sum_assignment(distance)
    return float(distance[rows, columns].mean())


def holds(bounds: Certified, value: float, rounding: float = 1e-12) -> bool:
    """Whether a value that is itself rounded lies within the bounds."""
    return bounds.low <= value * (1 + rounding) and value * (1 - rounding) <= bounds.high


def board(n: int, seed: int, spread: float = 3.0) -> np.ndarray:
    """Resting places [cm] on a board of 60 x 60: clusters, and a quarter scattered; shape [n, 2]."""
    draw = np.random.default_rng(seed)
    centres = np.random.default_rng(5).uniform(-14, 14, (27, 2))
    points = centres[draw.integers(0, 27, n)] + spread * draw.standard_normal((n, 2))
    points[::4] = draw.uniform(-30, 30, (len(points[::4]), 2))
    return np.clip(points, -30, 30)


@SOME
@given(pairs(COORDINATE), st.sampled_from([0.0, 1e-6, 0.01, 0.3]))
def test_bounds_hold_the_exact_value(sets: np.ndarray, relative: float) -> None:
    """Hold scipy's value, and meet the tolerance wherever it is above what float64 can give."""
    bounds = certified_wasserstein1(*sets, relative=relative)
    value = exact(*sets)
    assert holds(bounds, value, 1e-12) or abs(bounds.high - value) < 1e-13
    assert bounds.high - bounds.low <= max(relative * bounds.high, 1e-11 * (1.0 + float(np.ptp(sets))))


def test_bounds_hold_what_no_float_is() -> None:
    """Hold the mean of distances to forty digits, though sums of rounded ones lie beside it."""
    a = np.stack([100.0 * np.arange(64), np.zeros(64)], axis=1)
    for seed in range(10):
        b = a + np.random.default_rng(seed).uniform(size=a.shape)  # each point's partner is the nearest by far
        bounds = certified_wasserstein1(a, b, relative=0.0)
        with localcontext() as context:
            context.prec = 40
            ways = np.vectorize(Decimal)(b) - np.vectorize(Decimal)(a)
            value = sum((x * x + y * y).sqrt() for x, y in ways) / len(a)
            assert Decimal(bounds.low) <= value <= Decimal(bounds.high)


@SOME
@given(pairs(COARSE, 60))
def test_ties_and_duplicates(sets: np.ndarray) -> None:
    """Hold scipy's value where points repeat, within one set and between both."""
    bounds = certified_wasserstein1(*sets, relative=1e-6)
    assert holds(bounds, exact(*sets))
    assert bounds.high - bounds.low <= 1e-6 * bounds.high


@SOME
@given(pairs(COORDINATE), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_points_on_a_line(sets: np.ndarray, x: float, y: float) -> None:
    """Agree with the sorted solution on a line, which one dimension has."""
    a, b = sets[0, :, :1] * [x, y], sets[1, :, :1] * [x, y]
    along = np.hypot(x, y) * np.sort(sets[:, :, 0], axis=1)
    value = float(np.abs(along[0] - along[1]).mean())
    bounds = certified_wasserstein1(a, b, relative=1e-3)
    assert bounds.low <= value * (1 + 1e-12) + 1e-13
    assert value <= bounds.high * (1 + 1e-12) + 1e-13


@SOME
@given(pairs(COORDINATE), st.sampled_from([-1060, -1000, -300, 300, 1000, 1016]))
@example(np.array([[[0.0, 0.0]], [[3.0, 4.0]]]), -1060)
def test_scales(sets: np.ndarray, exponent: int) -> None:
    """Hold the value in units that are tiny or huge; what leaves the range of float64 only widens the bounds."""
    a, b = np.round(sets * 1024) / 1024
    assume(not np.array_equal(a, b))
    near = certified_wasserstein1(a, b)
    bounds = certified_wasserstein1(np.ldexp(a, exponent), np.ldexp(b, exponent))
    step = np.ldexp(1.0, -1074 - exponent) if exponent < 0 else 0.0
    assert np.ldexp(bounds.low, -exponent) == pytest.approx(near.low, rel=1e-12, abs=2 * step)
    assert np.ldexp(bounds.high, -exponent) == pytest.approx(near.high, rel=1e-12, abs=2 * step)


@SOME
@given(pairs(COORDINATE), st.sampled_from([0.0, 1e3, 1e9, -1e12]))
def test_offsets(sets: np.ndarray, offset: float) -> None:
    """Hold the value of points far from the origin, as they are once rounded there."""
    a, b = sets + offset
    bounds = certified_wasserstein1(a, b, relative=1e-4)
    value = exact(a - offset, b - offset)
    assert bounds.low <= value * (1 + 1e-12) + 1e-13
    assert value <= bounds.high * (1 + 1e-12) + 1e-13


@pytest.mark.parametrize("shift", [pytest.param(0.0, marks=pytest.mark.slow), 4.0])
@pytest.mark.slow
def test_levels_hold_the_exact_value(shift: float) -> None:
    """Hold scipy's value with several levels, like and shifted."""
    n = COARSEST * RATIO + 17
    a, b = board(n, 1), board(n, 2) + [shift, 0.0]
    bounds = certified_wasserstein1(a, b, relative=1e-4)
    assert holds(bounds, exact(a, b))
    assert bounds.high - bounds.low <= 1e-4 * bounds.high


@pytest.mark.parametrize("kinds", [2, pytest.param(40, marks=pytest.mark.slow)])
def test_environments_that_agree(kinds: int) -> None:
    """Hold the value where environments come in few kinds: the same outcomes, many times over."""
    draw = np.random.default_rng(kinds)
    a, b = (draw.uniform(-30, 30, (kinds, 27, 2))[draw.integers(0, kinds, 100)].reshape(-1, 2) for _ in range(2))
    assert holds(certified_wasserstein1(a, b), exact(a, b))


def test_same_points_are_exactly_zero() -> None:
    """Return exactly zero for the same points in another order, and say so."""
    a = board(300, 1)
    assert certified_wasserstein1(a, a[::-1]) == Certified(0.0, 0.0, SAME_POINTS, 300, 0)
    assert certified_wasserstein1([[0.0, 1.0]], [[-0.0, 1.0]]).high == 0.0


def test_shared_points_stay() -> None:
    """Move only what differs, to full precision, however little it is."""
    a = board(300, 1)
    b = a.copy()
    b[7] += [3e-12, 4e-12]
    bounds = certified_wasserstein1(a, b)
    assert bounds.shared == 299
    assert bounds.low <= np.hypot(*(b[7] - a[7])) / 300 <= bounds.high
    assert bounds.high - bounds.low <= 1e-12 * bounds.high


def test_order_and_place_do_not_matter() -> None:
    """Return the same bits for points in another order, bounds that meet for the sets exchanged or elsewhere."""
    a, b = board(1500, 1), board(1500, 2)
    draw = np.random.default_rng(0)
    bounds = certified_wasserstein1(a, b)
    assert certified_wasserstein1(draw.permutation(a), draw.permutation(b)) == bounds
    for other in (certified_wasserstein1(b, a), certified_wasserstein1(a + [64.0, -7.0], b + [64.0, -7.0])):
        assert max(other.low, bounds.low) <= min(other.high, bounds.high)


def solution(a: np.ndarray, b: np.ndarray, limit: int = sys.maxsize) -> Solution:
    """The solver's dual and assignment at 1 %."""
    once = np.ones(len(a), dtype=np.int64)
    return solve(
        a, once, b, once, extent=60.0, enough=lambda low, high: (high - low) / (0.01 * high), limit=limit
    )  # fmt: skip


@pytest.mark.parametrize("limit", [sys.maxsize, 3000, 0])
def test_certificate_stands_alone(limit: int) -> None:
    """Find the dual feasible by brute force, and the assignment one-to-one, also where bids run out."""
    a, b = board(1500, 1), board(1500, 2) + [2.0, 1.0]
    found = solution(a, b, limit)
    assert found.bids <= limit
    distance = cdist(found.a.points, found.b.points)
    reduced = distance - found.values[:, None] + found.prices[None, :]
    assert reduced.min() >= -1e-12
    assert found.dual() <= (distance + found.prices).min(axis=1).sum() - found.prices.sum() + 1e-8
    assert np.array_equal(np.sort(found.origin), np.arange(1500))
    assert np.array_equal(np.sort(found.place), np.arange(1500))
    assert found.primal() == pytest.approx(distance[found.origin, found.place].sum(), rel=1e-12)
    assert np.array_equal(found.a.points, a[found.a.tree.order])
    assert np.array_equal(found.b.points, b[found.b.tree.order])


def test_bounds_without_work() -> None:
    """Return bounds that hold when no bid may be made, and closer ones for more work."""
    a, b = board(1500, 1), board(1500, 2) + [4.0, 0.0]
    value = exact(a, b)
    gaps = []
    for work in (0, 3000, None):
        bounds = certified_wasserstein1(a, b, relative=1e-3, max_work=work)
        assert holds(bounds, value)
        assert work is None or bounds.bids <= work
        gaps.append(bounds.high - bounds.low)
    assert gaps[0] > gaps[1] > gaps[2]


@pytest.mark.parametrize(("shift", "relative", "bids"), [(0.0, 1e-2, 25), (0.0, 1e-3, 27), (4.0, 1e-3, 39)])
def test_how_much_work_bounds_take(shift: float, relative: float, bids: int) -> None:
    """Make no more bids for each point than the schedule of ever smaller steps needs."""
    a, b = board(1500, 1), board(1500, 2) + [shift, 0.0]
    assert certified_wasserstein1(a, b, relative=relative).bids <= 1.1 * bids * len(a)


@SOME
@given(pairs(COORDINATE, 60), st.integers(0, 2**32 - 1))
def test_planes_lie_below_prices(sets: np.ndarray, seed: int) -> None:
    """Keep each node's plane below all its prices, and each point in its node's box."""
    tree = build(sets[0])
    prices = np.random.default_rng(seed).normal(size=len(tree.points))
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    assert np.array_equal(np.sort(tree.order), np.arange(len(prices)))
    for node, begin, end in zip(tree.nodes, tree.begin, tree.end, strict=True):
        away = tree.points[begin:end] - node[:2]
        assert (np.abs(away) <= node[2:4]).all()
        assert (node[6] + away @ node[4:6] <= prices[begin:end] + 1e-12).all()


@pytest.mark.parametrize(
    ("a", "b", "options", "says"),
    [
        (np.zeros((3, 2)), np.zeros((4, 2)), {}, "different size"),
        (np.zeros((3, 3)), np.zeros((3, 3)), {}, "planar"),
        (np.zeros((0, 2)), np.zeros((0, 2)), {}, "empty"),
        (np.zeros(3), np.zeros(3), {}, "2 axes"),
        ([[np.nan, 0.0]], [[0.0, 0.0]], {}, "non-finite"),
        ([[-1.7e308, 0.0]], [[1.7e308, 0.0]], {}, "overflow"),
        ([[0.0, 0.0]], [[1.7e308, 1.7e308]], {}, "overflow"),
        ([[0.0, 0.0]], [[1.0, 0.0]], {"relative": -0.1}, "negative"),
        ([[0.0, 0.0]], [[1.0, 0.0]], {"relative": np.nan}, "negative"),
        ([[0.0, 0.0]], [[1.0, 0.0]], {"max_work": -1}, "negative"),
    ],
)
def test_refusals(a: object, b: object, options: dict[str, float], says: str) -> None:
    """Refuse what has no answer, and say why."""
    with pytest.raises(ValueError, match=says):
        certified_wasserstein1(a, b, **options)


PROGRAM = """
import json, resource, sys
import numpy as np
from gpusimbench.evaluator.transport.large import certified_wasserstein1
a, b = np.load(sys.argv[1])
certified_wasserstein1(a[:2000], b[:2000])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
bounds = [certified_wasserstein1(a, b, relative=0.05) for _ in range(2)]
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps([[x.low.hex(), x.high.hex(), x.bids] for x in bounds] + [after - before]))
"""


@pytest.mark.slow
def test_one_result_and_little_memory(tmp_path) -> None:
    """Return the same bits again, with one thread and with two, and hold no matrix: 30,000 points, under 60 MiB."""
    np.save(tmp_path / "sets.npy", np.stack([board(30_000, 1), board(30_000, 2) + [4.0, 0.0]]))
    results = []
    for threads in ("1", "2"):
        done = run_python(
            PROGRAM, tmp_path / "sets.npy", env={**os.environ, "NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        )
        first, again, kib = json.loads(done.stdout)
        assert first == again
        assert kib < 60 * 1024  # the matrix would take 7,200 MB
        results.append(first)
    assert results[0] == results[1]


def test_boxes_are_those_of_their_points() -> None:
    """Give each node the box around its points and no more, each point once in a level."""
    points = np.random.default_rng(7).normal(size=(50, 2)) + 5.0
    tree = build(points)
    assert sorted(tree.order.tolist()) == list(range(50))
    assert tree.points.tolist() == points[tree.order].tolist()
    for begin, end, box in zip(tree.begin, tree.end, tree.nodes, strict=True):
        inside = tree.points[begin:end]
        low, high = inside.min(axis=0), inside.max(axis=0)
        assert box[:2] == pytest.approx((low + high) / 2)
        assert box[2:4] == pytest.approx((high - low) / 2)
    assert np.diff(np.searchsorted(tree.leaf, np.arange(tree.first, 2 * tree.first + 2))).max() <= LEAF


@pytest.mark.parametrize(("slope", "found"), [((0.3, -0.5), (0.3, -0.5)), ((-3.0, 4.0), (-0.6, 0.8))])
def test_planes_follow_prices_that_rise_evenly(slope: tuple[float, float], found: tuple[float, float]) -> None:
    """Find the slope of prices that are a plane, at most 1, and touch the lowest price with it."""
    points = np.random.default_rng(8).uniform(2.0, 3.0, size=(60, 2))
    tree = build(points)
    prices = tree.points @ np.array(slope)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    for begin, end, node in zip(tree.begin, tree.end, tree.nodes, strict=True):
        assert node[4:6] == pytest.approx(found, abs=0.02)
        below = prices[begin:end] - (node[6] + (tree.points[begin:end] - node[:2]) @ node[4:6])
        assert below.min() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.02, 1.0])
def test_planes_bound_those_above(noise: float) -> None:
    """Bound from each node the plane above it in its box, and lose no more than the two slopes part there."""
    rng = np.random.default_rng(12)
    tree = build(rng.uniform(2.0, 3.0, size=(60, 2)))
    prices = tree.points @ np.array([0.3, -0.5]) + noise * rng.normal(size=60)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    for k in range(1, len(tree.nodes)):
        own, up = tree.nodes[k], tree.nodes[(k - 1) // 2]
        inside = slice(tree.begin[k], tree.end[k])
        height = (prices[inside] - (tree.points[inside] - up[:2]) @ up[4:6]).min()
        loss = height - (own[6] + own[LIFT])
        assert -1e-12 <= loss <= 2.0 * abs(own[4:6] - up[4:6]) @ own[2:4] + 1e-12


@pytest.mark.parametrize("size", [1, 2, 5, 17, 40])
@pytest.mark.parametrize("scale", [0.05, 1.0])
def test_planes_are_least_squares(size: int, scale: float) -> None:
    """Give each node the slope that fits its prices best, with a ridge of a thousandth of the points' squares."""
    rng = np.random.default_rng(size)
    tree = build(rng.normal(size=(size, 2)) * [3.0, 0.5] + [5.0, -2.0])
    prices = 7.0 + scale * rng.normal(size=size)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    for begin, end, node in zip(tree.begin, tree.end, tree.nodes, strict=True):
        points, values = tree.points[begin:end], prices[begin:end]
        centred = points - points.mean(axis=0)
        # ridge regression, as least squares with two rows more
        ridge = np.sqrt(1e-3 * (centred**2).sum()) * np.eye(2)
        slope = np.linalg.lstsq(np.vstack([centred, ridge]), np.append(values - values.mean(), [0.0, 0.0]), rcond=None)[
            0
        ]
        assert node[4:6] == pytest.approx(slope / max(1.0, float(np.linalg.norm(slope))), abs=1e-9)


def test_planes_rise_with_their_prices() -> None:
    """Touch the lowest price of a leaf again after every rise, and stay below all prices at every node."""
    rng = np.random.default_rng(9)
    tree = build(rng.uniform(size=(64, 2)))
    prices = rng.uniform(size=64)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    before = tree.nodes[:, 6].copy()
    for j in rng.permutation(64):
        prices[j] += rng.uniform(1.0, 2.0)
        lift_planes(j, tree.points, prices, tree.begin, tree.end, tree.nodes, tree.leaf)
    for k, (begin, end, node) in enumerate(zip(tree.begin, tree.end, tree.nodes, strict=True)):
        lowest = (prices[begin:end] - (node[6] + (tree.points[begin:end] - node[:2]) @ node[4:6])).min()
        assert lowest >= -1e-12
        if k >= tree.first:
            assert lowest == pytest.approx(0.0, abs=1e-12)
    assert (tree.nodes[:, 6] > before).all()


def test_planes_of_prices_that_rise_together() -> None:
    """Raise the planes of all nodes by as much as all prices, where these are a plane and bounds lose nothing."""
    tree = build(np.random.default_rng(11).uniform(-1.0, 2.0, size=(64, 2)))
    prices = tree.points @ np.array([0.3, -0.4])
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    before = tree.nodes[:, 6].copy()
    for j in range(64):
        prices[j] += 1.5
        lift_planes(j, tree.points, prices, tree.begin, tree.end, tree.nodes, tree.leaf)
    assert tree.nodes[:, 6] == pytest.approx(before + 1.5, abs=0.02)


@pytest.mark.parametrize(("slope", "price"), [(0.0, 0.0), (0.25, 2.0), (-0.25, -1.0)])
@pytest.mark.parametrize("axis", [0, 1])
def test_bounds_along_a_line_are_exact(axis: int, slope: float, price: float) -> None:
    """Bound distance plus price by the very least of two points that lie on a line with where it is seen from."""
    points = np.zeros((2, 2))
    points[:, axis] = [1.0, 3.0]
    prices = price + slope * points[:, axis]
    tree = build(points)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    for away in (-7.0, 12.0):
        seen = np.zeros(2)
        seen[axis] = away
        least = min(abs(points[:, axis] - away) + prices)
        assert _bound(0, *seen, tree.nodes) == pytest.approx(least, abs=2e-3)
        beside = seen + 5.0
        assert _bound(0, *beside, tree.nodes) <= (np.hypot(*(points - beside).T) + prices).min() + 1e-12


def searched(tree: Tree, prices: np.ndarray, place: np.ndarray, guess: int, slack: float) -> tuple[int, float, float]:
    """What a search from a place returns: a point, its distance plus price, a bound on that of the others."""
    return search(
        *place, guess, slack, tree.points, prices, tree.begin, tree.end, tree.nodes, tree.first,
        np.empty(DEPTH, np.int32), np.empty(DEPTH),
    )  # fmt: skip


@SOME
@given(pairs(COORDINATE, 60), st.integers(-1, 59), st.sampled_from([0.0, 0.5]), st.integers(0, 2**32 - 1))
def test_a_search_finds_the_least_of_all(sets: np.ndarray, guess: int, slack: float, seed: int) -> None:
    """Find what looking at every point finds, to within the slack, and a bound that holds for all other points."""
    tree = build(sets[0])
    prices = np.random.default_rng(seed).normal(size=len(tree.points))
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    for place in sets[1][:5]:
        values = np.hypot(*(tree.points - place).T) + prices
        best, least, other = searched(tree, prices, place, min(guess, len(prices) - 1), slack)
        assert least == pytest.approx(values[best], rel=1e-12)
        assert least <= values.min() + slack + 1e-12
        assert other <= np.delete(values, best).min(initial=np.inf) + 1e-12
        assert other >= values.min() - 1e-12 or slack


def test_a_search_leaves_out_what_cannot_be_least() -> None:
    """Read no price of a point whose leaf is bounded to be worse: it may say anything."""
    points = np.random.default_rng(10).uniform(0.0, 1.0, size=(64, 2)) + np.repeat(
        [[0.0, 0.0], [100.0, 0.0]], 32, axis=0
    )
    tree = build(points)
    prices = np.zeros(64)
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    far = tree.points[:, 0] > 50
    values = np.hypot(*tree.points.T)
    prices[far] = -1000.0
    best, least, other = searched(tree, prices, np.zeros(2), -1, 0.0)
    assert (best, least) == (values.argmin(), pytest.approx(values.min()))
    assert least <= other <= np.sort(values)[1] + 1e-12
