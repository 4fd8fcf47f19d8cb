"""A scene as arrays: every moving body is a sphere, every fixed one an upper face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Body, Box, Plane, Quaternion, Scene, Sphere
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import Deviation

RATE = 300.0
"""Of the springs of contacts: square root of stiffness over reduced mass [1/s]."""

DAMPING = 0.28
"""Ratio of the same, for a coefficient of restitution of 0.4."""

GRIP = 100.0
"""Friction below the Coulomb limit, over mass and slip [1/s]."""

SWELL = 1.001
"""Radius of a box over half its shortest edge: a stack pushes itself apart, so that it does not stand for ever."""

LONGEST_STEP = 0.0025
"""[s]; a longer step is made of several."""


@dataclass(frozen=True)
class Model:
    """What the kernels need of a scene, float32.

    start, velocity, spin  of the bodies [m, m/s, rad/s], [body, 3]
    traits                 radius [m], mass [kg], inverse moment of inertia [1/(kg m2)] and friction, [body, 4]
    faces                  centre, x, y and normal axes, and (half length, half width, thickness) [m], [face, 5, 3]
    """

    start: NDArray[np.float32]
    velocity: NDArray[np.float32]
    spin: NDArray[np.float32]
    traits: NDArray[np.float32]
    faces: NDArray[np.float32]


def model_of(scene: Scene) -> Model:
    """The scene's arrays; UsageError where a sphere is fixed."""
    moving, fixed = scene.moving(), [body for body in scene.bodies if body.fixed]
    return Model(
        start=np.array([b.position for b in moving], dtype=np.float32),
        velocity=np.array([b.linear_velocity for b in moving], dtype=np.float32),
        spin=np.array([b.angular_velocity for b in moving], dtype=np.float32),
        traits=np.array([_traits(b) for b in moving], dtype=np.float32),
        faces=np.array([_face(b) for b in fixed], dtype=np.float32).reshape(-1, 5, 3),
    )


def _traits(body: Body) -> tuple[float, float, float, float]:
    assert body.mass is not None
    friction = body.material.kinetic_friction
    if isinstance(body.shape, Sphere):
        return body.shape.radius, body.mass, 2.5 / (body.mass * body.shape.radius**2), friction
    assert isinstance(body.shape, Box)
    return SWELL * min(body.shape.size) / 2, body.mass, 0.0, friction


def _face(body: Body) -> NDArray[np.float64]:
    axes = _axes(body.orientation)
    if isinstance(body.shape, Plane):
        return np.vstack([body.position, axes, (np.inf, np.inf, np.inf)])
    if not isinstance(body.shape, Box):
        raise UsageError(f"simulator 'calibration' has no fixed bodies but boxes and planes, and {body.name} is none")
    x, y, z = body.shape.size
    return np.vstack([body.position + z / 2 * axes[2], axes, (x / 2, y / 2, z)])


def _axes(orientation: Quaternion) -> NDArray[np.float64]:
    """The body's axes in the world, one a row."""
    w, x, y, z = orientation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def deviations(contacts: bool) -> tuple[Deviation, ...]:
    """What an instrument makes of the scene."""
    simple = "an instrument needs contacts that amplify, not true ones"
    found = [
        Deviation(
            "boxes.shape", "box", f"sphere of {SWELL:g} times half the shortest edge, which gets no torque", simple
        ),
        Deviation("fixed.shape", "box or plane", "its upper face; no edges, no sides", simple),
        Deviation("friction", "static and kinetic", "the moving body's kinetic one, on fixed bodies alone", simple),
        Deviation("restitution", "by material", f"springs of {RATE:g} 1/s, damped by {DAMPING:g}", simple),
        Deviation("orientation", "of all bodies", "not simulated", simple),
    ]
    if not contacts:
        found.append(Deviation("contact", "between all bodies", "with fixed bodies alone", "option 'contacts' is off"))
    return tuple(found)
