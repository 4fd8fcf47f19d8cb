"""Facts of mechanics: exact motions hold, spoiled ones break, and real recordings say what is known of them."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.runs.physics.facts import Check, Measured, PhysicsFacts, Revision
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.evaluator.runs.physics.states import MOST_ENVS, Walk, drawn_envs
from gpusimbench.recorder.scenes.base import Scene, Sphere
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.errors import DamagedRecording
from tests.evaluator.trajectories import Motion, at_rest, falling, heavier_gravity, rolling, write_motion

RECORDINGS = Path(__file__).parents[2] / "recordings"
A = 5 / 7 * 9.81 * math.sin(math.radians(20.0))


def facts_of(path: Path) -> PhysicsFacts:
    """The facts of a file."""
    return physics_of(Recording(path))


def measured(facts: PhysicsFacts, check: Check) -> Measured:
    """A check that must have been made."""
    found = facts.facts[check]
    assert isinstance(found, Measured), found
    return found


def why(facts: PhysicsFacts, check: Check) -> str:
    """Why a check was not made."""
    found = facts.facts[check]
    return found.reason


def broken(facts: PhysicsFacts) -> set[Check]:
    """The checks that any value breaks."""
    return {check for check, fact in facts.facts.items() if isinstance(fact, Measured) and fact.broken}


@pytest.fixture
def roll() -> Motion:
    """A ball that rolls by semi-implicit Euler, in two environments, to shortly before the foot."""
    return rolling(make_scene("inclined-collision"), dt=0.01, rows=46, n_env=2)


def test_exact_rolling_holds(tmp_path: Path, roll: Motion) -> None:
    """Find 5/7 g sin(20 degrees) to rounding, no slip, and a foot speed within the first-order error."""
    facts = facts_of(write_motion(tmp_path, "inclined-collision", roll))
    assert measured(facts, Check.ROLLING).mean == pytest.approx(A, rel=1e-9)
    assert measured(facts, Check.SLIP).most == pytest.approx(0.0, abs=1e-12)
    speed = measured(facts, Check.FOOT_SPEED)
    assert speed.mean == pytest.approx(math.sqrt(2 * A * 0.25) * (1 - 0.005 / 0.4568), rel=1e-3)
    assert not broken(facts)


@pytest.mark.parametrize("share", [1.0, 0.95 * 5 / 7, 3 / 5])
def test_other_accelerations_break(tmp_path: Path, share: float) -> None:
    """Break on a ball that slides, on one that is held back by 5 %, and on a hollow one."""
    motion = rolling(make_scene("inclined-collision"), dt=0.01, rows=46, share=share)
    assert Check.ROLLING in broken(facts_of(write_motion(tmp_path, "inclined-collision", motion)))


def test_a_ball_that_spins_the_wrong_way_breaks(tmp_path: Path, roll: Motion) -> None:
    """Break on slip where the angular velocity has the other sign, and on nothing else."""
    roll["angular_velocity"] *= -1.0
    assert broken(facts_of(write_motion(tmp_path, "inclined-collision", roll))) == {Check.SLIP}


def test_origins_and_float32_are_allowed_for(tmp_path: Path, roll: Motion) -> None:
    """Hold in float32 far from the origin, where coordinates have seven digits."""
    origins = ((0.0, 0.0, 0.0), (60.0, -60.0, 0.0))
    path = write_motion(tmp_path, "inclined-collision", roll, dtype="float32", origins=origins)
    facts = facts_of(path)
    assert measured(facts, Check.ROLLING).mean == pytest.approx(A, rel=1e-3)
    assert not broken(facts)


def test_displacements_allow_for_the_number_type(tmp_path: Path) -> None:
    """Hold uniform motion in float32 at 200 m, where a coordinate is known to 15 um; break on 0.2 mm."""
    motion = at_rest(make_scene("inclined-collision"), 100)
    motion["position"][:, :, 27, 2] += 1.0
    motion["position"][:, :, 27, 0] += 0.37 * 0.001 * np.arange(100)[:, None]
    motion["linear_velocity"][:, :, 27, 0] = 0.37
    far = ((200.0, -200.0, 0.0),)
    path = write_motion(tmp_path, "inclined-collision", motion, dtype="float32", origins=far, dt=0.001)
    found = measured(facts_of(path), Check.DISPLACEMENT)
    assert not found.broken
    assert (found.most or 0.0) > 9.81 * 0.001**2
    motion["position"][50:, :, 27, 1] += 2e-4
    path = write_motion(tmp_path, "inclined-collision", motion, dtype="float32", origins=far, dt=0.001)
    assert measured(facts_of(path), Check.DISPLACEMENT).broken


def test_depths_at_rest_allow_for_the_number_type(tmp_path: Path) -> None:
    """Hold a scene at rest in float32 at 200 m above the origin, though it is 10 um in the board; break on 0.3 mm."""
    far, motion = ((0.0, 0.0, 200.0),), at_rest(make_scene("inclined-collision"), 5)
    motion["position"][:, :, 1:, 2] -= 9e-6
    motion["position"][:, :, 1:10, 0] += 9e-6
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, dtype="float32", origins=far, dt=0.001))
    assert (measured(facts, Check.DEPTH_REST).most or 0.0) > 9.81 * 0.001**2
    assert not broken(facts) & {Check.DEPTH_REST, Check.PAIR_REST}
    motion["position"][:, :, 1:10, 2] -= 3e-4
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, dtype="float32", origins=far, dt=0.001))
    assert Check.DEPTH_REST in broken(facts)


def test_a_fall_in_float32_keeps_its_shape(tmp_path: Path) -> None:
    """Hold a stack that falls as one from 50 m up; from 200 m, say that rounding may part its cubes by more than 1 mm,
    which physics-1 allowed."""
    motion = falling(make_scene("free-fall"), dt=0.001, rows=400)
    low, high = (
        write_motion(tmp_path, "free-fall", motion, dtype="float32", origins=((0.0, 0.0, height),), dt=0.001)
        for height in (50.0, 200.0)
    )
    assert not measured(facts_of(low), Check.FALL_SHAPE).broken
    assert "rounded by up to 0.0038 m, more than 5%" in why(facts_of(high), Check.FALL_SHAPE)
    found = measured(physics_of(Recording(high), revision=Revision.FIRST), Check.FALL_SHAPE)
    assert (found.most or 0.0) > 9.81 * 0.001**2
    assert not found.broken


def test_gravity_is_the_scenes(tmp_path: Path) -> None:
    """Take gravity from the recording: the same motion breaks where the scene says twice as much."""
    motion = rolling(make_scene("inclined-collision"), dt=0.01, rows=46)
    path = write_motion(tmp_path, "inclined-collision", motion, change_scene=heavier_gravity)
    found = measured(facts_of(path), Check.ROLLING)
    assert found.broken
    assert found.low == pytest.approx(2 * A)


@pytest.mark.parametrize(
    ("half_steps", "lead", "said"),
    [(1, 0.5, "semi-implicit Euler"), (-1, -0.5, "explicit Euler"), (0, 0.0, "second order, or exact")],
)
def test_free_fall_tells_g_and_the_method(tmp_path: Path, half_steps: int, lead: float, said: str) -> None:
    """Find g to rounding whatever the method, and which method it was."""
    motion = falling(make_scene("free-fall"), dt=0.01, rows=60, half_steps=half_steps)
    facts = facts_of(write_motion(tmp_path, "free-fall", motion))
    assert measured(facts, Check.FALL).mean == pytest.approx(9.81, rel=1e-9)
    assert measured(facts, Check.FALL_LEAD).mean == pytest.approx(lead, abs=1e-9)
    assert measured(facts, Check.FALL_LEAD).note == said
    assert not broken(facts) & {Check.FALL, Check.FALL_LEAD, Check.FALL_SHAPE, Check.IMPACT_TIME, Check.IMPACT_SPEED}


def test_the_ground_is_where_the_scene_puts_it(tmp_path: Path) -> None:
    """Find the same fall onto ground at a height of 2 m, from as far above it."""

    def raised(scene: Scene) -> Scene:
        up = [replace(b, position=(*b.position[:2], b.position[2] + 2.0)) for b in scene.bodies]
        return replace(scene, bodies=tuple(up))

    motion = falling(make_scene("free-fall"), dt=0.01, rows=60)
    above = {**motion, "position": motion["position"] + [0.0, 0.0, 2.0]}
    low = facts_of(write_motion(tmp_path, "free-fall", motion))
    high = facts_of(write_motion(tmp_path, "free-fall", above, change_scene=raised))
    for check in (Check.FALL, Check.IMPACT_TIME, Check.IMPACT_SPEED):
        assert measured(high, check).mean == pytest.approx(measured(low, check).mean, rel=1e-9), check
        assert measured(high, check).high == pytest.approx(measured(low, check).high, rel=1e-9), check


def test_a_stack_that_falls_a_thousandth_slower_breaks(tmp_path: Path) -> None:
    """Break on g of 9.80, which no rounding of float32 explains."""
    motion = falling(make_scene("free-fall"), dt=0.01, rows=60)
    start = motion["position"][0]
    motion["position"] = start + (motion["position"] - start) * 0.999
    assert Check.FALL in broken(facts_of(write_motion(tmp_path, "free-fall", motion, dtype="float32")))


def test_a_stack_that_comes_apart_in_the_air_breaks(tmp_path: Path) -> None:
    """Break on one cube that drifts 2 mm while it falls."""
    motion = falling(make_scene("free-fall"), dt=0.01, rows=60)
    motion["position"][:, :, 3, 0] += np.linspace(0.0, 0.004, 60)[:, None]
    assert Check.FALL_SHAPE in broken(facts_of(write_motion(tmp_path, "free-fall", motion)))


def test_injected_energy_breaks(tmp_path: Path) -> None:
    """Break where a cube that lay still moves off with more energy than the scene had."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["linear_velocity"][10:, :, 5, 0] = 12.0
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert {Check.ENERGY_START, Check.ENERGY_ROW} <= broken(facts)
    assert why(facts, Check.CONE) == "no row has all bodies on level ground"
    assert measured(facts, Check.ENERGY_START).most == pytest.approx(0.5 * 0.005 * 144.0)


