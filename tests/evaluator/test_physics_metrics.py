"""The formulas of mechanics, against brute force and against motions that obey them by construction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.physics.gravity import (
    Stretches,
    deformation,
    descent,
    foot_speed,
    impact,
    rounding,
    trend,
)
from gpusimbench.evaluator.metrics.physics.solids import (
    Displacements,
    FixedBox,
    FrictionCone,
    HalfSpace,
    Rises,
    box_distance,
    corner_depth,
    mechanical_energy,
    nearest,
    overlap,
    rotations,
    sphere_depth,
)

seeds = st.integers(0, 2**32 - 1)


def turned(seed: int, count: int = 1) -> np.ndarray:
    """Random rotations, [count, 3, 3]."""
    return rotations(np.random.default_rng(seed).normal(size=(count, 4)))


@given(
    acceleration=st.floats(-50, 50),
    speed=st.floats(-5, 5),
    dt=st.floats(1e-4, 0.1),
    lead=st.sampled_from([-1, 0, 1]),
    rows=st.integers(5, 200),
)
def test_trend_sees_through_euler(acceleration: float, speed: float, dt: float, lead: int, rows: int) -> None:
    """Recover the acceleration of either Euler method exactly, and the method from the first-order term."""
    step = np.arange(rows, dtype=np.float64)
    place = speed * dt * step + acceleration * dt**2 * (step**2 + lead * step) / 2
    fit = trend(step * dt, place)
    slack = 1e-14 * (1 + np.abs(place).max()) * fit.gain + 1e-9 * abs(acceleration)
    assert fit.acceleration == pytest.approx(acceleration, abs=float(slack))
    assert fit.lead == pytest.approx(speed + lead * acceleration * dt / 2, abs=float(slack * rows * dt) + 1e-9)


@given(seed=seeds, rows=st.integers(5, 100), dt=st.floats(1e-3, 0.02))
def test_gain_bounds_what_errors_do(seed: int, rows: int, dt: float) -> None:
    """Errors of at most e in the places change the acceleration by at most gain e."""
    error = np.random.default_rng(seed).uniform(-1.0, 1.0, rows)
    fit = trend(np.arange(rows, dtype=np.float64) * dt, error)
    assert abs(float(fit.acceleration)) <= fit.gain * (1 + 1e-9)


def test_deformation_is_what_bodies_move_against_each_other() -> None:
    """Give the largest way of a body against the mean of all, at whatever row it was; nothing where all move alike."""
    position = np.random.default_rng(1).normal(size=(6, 3, 4, 3))
    together = np.random.default_rng(2).normal(size=(6, 3, 1, 3))
    position = position[:1] + together - together[:1]
    assert deformation(position) == pytest.approx(0.0, abs=1e-12)
    position[2, 1, 3] += [0.0, 0.3, 0.4]  # of four bodies, for one row
    position[5, 2, 0] += [0.0, 0.0, 0.1]
    assert deformation(position) == pytest.approx([0.0, 0.5 * 3 / 4, 0.1 * 3 / 4], abs=1e-12)


def test_rounding_bounds_a_float32_integration() -> None:
    """Bound how far a fall in float32 strays from the same in float64."""
    dt, steps = np.float32(0.01), 200
    small = np.array([3.0, 0.0], dtype=np.float32)
    large = small.astype(np.float64)
    for _ in range(steps):
        small[1] -= np.float32(9.81) * dt
        small[0] += small[1] * dt
        large[1] -= float(np.float32(9.81)) * float(dt)
        large[0] += large[1] * float(dt)
    bound = rounding(steps, 0.01, largest_place=20.0, largest_speed=20.0, epsilon=float(np.finfo(np.float32).eps))
    assert 0 < abs(float(small[0]) - large[0]) < bound


@given(seed=seeds)
def test_rotations_are_rotations(seed: int) -> None:
    """Turn any quaternion into an orthogonal matrix of determinant one that keeps the quaternion's axis."""
    q = np.random.default_rng(seed).normal(size=4)
    matrix = rotations(q)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix @ q[1:], q[1:], atol=1e-12)


