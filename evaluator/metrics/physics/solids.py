"""Rigid bodies: how deep spheres and boxes are in fixed bodies and in each other; how energy and momentum may change
from row to row, and whether places follow from velocities."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

Array = npt.NDArray[np.float64]
_PAIRS = 1 << 15  # of bodies at a time: as many as a core's cache holds
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def square(vector: Array) -> Array:
    """Squared length, shape [...], of vectors [..., component]."""
    return np.asarray(np.einsum("...i,...i->...", vector, vector))


def length(vector: Array) -> Array:
    """Length, shape [...], of vectors [..., component]."""
    return np.sqrt(square(vector))


def largest(vector: Array) -> Array:
    """The largest component, shape [...], of vectors [..., component]."""
    found = vector[..., 0]
    for component in range(1, vector.shape[-1]):
        found = np.maximum(found, vector[..., component])
    return np.asarray(found)


@dataclass(frozen=True)
class FixedBox:
    """A box that never moves.

    centre    [m], shape [3]
    rotation  from the box's axes to the world's, shape [3, 3]
    half      half edges along its axes [m], shape [3]
    """

    centre: Array
    rotation: Array
    half: Array

    def local(self, place: Array) -> Array:
        """World coordinates [..., 3] in the box's axes [m]."""
        return np.asarray((place - self.centre) @ self.rotation)


@dataclass(frozen=True)
class HalfSpace:
    """Everything beneath a plane.

    point   on the plane [m], shape [3]
    normal  out of the solid, unit vector, shape [3]
    """

    point: Array
    normal: Array


Fixed = FixedBox | HalfSpace