def test_a_kick_of_a_cube_at_rest_breaks(tmp_path: Path) -> None:
    """Break on a cube that leaves the pile at 4 m/s upward, with less energy than the scene lost long before."""
    motion = at_rest(make_scene("inclined-collision"), 120)
    motion["linear_velocity"][:10, :, 0, 0] = 3.0  # what it had, and lost
    time = 0.01 * np.arange(40)
    motion["position"][80:, :, 27, 2] += (np.cumsum(4.0 - 9.81 * time) * 0.01)[:, None]
    motion["linear_velocity"][80:, :, 27, 2] = (4.0 - 9.81 * time)[:, None]
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert not measured(facts, Check.ENERGY_START).broken
    found = measured(facts, Check.ENERGY_ROW)
    assert found.broken
    assert found.most == pytest.approx(0.5 * 0.005 * 16 + 0.005 * 9.81 * 0.04, rel=0.02)


def test_momentum_from_nowhere_breaks(tmp_path: Path) -> None:
    """Break where the ball on the board gets a push that no friction gives, and where the ground pulls."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["position"][:, :, 0] = (0.3, 0.1, 0.0375)
    motion["linear_velocity"][10:, :, 0, 1] = 0.5
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    weight = (0.17782 + 27 * 0.005) * 9.81
    found = measured(facts, Check.CONE)
    assert found.most == pytest.approx(0.17782 * 0.5 - 0.65 * weight * 0.01)
    assert {Check.CONE} <= broken(facts)
    motion["linear_velocity"][10:, :, 0] = (0.0, 0.0, -0.5)
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert measured(facts, Check.PULL).most == pytest.approx(0.17782 * 0.5 - weight * 0.01)
    assert {Check.PULL} <= broken(facts)


def test_rotation_counts_as_energy(tmp_path: Path) -> None:
    """Count m edge^2 / 6 of a cube that starts to spin."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["angular_velocity"][10:, :, 5, 2] = 400.0
    found = measured(facts_of(write_motion(tmp_path, "inclined-collision", motion)), Check.ENERGY_START)
    assert found.most == pytest.approx(0.5 * 0.005 * 0.02**2 / 6 * 400.0**2)