def test_no_quaternion_is_no_rotation() -> None:
    """Take four zeros as the identity instead of dividing by them."""
    np.testing.assert_array_equal(rotations(np.zeros(4)), np.eye(3))


@given(seed=seeds)
def test_box_distance_is_that_of_the_nearest_point(seed: int) -> None:
    """Agree outside with the clamped point, and inside with the nearest face."""
    draw = np.random.default_rng(seed)
    half, point = draw.uniform(0.1, 1.0, 3), draw.uniform(-2.0, 2.0, 3)
    inside = (np.abs(point) <= half).all()
    clamped = np.linalg.norm(point - np.clip(point, -half, half))
    expected = -(half - np.abs(point)).min() if inside else clamped
    assert float(box_distance(point, half)) == pytest.approx(float(expected))


@given(seed=seeds)
def test_corner_depth_is_that_of_the_deepest_corner(seed: int) -> None:
    """Agree with a loop over eight corners, in a turned box, whatever short cut was taken."""
    draw = np.random.default_rng(seed)
    solid = FixedBox(draw.normal(size=3), turned(seed)[0], draw.uniform(0.05, 1.0, 3))
    count = 20
    centre = solid.centre + draw.uniform(-1.2, 1.2, (count, 3))
    half = np.broadcast_to(draw.uniform(0.01, 0.2), (count, 3))
    turn = turned(seed + 1, count)
    found = corner_depth(solid, centre, turn, half)
    for index in range(count):
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 8)
        corners = centre[index][:, None] + turn[index] @ (signs * half[index][:, None])
        depth = -float(box_distance(solid.local(corners.T), solid.half).min())
        assert max(0.0, found[index]) == pytest.approx(max(0.0, depth), abs=1e-12)


@given(seed=seeds)
def test_a_half_space_is_a_very_large_box(seed: int) -> None:
    """Agree on boxes and balls near the middle of a face."""
    draw = np.random.default_rng(seed)
    ground = HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    slab = FixedBox(np.array([0.0, 0.0, -50.0]), np.eye(3), np.full(3, 50.0))
    centre = draw.uniform(-0.3, 0.3, (10, 3))
    half, turn = np.full((10, 3), 0.1), turned(seed, 10)
    deep = corner_depth(ground, centre, turn, half)
    np.testing.assert_allclose(np.maximum(0, deep), np.maximum(0, corner_depth(slab, centre, turn, half)), atol=1e-12)
    np.testing.assert_allclose(sphere_depth(ground, centre, 0.1), sphere_depth(slab, centre, 0.1), atol=1e-12)


@given(seed=seeds, gap=st.floats(-0.5, 0.5))
def test_overlap_is_the_way_apart(seed: int, gap: float) -> None:
    """Two equal cubes face to face overlap by what is missing between them, in any common orientation."""
    turn = turned(seed)
    half = np.full((1, 3), 1.0)
    along = turn[:, :, 0] * (2.0 + gap)
    assert float(overlap((np.zeros((1, 3)), turn, half), (along, turn, half))[0]) == pytest.approx(-gap, abs=1e-9)


@given(seed=seeds)
def test_boxes_moved_by_their_overlap_are_apart(seed: int) -> None:
    """Hold no point of one box in the other where the overlap is zero or less."""
    draw = np.random.default_rng(seed)
    first = (np.zeros((1, 3)), turned(seed), draw.uniform(0.2, 1.0, (1, 3)))
    second = (draw.uniform(-1.5, 1.5, (1, 3)), turned(seed + 1), draw.uniform(0.2, 1.0, (1, 3)))
    found = float(overlap(first, second)[0])
    points = second[0][0] + (draw.uniform(-1, 1, (400, 3)) * second[2][0]) @ second[1][0].T
    inside = (np.abs(points @ first[1][0]) < first[2][0]).all(axis=1)
    if inside.any():
        assert found > 0.0
    assert found == pytest.approx(float(overlap(second, first)[0]))


