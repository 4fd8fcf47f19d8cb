"""Surfaces of the shapes that the page draws by their faces."""

from __future__ import annotations

import math

from gpusimbench.schemas.view.shapes import Shape

_SIDES = 20  # of what is round
_RINGS = 10

Faces = list[list[int]]
Points = list[list[float]]


def facets_of(shape: Shape) -> tuple[Points, Faces] | None:
    """Points [m] and faces, each as the numbers of its points, counter-clockwise as seen from outside; None for a shape
    that the page draws by its size."""
    if shape.mesh is not None:
        digits = 4 - math.floor(math.log10(max(shape.size) or 1.0))
        return shape.mesh.points.round(digits).tolist(), shape.mesh.triangles.tolist()
    if shape.kind == "cylinder":
        radius, length = shape.size
        return _turned([(radius, -length / 2), (radius, length / 2)], (1.0, 1.0))
    if shape.kind == "ellipsoid":
        x, y, z = (edge / 2 for edge in shape.size)
        rings = [(ring + 0.5) * math.pi / _RINGS for ring in range(_RINGS)]
        return _turned([(math.sin(angle), -z * math.cos(angle)) for angle in rings], (x, y))
    return None


def box_of(shape: Shape) -> list[float]:
    """Edges of a box about a shape, along its own axes [m]."""
    if shape.kind == "sphere":
        return [2 * shape.size[0]] * 3
    if shape.kind in ("capsule", "cylinder"):
        radius, length = shape.size
        return [2 * radius, 2 * radius, length + (2 * radius if shape.kind == "capsule" else 0)]
    return list(shape.size)


def _turned(outline: list[tuple[float, float]], stretch: tuple[float, float]) -> tuple[Points, Faces]:
    # a surface around z: radii and heights upward, with an end at the bottom and at the top
    angles = [side * 2 * math.pi / _SIDES for side in range(_SIDES)]
    points = [
        [stretch[0] * radius * math.cos(angle), stretch[1] * radius * math.sin(angle), height]
        for radius, height in outline
        for angle in angles
    ]
    faces = [list(range(_SIDES))[::-1], [len(points) - _SIDES + side for side in range(_SIDES)]]
    for begin in range(0, len(points) - _SIDES, _SIDES):
        for side in range(_SIDES):
            on = (side + 1) % _SIDES
            faces.append([begin + side, begin + on, begin + _SIDES + on, begin + _SIDES + side])
    return points, faces