def test_a_cube_pushed_into_the_board_breaks(tmp_path: Path) -> None:
    """Break on 1 mm at rest, and say 1 mm; a tenth of it is what a step accounts for."""
    for depth, breaks in ((1e-3, True), (1e-4, False)):
        motion = at_rest(make_scene("inclined-collision"), 20)
        motion["position"][-1, :, 1, 2] -= depth
        facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, without=()))
        assert measured(facts, Check.DEPTH_REST).most == pytest.approx(depth)
        assert (Check.DEPTH_REST in broken(facts)) is breaks


def test_cubes_in_each_other_break(tmp_path: Path) -> None:
    """Break on cubes 2 mm in each other, measured exactly at rest and at least ever."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["position"][-1, :, 1:10, 0] += 2e-3  # the layer of the smallest x toward the next
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert measured(facts, Check.PAIR_REST).most == pytest.approx(2e-3)
    assert measured(facts, Check.PAIR_EVER).most == pytest.approx(2e-3)
    assert Check.PAIR_REST in broken(facts)


def test_no_step_excuses_a_cube_that_is_deep_in_another(tmp_path: Path) -> None:
    """Break on 1.1 mm between cubes of 20 mm at a step of 10 ms, hold 0.9 mm, and hold both by physics-1."""
    for depth, breaks in ((1.1e-3, True), (0.9e-3, False)):
        motion = at_rest(make_scene("inclined-collision"), 20)
        motion["position"][10, :, 1:10, 0] += depth  # the layer of the smallest x toward the next
        motion["position"][10, :, 27, 2] -= depth  # a cube of the lowest layer, or in the cube below it
        path = write_motion(tmp_path, "inclined-collision", motion)
        facts = facts_of(path)
        assert measured(facts, Check.PAIR_EVER).most == pytest.approx(depth)
        assert measured(facts, Check.PAIR_EVER).tolerance == pytest.approx(1e-3)
        assert (Check.PAIR_EVER in broken(facts)) is breaks
        first = physics_of(Recording(path), revision=Revision.FIRST)
        assert first.revision is Revision.FIRST
        assert Check.PAIR_EVER not in broken(first)
        assert measured(first, Check.PAIR_EVER).tolerance == pytest.approx(0.0157617, rel=1e-4)


@pytest.mark.parametrize("depth", [0.0009, 0.0011])
def test_balls_in_each_other(tmp_path: Path, depth: float) -> None:
    """Measure how deep balls are in each other, at rest and ever, and break only what is beyond the tolerance."""
    motion = at_rest(make_scene("ball-drop"), 5)
    motion["position"][:, :, 1] = motion["position"][:, :, 0] + [0.1 - depth, 0.0, 0.0]
    facts = facts_of(write_motion(tmp_path, "ball-drop", motion))
    for check in (Check.PAIR_REST, Check.PAIR_EVER):
        assert measured(facts, check).most == pytest.approx(depth)
    assert measured(facts, Check.PAIR_REST).tolerance == pytest.approx(9.81 * 0.01**2)
    assert (Check.PAIR_REST in broken(facts)) is (depth > 9.81 * 0.01**2)
    motion["linear_velocity"][-1, :, 1, 0] = 0.02
    assert measured(facts_of(write_motion(tmp_path, "ball-drop", motion)), Check.PAIR_REST).most == 0.0


def test_one_environment_with_two_balls_at_rest_is_measured(tmp_path: Path) -> None:
    """Measure the pair of one environment, though another has a single ball at rest."""
    motion = at_rest(make_scene("ball-drop"), 5, n_env=2)
    motion["position"][:, 0, 1] = motion["position"][:, 0, 0] + [0.1 - 5e-4, 0.0, 0.0]
    motion["linear_velocity"][:, 1, 1:, 0] = 0.5
    found = measured(facts_of(write_motion(tmp_path, "ball-drop", motion)), Check.PAIR_REST)
    assert found.count == 1 and found.most == pytest.approx(5e-4)


def test_a_ball_in_a_cube_at_rest(tmp_path: Path) -> None:
    """Measure a ball that rests 3 mm deep in a cube that is turned by 45 degrees."""
    scene = make_scene("inclined-collision")
    motion, radius = at_rest(scene, 5), next(b.shape.radius for b in scene.moving() if isinstance(b.shape, Sphere))
    turn = math.radians(45.0)
    motion["orientation"][:, :, 27] = [math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)]
    motion["position"][:, :, 27] = [5.0, 5.0, 1.0]
    out = np.array([math.cos(turn), math.sin(turn), 0.0])  # normal of a face
    motion["position"][:, :, 0] = motion["position"][:, :, 27] + (0.01 + radius - 0.003) * out
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert measured(facts, Check.PAIR_REST).most == pytest.approx(0.003)
    assert Check.PAIR_REST in broken(facts)


def test_what_cannot_touch_is_not_said_to_hold(tmp_path: Path) -> None:
    """Say why no depth is measured of a body without another one, of bodies that move, and without fixed bodies."""
    facts = facts_of(write_motion(tmp_path, "cube-toss", at_rest(make_scene("cube-toss"), 5)))
    assert {why(facts, check) for check in (Check.PAIR_REST, Check.PAIR_EVER)} == {"a single body moves"}
    motion = at_rest(make_scene("ball-drop"), 5)
    motion["linear_velocity"][:, :, 1:, 0] = 0.5
    facts = facts_of(write_motion(tmp_path, "ball-drop", motion))
    assert why(facts, Check.PAIR_REST) == "no two bodies of an environment are at rest at the end"

    def floating(scene: Scene) -> Scene:
        return replace(scene, bodies=scene.moving())

    path = write_motion(tmp_path, "ball-drop", at_rest(make_scene("ball-drop"), 5), change_scene=floating)
    assert why(facts_of(path), Check.DEPTH_REST) == "the scene has no fixed bodies"


def test_a_body_that_is_nowhere_is_not_said_to_be_above_the_floor(tmp_path: Path) -> None:
    """Say that it is not known whether a body sank whose last position is not finite, unless another one sank."""
    motion = at_rest(make_scene("cube-toss"), 10, n_env=2)
    motion["position"][-1, 1] = np.nan
    facts = facts_of(write_motion(tmp_path, "cube-toss", motion))
    assert Check.FINITE in broken(facts)
    assert "whether that body sank is not known" in why(facts, Check.SANK)
    motion["position"][5:, 0, 0, 2] = -1.0
    assert measured(facts_of(write_motion(tmp_path, "cube-toss", motion)), Check.SANK).broken == 1


def test_fixed_bodies_of_other_shapes_are_not_left_out(tmp_path: Path) -> None:
    """Say that a scene with a fixed ball is not checked, instead of checking it as if the ball were not there."""

    def with_ball(scene: Scene) -> Scene:
        ball = replace(scene.moving()[0], name="fixed ball", mass=None, group="")
        return replace(scene, bodies=(*scene.bodies, ball))

    path = write_motion(tmp_path, "ball-drop", at_rest(make_scene("ball-drop"), 5), change_scene=with_ball)
    assert facts_of(path).facts == Missing("fixed ball is fixed, and neither a plane nor a box")


def test_long_steps_excuse_no_depth_at_rest_and_no_energy(tmp_path: Path) -> None:
    """Limit g dt^2 = 25 mm of a step of 50 ms to 1 mm, and the energy to M g times 1 mm; hold all by physics-1."""
    motion = at_rest(make_scene("inclined-collision"), 6)
    motion["position"][-1, :, 1, 2] -= 5e-3
    path = write_motion(tmp_path, "inclined-collision", motion, dt=0.05)
    found, first = facts_of(path), physics_of(Recording(path), revision=Revision.FIRST)
    assert measured(found, Check.DEPTH_REST).tolerance == pytest.approx(1e-3)
    assert {Check.DEPTH_REST, Check.DISPLACEMENT} <= broken(found)
    weight = (0.17782 + 27 * 0.005) * 9.81
    assert measured(found, Check.ENERGY_START).tolerance == pytest.approx(weight * 1e-3)
    assert not broken(first)
    assert measured(first, Check.ENERGY_START).tolerance == pytest.approx(weight * 9.81 * 0.05**2)


def test_rounding_beyond_the_limit_is_a_reason(tmp_path: Path) -> None:
    """Judge no depth where float32 at 10 km rounds by 2 mm, more than 1 mm, which cubes of 20 mm are allowed."""
    motion, far = at_rest(make_scene("inclined-collision"), 20), ((1e4, 0.0, 0.0),)
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, dtype="float32", origins=far))
    for check in (Check.DEPTH_REST, Check.PAIR_REST, Check.DEPTH_EVER, Check.PAIR_EVER, Check.DISPLACEMENT):
        assert (
            why(facts, check) == "positions are rounded by up to 0.0024 m, more than 5% of the smallest body (0.001 m)"
        )


def test_every_check_has_a_value_or_a_reason(tmp_path: Path, roll: Motion) -> None:
    """Leave no check out, so that what could not be made can be counted."""
    assert set(facts_of(write_motion(tmp_path, "inclined-collision", roll)).facts) == set(Check)


def test_a_jump_without_velocity_breaks(tmp_path: Path) -> None:
    """Break on a cube that moves 5 mm while its velocity says that it lies still."""
    motion = at_rest(make_scene("inclined-collision"), 20)
    motion["position"][10:, :, 27, 2] += 5e-3
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert broken(facts) == {Check.DISPLACEMENT}
    assert measured(facts, Check.DISPLACEMENT).most == pytest.approx(5e-3)


def test_an_orientation_that_is_no_unit_quaternion_is_told(tmp_path: Path, roll: Motion) -> None:
    """Name the first of them, which no check of mechanics notices, in the facts and in a note of gsb-eval."""
    roll["orientation"][20, 1, 0] *= 1.01
    path = write_motion(tmp_path, "inclined-collision", roll)
    said = "orientations are not unit quaternions: the first has length 1.01 (ball at step 20, environment 1)"
    assert measured(facts_of(path), Check.FINITE).note == said
    assert said in evaluate_files([path]).results[0].notes


def test_sliding_shows_the_coefficient(tmp_path: Path) -> None:
    """Find 0.3 on a cube that slides alone, between the scene's coefficients, and break on 0.6."""
    for friction, breaks in ((0.3, False), (0.6, True)):
        scene = make_scene("inclined-collision")
        motion = at_rest(scene, 30)
        time = np.arange(30)[:, None] * 0.01
        speed = np.maximum(0.0, 1.5 - friction * 9.81 * time)
        motion["position"][:, :, 9] = (0.3, 0.2, 0.03)
        motion["position"][:, :, 9, 0] += np.cumsum(speed, axis=0) * 0.01
        motion["linear_velocity"][:, :, 9, 0] = speed
        facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
        found = measured(facts, Check.SLIDING)
        assert found.mean == pytest.approx(friction)
        assert (found.count, bool(found.broken)) == (1, breaks)