@given(seed=seeds)
def test_nearest_agrees_with_all_pairs(seed: int) -> None:
    """Agree with the distances of all pairs, far from the origin too."""
    place = np.random.default_rng(seed).uniform(-1, 1, (3, 6, 3)) + 1000.0
    closest, least = nearest(place)
    pairs = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1) + np.diag(np.full(6, np.inf))
    np.testing.assert_allclose(closest, pairs.min(axis=2), atol=1e-6)
    np.testing.assert_allclose(least, pairs.min(axis=(1, 2)), atol=1e-6)


@given(angle=st.floats(1.0, 80.0), turn=st.floats(0.0, 360.0))
def test_descent_finds_way_and_foot(angle: float, turn: float) -> None:
    """Find the angle and a tenth of a metre to the foot of a slope that descends in any direction."""
    half, yaw = math.radians(angle) / 2, math.radians(turn) / 2
    lean = np.array([math.cos(half), 0.0, math.sin(half), 0.0])
    about = np.array([math.cos(yaw), 0.0, 0.0, math.sin(yaw)])
    rotation = rotations(about) @ rotations(lean)
    slope = FixedBox(np.array([3.0, -2.0, 1.0]), rotation, np.array([0.5, 0.2, 0.05]))
    start = slope.centre + rotation @ np.array([0.4, 0.0, 0.05 + 0.02])
    way = descent(slope, start, 0.02, 9.81)
    assert way.length == pytest.approx(0.1)
    assert way.acceleration == pytest.approx(5 / 7 * 9.81 * math.sin(math.radians(angle)))
    assert way.enough == pytest.approx(2 / 7 * math.tan(math.radians(angle)))
    np.testing.assert_allclose(way.downhill, rotation[:, 0], atol=1e-9)
    speed = way.acceleration * np.array([[0.1]])
    spin = np.cross(way.normal, way.downhill) * speed / way.radius
    assert float(way.slip(speed * way.downhill, spin)[0]) == pytest.approx(0.0, abs=1e-9)
    assert float(way.slip(speed * way.downhill, -spin)[0]) == pytest.approx(2 * float(speed[0, 0]))


def test_a_ball_in_the_air_has_no_descent() -> None:
    """Find none on a level box, and none for a ball above or beside the slope."""
    slope = FixedBox(np.zeros(3), rotations(np.array([0.98, 0.0, 0.2, 0.0])), np.array([0.5, 0.2, 0.05]))
    for local in ((0.0, 0.0, 0.09), (0.0, 0.3, 0.07), (0.6, 0.0, 0.07)):
        assert descent(slope, slope.rotation @ np.array(local), 0.02, 9.81) is None
    level = FixedBox(np.zeros(3), np.eye(3), np.array([0.5, 0.2, 0.05]))
    assert descent(level, np.array([0.0, 0.0, 0.07]), 0.02, 9.81) is None


def test_foot_speed_is_carried_on() -> None:
    """Use the last row before the foot, also where a ball rolls back over it, and none where it never came near."""
    way = np.array([[0.0, 0.0, 0.0], [0.16, 0.16, 0.1], [0.3, 0.26, 0.12], [0.5, 0.2, 0.12]])
    speed = np.array([[0.0, 0.0, 0.0], [0.8, 0.8, 0.5], [2.0, 1.0, 0.5], [2.0, -1.0, 0.5]])
    found = foot_speed(way, speed, 0.25)
    assert found[0] == found[1] == pytest.approx(1.0)
    assert np.isnan(found[2])


