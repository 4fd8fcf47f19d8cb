"""The motion of the conformance scene, held against formulas.

Where environments have origins, tolerances grow by what the precision of positions leaves there: see Trajectory.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.scene import BALL, DT, LOWER, MARBLE, N_STEP, STONE, UPPER
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.trajectory import SUBSTEPS
from gpusimbench.recorder.conformance.verdict import expect, expect_close
from gpusimbench.recorder.scenes.base import Sphere
from gpusimbench.recorder.scenes.cube_stack import EDGE
from gpusimbench.recorder.scenes.inclined_collision import SLOPE_ANGLE

_FLIERS = (STONE, MARBLE)
_CUBES = (LOWER, UPPER)

_SPEED = 1e-3  # [m/s]: float32 over N_STEP steps; a gravity of 9.80665 instead of 9.81 is found out
_LENGTH = 5e-4  # [m], beyond the integrator's own error
_UNIT = 1e-5  # of a quaternion's norm
_SPIN = 5e-3  # [rad/s]
_TURN = 0.02  # [rad/s], of a difference of two float32 quaternions over one step
_DRIFT = 1e-3  # [m]
_TILT = 0.02  # [rad]
_ROLLING = 0.03  # relative
_SETTLED = 10  # steps after which the ball rolls
_RESTING = 25  # steps after which a stack rests: contacts at a distance of exactly zero may be found a step or two late


def quaternions_are_normalised(subject: Subject) -> None:
    """Orientations are unit quaternions at every step."""
    trajectory = subject.trajectory
    for body in trajectory.scene.moving():
        norm = np.linalg.norm(trajectory.of(body.name, "orientation").astype(np.float64), axis=-1, keepdims=True)
        expect_close(norm, 1.0, atol=_UNIT, what=f"norm of the quaternion of {body.name}", unit="")


def turns_counter_clockwise(subject: Subject) -> None:
    """A free body turns by omega dt in each step, counter-clockwise about the world's omega, quaternions wxyz."""
    trajectory = subject.trajectory
    for name in _FLIERS:
        orientation = trajectory.of(name, "orientation")
        rate = turn_between(orientation[:-1], orientation[1:]) / trajectory.dt
        expect_close(
            rate, trajectory.body(name).angular_velocity, atol=_TURN, what=f"turn per step of {name}", unit="rad/s"
        )


def angular_velocity_is_in_the_world_frame(subject: Subject) -> None:
    """A tilted stone that spins about a principal axis, and a marble about any, keep omega in the world frame."""
    trajectory = subject.trajectory
    for name in _FLIERS:
        expect_close(
            trajectory.of(name, "angular_velocity"),
            trajectory.body(name).angular_velocity,
            atol=_SPIN,
            what=f"angular velocity of {name}",
            unit="rad/s",
        )


def free_flight_follows_gravity(subject: Subject) -> None:
    """v = v0 + g t; p = p0 + v0 t + g t^2 / 2, within the g dt t / 2 by which first-order integrators are off."""
    trajectory = subject.trajectory
    gravity, time = np.array(trajectory.scene.gravity), trajectory.time
    first_order = np.abs(gravity) * trajectory.dt * time / 2
    for name in _FLIERS:
        body = trajectory.body(name)
        start, speed = np.array(body.position), np.array(body.linear_velocity)
        velocity = trajectory.of(name, "linear_velocity")
        tolerance = _SPEED + trajectory.rounding / trajectory.dt  # of engines that tell velocities from positions
        expect_close(velocity, speed + gravity * time, atol=tolerance, what=f"velocity of {name}", unit="m/s")
        position = trajectory.of(name, "position").astype(np.float64)
        expected = start + speed * time + gravity * time**2 / 2
        # whatever of the difference the integrator's order explains, on either side, counts as none
        error = position - expected
        unexplained = np.sign(error) * np.maximum(np.abs(error) - first_order, 0)
        tolerance = _LENGTH + trajectory.drift
        expect_close(expected + unexplained, expected, atol=tolerance, what=f"position of {name}", unit="m")


def stack_at_rest_stays(subject: Subject) -> None:
    """Two cubes on a board are within 1 mm and 0.02 rad of where they were put, from step 25 on."""
    trajectory = subject.trajectory
    for name in _CUBES:
        expect_close(
            trajectory.of(name, "position")[_RESTING:],
            trajectory.body(name).position,
            atol=_DRIFT + trajectory.drift,
            what=f"position of {name} at rest",
            unit="m",
            first_step=_RESTING,
        )
    for name in _CUBES:
        orientation = trajectory.of(name, "orientation")
        turned = turn_between(orientation[:1], orientation[_RESTING:])
        tolerance = _TILT + 2 * trajectory.rounding / EDGE  # corners that are found half a rounding too high or low
        expect_close(turned, 0.0, atol=tolerance, what=f"turn of {name} at rest", unit="rad", first_step=_RESTING)


def ball_rolls_down_the_slope(subject: Subject) -> None:
    """A solid ball accelerates at 5/7 g sin(20 deg), downhill, and turns as fast as it rolls, within 3 %."""
    trajectory = subject.trajectory
    velocity = trajectory.of(BALL, "linear_velocity")[[_SETTLED, N_STEP]].astype(np.float64)
    before, speed = np.linalg.norm(velocity, axis=-1)[..., None]
    duration = (N_STEP - _SETTLED) * DT
    blur = SUBSTEPS * trajectory.rounding / DT  # of a contact that is found a rounding too high or low in a substep
    expect_close(
        (speed - before)[None] / duration,
        5 / 7 * -trajectory.scene.gravity[2] * math.sin(SLOPE_ANGLE),
        atol=2 * blur / duration,
        rtol=_ROLLING,
        what=f"acceleration of the ball from step {_SETTLED} on (7/5 of it would be sliding without friction)",
        unit="m/s2",
        first_step=N_STEP,
    )
    downhill = np.array([math.cos(SLOPE_ANGLE), 0.0, -math.sin(SLOPE_ANGLE)])
    direction = velocity[1:] / speed
    tolerance = _ROLLING + blur / float(speed.min())
    expect_close(direction, downhill, atol=tolerance, what="direction of the ball", unit="", first_step=N_STEP)
    shape = trajectory.body(BALL).shape
    assert isinstance(shape, Sphere)
    expect_close(
        trajectory.of(BALL, "angular_velocity")[N_STEP:],
        speed / shape.radius * np.array([0.0, 1.0, 0.0]),
        atol=(_ROLLING * float(speed.max()) + blur) / shape.radius,
        what="angular velocity of the rolling ball",
        unit="rad/s",
        first_step=N_STEP,
    )


def states_are_finite(subject: Subject) -> None:
    """No state has a number that is none."""
    trajectory = subject.trajectory
    for layout, array in zip(trajectory.description.fields, trajectory.states, strict=True):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            step, env, item, _ = bad[0]
            expect(False, f"{layout.name} of {layout.items[item]} is not finite at step {step} in env {env}")


def turn_between(before: NDArray[np.floating], after: NDArray[np.floating]) -> NDArray[np.float64]:
    """Rotation vector in the world frame [rad] from one orientation, wxyz [..., 4], to another, shape [..., 3].

    Counter-clockwise seen against its direction; of the two ways round, the shorter.
    """
    p, q = after.astype(np.float64), before * np.array([1.0, -1.0, -1.0, -1.0])
    scalar = p[..., :1] * q[..., :1] - np.sum(p[..., 1:] * q[..., 1:], axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    vector = np.where(scalar < 0, -vector, vector)
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    return np.asarray(vector * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0))
