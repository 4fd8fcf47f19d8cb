"""Spheres and boxes that fly, bounce, slide and roll, in numpy: damped springs between feelers and solids.

A sphere is one feeler; a box is a solid with a feeler, a small sphere, in each corner. Feelers push against the solids
of other bodies. So spheres do not meet spheres, nor edges edges.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from gpusimbench.recorder.scenes.base import Box, Plane, Scene, Sphere

FREQUENCY = 250.0  # of a contact's spring and the mass behind it [rad/s]
GRIP = 100.0  # friction up to its bound: acceleration per speed of slip [1/s]
_DEEP = 1e3  # a plane is the top of a box of this size [m]


class World:
    """n_env copies of a scene.

    position, velocity, spin  [env, body, 3], moving bodies first; velocities in the world frame
    orientation               [env, body, 4], wxyz
    contacts                  feelers that touched something in the last substep, [env]
    """

    def __init__(self, scene: Scene, n_env: int) -> None:
        bodies = [*scene.moving(), *(body for body in scene.bodies if body.fixed)]
        self.moving = len(scene.moving())
        names = ("position", "orientation", "linear_velocity", "angular_velocity")
        state = (np.array([[getattr(body, name) for body in bodies]] * n_env, dtype=float) for name in names)
        self.position, self.orientation, self.velocity, self.spin = state
        self.contacts = np.zeros(n_env, dtype=np.int64)
        self._gravity = np.array(scene.gravity)
        mass = np.array([body.mass or np.inf for body in bodies])
        self._inverse_mass = 1 / mass[:, None]
        self._inertia = np.array([_moments(body.shape, body.mass or 1.0) for body in bodies])
        feelers = [(i, *feeler) for i in range(self.moving) for feeler in _feelers(bodies[i].shape)]
        solids = [(i, *_solid(body.shape)) for i, body in enumerate(bodies) if not isinstance(body.shape, Sphere)]
        pairs = [(f, s) for f in feelers for s in solids if f[0] != s[0]]
        self._feeling, self._felt = (np.array([pair[side][0] for pair in pairs], dtype=int) for side in (0, 1))
        self._offset, self._centre, self._half = (
            np.array([pair[side][part] for pair in pairs]).reshape(-1, 3) for side, part in ((0, 1), (1, 1), (1, 2))
        )
        self._radius = np.array([f[2] for f, _ in pairs])
        i, o = self._feeling, self._felt
        self._mass = 1 / (1 / mass[i] + 1 / mass[o])
        material = [(body.material.kinetic_friction, body.material.restitution) for body in bodies]
        self._friction, bounce = (np.array(material)[i] + np.array(material)[o]).T / 2
        log = np.log(np.maximum(bounce, 1e-3))
        self._damping = -log / np.hypot(np.pi, log)  # ratio with which a mass on a spring rebounds so fast

    def step(self, dt: float, substeps: int) -> None:
        """Advance by dt [s]."""
        near = self._near(2 * dt)
        for _ in range(substeps):
            self._substep(dt / substeps, near)

    def _near(self, time: float) -> np.ndarray:
        # pairs that may meet within this time in any environment
        i, o = self._feeling, self._felt
        reach = np.linalg.norm(self._offset, axis=-1) + self._radius + np.linalg.norm(self._half, axis=-1)
        reach = reach + np.linalg.norm(self._centre, axis=-1)
        apart = np.linalg.norm(self.position[:, i] - self.position[:, o], axis=-1)
        speed = np.linalg.norm(self.velocity[:, i] - self.velocity[:, o], axis=-1)
        fall = time * np.linalg.norm(self._gravity) * time
        return np.flatnonzero((apart < reach + time * speed + fall + 0.01).any(axis=0))

    def _substep(self, h: float, near: np.ndarray) -> None:
        turned = _matrices(self.orientation)
        force, torque = self._forces(turned, near)
        free = self._inverse_mass > 0
        self.velocity += h * (force * self._inverse_mass + self._gravity * free)
        self.position += h * self.velocity
        inertia = np.einsum("ebij,bj,ebkj->ebik", turned, self._inertia, turned)
        torque -= np.cross(self.spin, np.einsum("ebij,ebj->ebi", inertia, self.spin))
        self.spin += h * free * np.linalg.solve(inertia, torque[..., None])[..., 0]
        _turn(self.orientation, h * self.spin)

    def _forces(self, turned: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        i, o, half, radius = self._feeling[near], self._felt[near], self._half[near], self._radius[near]
        point = self.position[:, i] + np.einsum("epij,pj->epi", turned[:, i], self._offset[near])
        local = np.einsum("epji,epj->epi", turned[:, o], point - self.position[:, o]) - self._centre[near]
        gap = local - np.clip(local, -half, half)
        distance = np.linalg.norm(gap, axis=-1)
        inside = half - np.abs(local)  # to each face
        out = np.sign(local) * (inside == inside.min(axis=-1, keepdims=True))
        out = np.where(distance[..., None] > 0, gap, out)
        distance = np.where(distance > 0, distance, -inside.min(axis=-1))
        normal = np.einsum("epij,epj->epi", turned[:, o], out / np.linalg.norm(out, axis=-1, keepdims=True))
        depth = radius - distance
        arm = point - normal * radius[:, None] - self.position[:, i]
        lever = arm + self.position[:, i] - self.position[:, o]
        slip = self.velocity[:, i] + np.cross(self.spin[:, i], arm)
        slip = slip - self.velocity[:, o] - np.cross(self.spin[:, o], lever)
        closing = np.einsum("epi,epi->ep", slip, normal)
        spring = FREQUENCY**2 * depth - 2 * self._damping[near] * FREQUENCY * closing
        push = np.where(depth > 0, np.maximum(self._mass[near] * spring, 0), 0)
        slip = slip - closing[..., None] * normal
        speed = np.maximum(np.linalg.norm(slip, axis=-1), 1e-12)
        rub = np.minimum(self._friction[near] * push, self._mass[near] * GRIP * speed) / speed
        pull = push[..., None] * normal - rub[..., None] * slip
        force, torque = np.zeros_like(self.position), np.zeros_like(self.position)
        for body, direction, at in ((i, pull, arm), (o, -pull, lever)):
            np.add.at(force, (slice(None), body), direction)
            np.add.at(torque, (slice(None), body), np.cross(at, direction))
        self.contacts = np.count_nonzero(push, axis=1)
        return force, torque


def _feelers(shape: Box | Sphere) -> list[tuple[np.ndarray, float]]:
    if isinstance(shape, Sphere):
        return [(np.zeros(3), shape.radius)]
    radius = min(shape.size) / 10
    return [(np.array(sign) * (np.array(shape.size) / 2 - radius), radius) for sign in product((-1, 1), repeat=3)]


def _solid(shape: Box | Plane) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, Plane):
        return np.array((0, 0, -_DEEP)), np.full(3, _DEEP)
    return np.zeros(3), np.array(shape.size) / 2


def _moments(shape: Box | Sphere | Plane, mass: float) -> np.ndarray:
    if isinstance(shape, Box):
        squares = np.array(shape.size) ** 2
        return mass / 12 * (squares.sum() - squares)
    return np.full(3, 2 / 5 * mass * shape.radius**2 if isinstance(shape, Sphere) else 1.0)


def _matrices(q: np.ndarray) -> np.ndarray:
    w, v = q[..., :1], q[..., 1:]
    columns = [e + 2 * np.cross(v, np.cross(v, e) + w * e) for e in np.eye(3)]
    return np.stack(columns, axis=-1)


def _turn(q: np.ndarray, by: np.ndarray) -> None:
    # q <- dq q, in place, dq the turn by this rotation vector in the world frame
    angle = np.linalg.norm(by, axis=-1, keepdims=True)
    w, v = q[..., :1].copy(), q[..., 1:].copy()
    cosine, axis = np.cos(angle / 2), by * np.sinc(angle / (2 * np.pi)) / 2
    q[..., :1] = cosine * w - np.sum(axis * v, axis=-1, keepdims=True)
    q[..., 1:] = cosine * v + w * axis + np.cross(axis, v)
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