def test_what_is_not_finite_is_said_first(tmp_path: Path, roll: Motion) -> None:
    """Break on one NaN in one environment, and measure nothing else."""
    roll["linear_velocity"][20, 1, 4, 0] = np.nan
    facts = facts_of(write_motion(tmp_path, "inclined-collision", roll))
    assert broken(facts) == {Check.FINITE}
    assert measured(facts, Check.FINITE).broken == 1
    assert why(facts, Check.ROLLING) == "states are not finite"


def test_huge_numbers_overflow_nothing(tmp_path: Path, roll: Motion) -> None:
    """Call numbers whose squares are infinite a simulation that blew up."""
    roll["position"][20, 0, 4, 0] = 1e300
    assert broken(facts_of(write_motion(tmp_path, "inclined-collision", roll))) == {Check.FINITE}


def test_fields_that_are_missing_are_named(tmp_path: Path, roll: Motion) -> None:
    """Give a reason for what velocities and orientations would have told."""
    path = write_motion(tmp_path, "inclined-collision", roll, without=("orientation", "angular_velocity"))
    facts = facts_of(path)
    assert measured(facts, Check.ROLLING).mean == pytest.approx(A)
    assert why(facts, Check.SLIP) == "velocities were not recorded"
    assert why(facts, Check.DEPTH_EVER) == "orientations were not recorded"
    assert why(facts, Check.ENERGY_START) == "velocities were not recorded"