def rotations(quaternion: npt.NDArray[np.floating]) -> Array:
    """Rotation matrices [..., 3, 3] of quaternions wxyz [..., 4], made unit first; of zero, the identity."""
    q = np.asarray(quaternion, dtype=np.float64)
    norm = length(q)[..., None]
    # four zeros give the identity below
    w, x, y, z = np.moveaxis(np.where(norm > 0, q / np.where(norm > 0, norm, 1.0), 0.0), -1, 0)
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0], matrix[..., 1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    matrix[..., 2, 2] = 1 - 2 * (x * x + y * y)
    matrix[..., 0, 1], matrix[..., 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    matrix[..., 0, 2], matrix[..., 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    matrix[..., 1, 2], matrix[..., 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return matrix


def sphere_depth(solid: Fixed, centre: Array, radius: float) -> Array:
    """How deep spheres are in a fixed body [m], shape [...]; negative: their distance from it.

    centre  [m], shape [..., 3]
    """
    if isinstance(solid, HalfSpace):
        return np.asarray(radius - (centre - solid.point) @ solid.normal)
    return radius - box_distance(solid.local(centre), solid.half)


def box_distance(local: Array, half: Array) -> Array:
    """Signed distance of points in a box's own axes from its surface [m]; negative inside."""
    beyond = np.abs(local) - half
    return length(np.maximum(beyond, 0.0)) + np.minimum(largest(beyond), 0.0)


def corner_depth(solid: Fixed, centre: Array, rotation: Array, half: Array) -> Array:
    """How deep the deepest corner of boxes is in a fixed body [m], shape [n]; zero or less where none is inside.

    Of a box too far away to touch it, minus infinity.

    For a half-space that is the depth of the box. In a box, corners leave out what an edge of the fixed body cuts into
    a face, so it is at most the depth.

    centre    [m], shape [n, 3]
    rotation  from the boxes' axes to the world's, shape [n, 3, 3]
    half      half edges [m], shape [n, 3]
    """
    if isinstance(solid, HalfSpace):
        reach = (np.abs(np.einsum("nij,i->nj", rotation, solid.normal)) * half).sum(axis=-1)
        return np.asarray(reach - (centre - solid.point) @ solid.normal)
    local = np.abs(solid.local(centre))
    size = length(half)
    depth = np.full(len(centre), -np.inf)
    close = largest(local - solid.half) < size
    # away from its rim a box is a half-space, as long as no other face is closer to the deepest corner
    aside = -largest(local[:, :2] - solid.half[:2]) - size
    plain = close & (aside > 0)
    reach = (np.abs(solid.rotation[:, 2] @ rotation[plain]) * half[plain]).sum(axis=-1)
    depth[plain] = solid.half[2] + reach - local[plain, 2]
    other = (close & ~plain) | (depth > np.minimum(solid.half[2], aside))
    if other.any():
        edges = rotation[other] * half[other][:, None]
        corners = solid.local(centre[other][:, None] + _CORNERS @ edges.transpose(0, 2, 1))
        depth[other] = -box_distance(corners, solid.half).min(axis=-1)
    return np.asarray(depth)


def overlap(first: tuple[Array, Array, Array], second: tuple[Array, Array, Array]) -> Array:
    """How far pairs of boxes reach into each other [m], shape [n]; zero or less where they are apart.

    The smallest overlap along any of the 15 axes that can separate two boxes: their face normals, and the products of
    an edge of one with an edge of the other (Gottschalk, Lin, Manocha, "OBBTree", 1996).

    first, second  centre [m], [n, 3]; rotation from its axes to the world's, [n, 3, 3]; half edges [m], [n, 3]
    """
    (centre_a, axes_a, half_a), (centre_b, axes_b, half_b) = first, second
    apart = centre_b - centre_a
    normals = np.concatenate([axes_a, axes_b], axis=-1)
    edges = np.cross(axes_a[..., :, None], axes_b[..., None, :], axis=1).reshape(len(apart), 3, 9)
    axes = np.concatenate([normals, edges], axis=-1)
    norm = np.linalg.norm(axes, axis=1)
    reach = sum(
        (np.abs(np.einsum("nij,nik->njk", turn, axes)) * half[..., None]).sum(axis=1)
        for turn, half in ((axes_a, half_a), (axes_b, half_b))
    )
    along = reach - np.abs(np.einsum("ni,nik->nk", apart, axes))
    usable = norm > 1e-6  # parallel edges make no axis
    return np.asarray(np.where(usable, along / np.where(usable, norm, 1.0), np.inf).min(axis=-1))


def nearest(centre: Array) -> tuple[Array, Array]:
    """Distance of each body from the nearest other one [m], shape [n, body], and the smallest of a row, shape [n].

    Infinite where there is no other.

    centre  [m], shape [n, body, 3]
    """
    closest = np.empty(centre.shape[:2])
    size = max(1, _PAIRS // max(1, centre.shape[1] ** 2))
    for begin in range(0, len(centre), size):
        closest[begin : begin + size] = _nearest(centre[begin : begin + size])
    return closest, closest.min(axis=-1, initial=np.inf)


def _nearest(centre: Array) -> Array:
    # about their mean: the square of a difference of large numbers would lose what matters
    from_mean = centre - centre.mean(axis=1, keepdims=True)
    about = square(from_mean)
    between = about[:, :, None] + about[:, None, :]
    products = from_mean @ from_mean.transpose(0, 2, 1)
    products *= 2.0
    between -= products
    index = np.arange(centre.shape[1])
    between[:, index, index] = np.inf
    # distances have no direction; along this axis numpy takes many minima at a time
    return np.asarray(np.sqrt(np.maximum(between.min(axis=1, initial=np.inf), 0.0)))


def mechanical_energy(
    height: Array, linear: Array, angular: Array, *, mass: Array, inertia: Array, gravity: float
) -> Array:
    """Sum over bodies of m v^2 / 2 + I w^2 / 2 + m g z [J], shape [row, env].

    height           of the centres [m], shape [row, env, body]
    linear, angular  velocities [m/s], [rad/s], shape [row, env, body, 3]
    mass, inertia    [kg], [kg m2], shape [body]; the inertia of a solid ball is 2/5 m r^2 and of a cube m edge^2 / 6,
                     about any axis
    """
    kinetic = square(linear) @ mass + square(angular) @ inertia
    return np.asarray(kinetic / 2.0 + gravity * (height @ mass))


class Rises:
    """Follows the energy of isolated bodies, which contacts may take, and give back in part.

    A contact that yields stores what bodies lose while it is compressed; a restitution e gives back e^2 of it.
    So a rise is paid for by what was lost shortly before:

        unpaid = E(k+1) - E(k) - e^2 (max(E(k-n+1), ..., E(k)) - E(k))

    above_start  largest E(t) - E(0) [J], shape [env]
    unpaid       largest of a row [J], shape [env]
    """

    def __init__(self, restitution: float, window: int) -> None:
        """restitution: the largest e of any pair; window: the n rows in which a loss can come back, one or more."""
        self._share, self._window = restitution**2, window
        self._start: Array | None = None
        self._before = self.above_start = self.unpaid = np.zeros(0)

    def feed(self, energy: Array) -> None:
        """The next rows [J], shape [row, env]."""
        if self._start is None:
            self._start = energy[0]
            self.above_start = np.zeros(energy.shape[1])
            self.unpaid = np.full(energy.shape[1], -np.inf)
            self._before = np.full((self._window, energy.shape[1]), -np.inf)
            self._before[-1] = energy[0]
            energy = energy[1:]
        whole = np.concatenate([self._before, energy])
        self._before = whole[-self._window :]
        if not len(energy):
            return
        self.above_start = np.maximum(self.above_start, (energy - self._start).max(axis=0))
        rows = whole[self._window - 1 : -1]
        highest = sliding_window_view(whole[:-1], self._window, axis=0).max(axis=-1)
        unpaid = energy - rows - self._share * (highest - rows)
        self.unpaid = np.maximum(self.unpaid, unpaid.max(axis=0))


class FrictionCone:
    """Follows the momentum of bodies that touch nothing but level ground, and each other.

    Contacts between the bodies cancel. What is left of a change of momentum is the impulse J of the ground,

        J = P(k+1) - P(k) + M g dt,   with  |J_xy| <= mu J_z  and  J_z >= 0

    by Coulomb's law for every contact, hence for their sum.

    excess  largest |J_xy| - mu max(J_z, 0) [N s], shape [env]
    pull    largest -J_z [N s], shape [env]
    rows    intervals that could be judged, shape [env]
    """

    def __init__(self, friction: float, weight: float, dt: float) -> None:
        """friction: the largest coefficient of any pair; weight: M g of all bodies [N]; dt: of a row [s]."""
        self._friction, self._fall = friction, weight * dt
        self._before: tuple[Array, npt.NDArray[np.bool_]] | None = None
        self.excess = self.pull = np.zeros(0)
        self.rows = np.zeros(0, dtype=np.int64)

    def feed(self, momentum: Array, judged: npt.NDArray[np.bool_]) -> None:
        """The next rows: momentum [N s], [row, env, 3], and whether only level ground is touched, [row, env]."""
        if self._before is None:
            self.excess = np.full(momentum.shape[1], -np.inf)
            self.pull = np.full(momentum.shape[1], -np.inf)
            self.rows = np.zeros(momentum.shape[1], dtype=np.int64)
        else:
            momentum = np.concatenate([self._before[0][None], momentum])
            judged = np.concatenate([self._before[1][None], judged])
        self._before = momentum[-1], judged[-1]
        impulse = np.diff(momentum, axis=0)
        up = impulse[..., 2] + self._fall
        excess = np.linalg.norm(impulse[..., :2], axis=-1) - self._friction * np.maximum(up, 0.0)
        both = judged[1:] & judged[:-1]
        self.rows = self.rows + both.sum(axis=0)
        self.excess = np.maximum(self.excess, np.where(both, excess, -np.inf).max(axis=0, initial=-np.inf))
        self.pull = np.maximum(self.pull, np.where(both, -up, -np.inf).max(axis=0, initial=-np.inf))


class Displacements:
    """Follows how far bodies moved beyond what their velocities account for.

        beyond = |x(k+1) - x(k) - (v(k) + v(k+1)) dt / 2| - |v(k+1) - v(k)| dt / 2

    A one-step method of whatever order moves a body by a mean of velocities between those of the two rows, which makes
    `beyond` zero or less. What is left is a correction of positions that no velocity tells.

    largest  [m], shape [env]
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._before: tuple[Array, Array] | None = None
        self.largest = np.zeros(0)

    def feed(self, position: Array, velocity: Array) -> None:
        """The next rows [m], [m/s], shape [row, env, body, 3]."""
        if self._before is None:
            self.largest = np.full(position.shape[1], -np.inf)
        else:
            position = np.concatenate([self._before[0][None], position])
            velocity = np.concatenate([self._before[1][None], velocity])
        self._before = position[-1], velocity[-1]
        half = self._dt / 2.0
        moved = np.diff(position, axis=0) - (velocity[1:] + velocity[:-1]) * half
        beyond = length(moved) - length(np.diff(velocity, axis=0)) * half
        self.largest = np.maximum(self.largest, beyond.max(axis=(0, 2), initial=-np.inf))