def test_energy_of_one_body() -> None:
    """Add m v^2 / 2, I w^2 / 2 and m g z."""
    linear, angular = np.array([[[[3.0, 4.0, 0.0]]]]), np.array([[[[0.0, 0.0, 2.0]]]])
    found = mechanical_energy(
        np.array([[[5.0]]]), linear, angular, mass=np.array([2.0]), inertia=np.array([0.5]), gravity=10.0
    )
    assert float(found[0, 0]) == pytest.approx(25.0 + 1.0 + 100.0)


@given(seed=seeds, cut=st.integers(1, 19), window=st.integers(1, 25), restitution=st.floats(0.0, 1.0))
def test_rises_do_not_depend_on_how_rows_are_read(seed: int, cut: int, window: int, restitution: float) -> None:
    """Find the same in one piece and in two, and what a loop finds."""
    energy = np.random.default_rng(seed).normal(size=(20, 3))
    whole, parts = Rises(restitution, window), Rises(restitution, window)
    whole.feed(energy)
    parts.feed(energy[:cut])
    parts.feed(energy[cut:])
    np.testing.assert_array_equal(whole.above_start, parts.above_start)
    np.testing.assert_array_equal(whole.unpaid, parts.unpaid)
    unpaid = [
        energy[k + 1] - energy[k] - restitution**2 * (energy[max(0, k + 1 - window) : k + 1].max(axis=0) - energy[k])
        for k in range(19)
    ]
    np.testing.assert_allclose(whole.unpaid, np.max(unpaid, axis=0), atol=1e-12)
    np.testing.assert_allclose(whole.above_start, (energy - energy[0]).max(axis=0))


@given(restitution=st.floats(0.0, 1.0), rows=st.integers(1, 9))
def test_a_bounce_is_paid_for_and_a_kick_is_not(restitution: float, rows: int) -> None:
    """Allow e^2 of a loss to come back in a few rows, and no more, nor after the window."""
    back = restitution**2 * np.linspace(0.0, 1.0, rows + 1)
    bounce = np.concatenate([[1.0, 1.0], back, np.full(20, back[-1])])[:, None]
    fair = Rises(restitution, 10)
    fair.feed(bounce)
    assert fair.unpaid[0] <= 1e-12
    bounce[-1] += 0.5
    kicked = Rises(restitution, 10)
    kicked.feed(bounce)
    assert kicked.unpaid[0] == pytest.approx(0.5)


@given(seed=seeds, mu=st.floats(0.0, 1.5), cut=st.integers(1, 29))
def test_friction_never_leaves_its_cone(seed: int, mu: float, cut: int) -> None:
    """Hold wherever contacts push upward and rub with at most mu times that, and break beyond."""
    draw = np.random.default_rng(seed)
    up = draw.exponential(size=(30, 1))
    angle, share = draw.uniform(0, 2 * np.pi, (30, 1)), draw.uniform(0, 1, (30, 1))
    impulse = np.stack([share * mu * up * np.cos(angle), share * mu * up * np.sin(angle), up - 0.2], axis=-1)
    momentum = np.cumsum(impulse, axis=0)
    cone = FrictionCone(mu, weight=20.0, dt=0.01)
    judged = np.ones((30, 1), dtype=bool)
    cone.feed(momentum[:cut], judged[:cut])
    cone.feed(momentum[cut:], judged[cut:])
    assert cone.excess[0] <= 1e-12
    assert cone.pull[0] <= 0.0
    assert cone.rows[0] == 29
    momentum[15:, :, 0] += 1e3
    spoiled = FrictionCone(mu, weight=20.0, dt=0.01)
    spoiled.feed(momentum, judged)
    assert spoiled.excess[0] > 900
    judged[15] = False
    ignored = FrictionCone(mu, weight=20.0, dt=0.01)
    ignored.feed(momentum, judged)
    assert ignored.excess[0] <= 1e-9