def test_sparse_states_are_named(tmp_path: Path) -> None:
    """Give a reason for what happens between rows that were not recorded."""
    motion = at_rest(make_scene("inclined-collision"), 3)
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, stride=250))
    assert why(facts, Check.ROLLING) == "fewer than 5 rows are on the slope"
    assert why(facts, Check.CONE) == "only every 250th state was recorded"
    assert measured(facts, Check.END_SPEED).most == 0.0
    assert measured(facts, Check.DEPTH_REST).most == pytest.approx(0.0, abs=1e-4)


def test_cubes_that_rock_on_the_spot_are_told(tmp_path: Path) -> None:
    """Tell of a cube that spins at the end, and leave one alone that fell off the board."""
    motion = at_rest(make_scene("inclined-collision"), 3)
    motion["position"][-1, :, 4] = (0.7, 0.0, -3.0)
    motion["linear_velocity"][-1, :, 4, 2] = -7.0
    motion["angular_velocity"][-1, :, 4, 2] = 50.0
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, stride=250))
    assert not broken(facts) & {Check.END_SPEED, Check.END_SPIN}
    motion["angular_velocity"][-1, :, 5, 1] = 2.0
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion, stride=250))
    assert broken(facts) & {Check.END_SPEED, Check.END_SPIN} == {Check.END_SPIN}
    assert measured(facts, Check.END_SPIN).most == pytest.approx(2.0)
    assert measured(facts, Check.END_SPIN).note == "1 of them spin"


