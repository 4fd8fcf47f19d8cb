"""How deep spheres and boxes are in fixed bodies and in each other; and sums over the three components of many vectors,
for numpy's own reductions are slow along so short an axis."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

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