@given(seed=seeds, cut=st.integers(1, 7), mu=st.floats(0.05, 1.0))
def test_a_cone_of_friction_row_by_row(seed: int, cut: int, mu: float) -> None:
    """Find the largest excess and pull between two judged rows, one by one; of an environment without any, nothing."""
    draw = np.random.default_rng(seed)
    momentum, judged = draw.normal(scale=0.3, size=(8, 4, 3)), draw.uniform(size=(8, 4)) < 0.6
    judged[:, 3] = False
    cone = FrictionCone(mu, weight=50.0, dt=0.01)
    cone.feed(momentum[:cut], judged[:cut])
    cone.feed(momentum[cut:], judged[cut:])
    for env in range(4):
        pairs = [row for row in range(1, 8) if judged[row, env] and judged[row - 1, env]]
        excess, pull = [-np.inf], [-np.inf]
        for row in pairs:
            x, y, z = momentum[row, env] - momentum[row - 1, env]
            normal = z + 50.0 * 0.01
            excess.append(np.hypot(x, y) - mu * max(normal, 0.0))
            pull.append(-normal)
        assert cone.rows[env] == len(pairs)
        assert cone.excess[env] == pytest.approx(max(excess))
        assert cone.pull[env] == pytest.approx(max(pull))


@given(seed=seeds, share=st.floats(0.0, 1.0), cut=st.integers(1, 9))
def test_any_mean_of_velocities_accounts_for_a_displacement(seed: int, share: float, cut: int) -> None:
    """Find nothing beyond zero where bodies move by a mean of two rows' velocities, and a jump where there is one."""
    draw = np.random.default_rng(seed)
    velocity = draw.normal(size=(10, 2, 3, 3))
    moved = (share * velocity[1:] + (1 - share) * velocity[:-1]) * 0.01
    position = np.concatenate([np.zeros((1, 2, 3, 3)), np.cumsum(moved, axis=0)])
    clean = Displacements(0.01)
    clean.feed(position[:cut], velocity[:cut])
    clean.feed(position[cut:], velocity[cut:])
    assert (clean.largest <= 1e-12).all()
    position[5:, 1, 2] += 10.0
    jumped = Displacements(0.01)
    jumped.feed(position, velocity)
    assert clean.largest[0] == pytest.approx(float(jumped.largest[0]))
    assert jumped.largest[1] > 9.0


@given(mu=st.floats(0.05, 1.0), hop=st.floats(-0.2, 0.2))
def test_stretches_measure_by_impulses(mu: float, hop: float) -> None:
    """Find the coefficient of a body that is pressed on harder or less, and ignore a stretch that is too short."""
    gravity, dt = 9.81, 0.01
    speed, upward = 5.0, 0.0
    stretches = Stretches(2, gravity=gravity, dt=dt)
    for row in range(10):
        stretches.feed(np.array([[speed, 0.0, upward], [1.0, 0.0, 0.0]]), np.array([row > 0, row < 3]))
        normal = gravity * dt + hop * dt
        speed, upward = speed - mu * normal, upward + hop * dt
    stretches.end()
    assert stretches.friction == [pytest.approx(mu)]


def test_impact_is_the_fastest_row() -> None:
    """Take time and speed from the row before the fall ends, and the rebound from rows behind it."""
    velocity = np.array([0.0, -1.0, -2.0, -0.5, 0.6, 0.4])[:, None]
    found = impact(np.arange(6, dtype=np.float64) * 0.1, velocity, velocity)
    assert (found.time[0], found.speed[0], found.rebound[0]) == (pytest.approx(0.2), 2.0, pytest.approx(0.3))


def test_rounding_adds_up_over_the_steps() -> None:
    """Agree with the sum, step by step, of what half a unit in the last place of place and speed comes to."""
    steps, dt, place, speed, epsilon = 1000, 0.004, 3.0, 50.0, 2.0**-23
    drift, error = 0.0, 0.0
    for _ in range(steps):
        error += epsilon / 2 * speed
        drift += epsilon / 2 * place + error * dt
    assert rounding(steps, dt, largest_place=place, largest_speed=speed, epsilon=epsilon) == pytest.approx(
        drift, rel=2e-3
    )