def test_facts_are_small_and_can_be_pickled(tmp_path: Path, roll: Motion) -> None:
    """Come back from another process as they were, in a few kilobytes."""
    facts = facts_of(write_motion(tmp_path, "inclined-collision", roll))
    packed = pickle.dumps(facts)
    assert pickle.loads(packed) == facts
    assert len(packed) < 10_000


def test_envs_are_drawn_alike_and_from_everywhere() -> None:
    """Look at all of a small run, and at the same 64 of a large one, in four parts of it."""
    assert drawn_envs(MOST_ENVS) == ((0, MOST_ENVS - 1),)
    for n_env in (65, 100, 4096, 131072):
        ranges = drawn_envs(n_env)
        assert ranges == drawn_envs(n_env)
        envs = [env for first, last in ranges for env in range(first, last + 1)]
        assert len(set(envs)) == len(envs) == MOST_ENVS
        assert max(envs) < n_env
        parts = [n_env * k // 4 for k in range(5)]
        assert all(
            low <= first and last < high for low, (first, last), high in zip(parts[:4], ranges, parts[1:], strict=True)
        )


def test_large_runs_are_sampled(tmp_path: Path) -> None:
    """Say "sampled" of 80 environments, and find the one that broke if it is among those."""
    motion = at_rest(make_scene("inclined-collision"), 2, n_env=80)
    chosen = drawn_envs(80)[2][0]
    motion["position"][:, chosen, 1, 2] -= 2e-3
    facts = facts_of(write_motion(tmp_path, "inclined-collision", motion))
    assert (facts.exactness, facts.looked_at) == ("sampled", 64)
    assert measured(facts, Check.DEPTH_REST).broken == 1


def test_scenes_that_mechanics_knows_nothing_of_say_so(tmp_path: Path) -> None:
    """Give a reason for gravity that is not along -z."""
    motion = at_rest(make_scene("inclined-collision"), 3)
    path = write_motion(
        tmp_path, "inclined-collision", motion, change_scene=lambda s: replace(s, gravity=(1.0, 0.0, -9.81))
    )
    facts = facts_of(path)
    assert facts.facts == Missing("gravity is not along -z")


@pytest.mark.parametrize("mass", [-1.0, 1e300])
def test_scenes_that_cannot_be_are_refused(tmp_path: Path, mass: float) -> None:
    """Name the file and the number where a body's mass is that of no body."""

    def changed(scene: Scene) -> Scene:
        return replace(scene, bodies=tuple(replace(b, mass=mass) if b.name == "ball" else b for b in scene.bodies))

    motion = at_rest(make_scene("inclined-collision"), 3)
    path = write_motion(tmp_path, "inclined-collision", motion, change_scene=changed)
    with pytest.raises(DamagedRecording, match=f"{path.name}: mass is not a number"):
        facts_of(path)


def test_mujoco_keeps_to_mechanics() -> None:
    """Hold every check of the shipped float64 recording but the depths of the impact, and all by physics-1; its rolling
    is 0.6 % slow, by the give of its contacts."""
    facts = facts_of(RECORDINGS / "mujoco-xeon-r0.mcap")
    assert broken(facts) == {Check.DEPTH_EVER, Check.PAIR_EVER}
    assert not broken(physics_of(Recording(RECORDINGS / "mujoco-xeon-r0.mcap"), revision=Revision.FIRST))
    assert measured(facts, Check.ROLLING).mean == pytest.approx(0.9942 * A, rel=1e-4)
    assert measured(facts, Check.SLIP).most == pytest.approx(0.00948, rel=1e-2)


def test_newton_xpbd_loses_its_cubes() -> None:
    """Break on the cubes that went through the board of a shipped recording."""
    facts = facts_of(RECORDINGS / "h200" / "newton-xpbd-inclined-collision-n16-r0.mcap")
    assert Check.SANK in broken(facts)
    assert why(facts, Check.ROLLING) == "fewer than 5 rows are on the slope"


def test_a_robot_keeps_to_its_limits(arms: Path) -> None:
    """Hold the joint limits of a real franka run."""
    facts = facts_of(arms)
    assert not broken(facts)
    assert (measured(facts, Check.JOINT_LIMIT).most or math.inf) < 0.0


def test_a_run_without_states_says_so() -> None:
    """Give the reason where the capture phase was left out."""
    facts = facts_of(RECORDINGS / "sweeps-h100" / "warp-franka-n512-r0.mcap")
    assert "no states were recorded" in facts.facts.reason


def test_equal_environments_are_looked_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Find the same, to the last bit, as by looking at every environment, where some are equal and others are not."""
    motion = rolling(make_scene("inclined-collision"), dt=0.01, rows=46, n_env=5)
    motion["position"][20:, [1, 3], 0, 2] -= 0.05  # into the slope
    path = write_motion(tmp_path, "inclined-collision", motion)
    walk = Walk(Recording(path), ((0, 4),))
    assert walk.rows(0, 20).distinct.tolist() == [0]
    late = walk.rows(20, 46)
    assert sorted(late.distinct.tolist()) == [0, 1]
    assert late.distinct[late.which].tolist() == [0, 1, 0, 1, 0]
    found = facts_of(path)
    monkeypatch.setattr(Walk, "_hashes", None)
    assert Walk(Recording(path), ((0, 4),)).rows(20, 46).distinct.tolist() == [0, 1, 2, 3, 4]
    assert found == facts_of(path)
    assert Check.DEPTH_EVER in broken(found)
