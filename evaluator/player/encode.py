"""A clip as JSON that a page may hold: numbers packed as base64, no text that could end the element around it."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.player.clip import Clip, Track
from gpusimbench.evaluator.player.poses import Surroundings
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.view.geometry import Shape

RESOLUTION_M = 2.0**-17
"""Positions are rounded to multiples of it, 0.0076 mm, and are float32."""

RESOLUTION_QUATERNION = 1 / 32767
"""The same of the components of orientations, which are int16."""

_FAR_PERCENT = 10.0  # of positions, those furthest out, do not decide what the camera sees at first
_GROWTH, _GROWTH_ALONE = 0.08, 0.5  # how far it looks beyond what is there at first, in diagonals of that
_FAR_M = 1e5
_LONGEST = 300  # characters of a name
_SIDES = 20  # of what is round
_RINGS = 10
Faces = list[list[int]]
Points = list[list[float]]


def encode(clip: Clip) -> str:
    """The clip as JSON in ASCII, without <, > and &."""
    low, high = _bounds(clip)
    poses = _Poses()
    kinds = list(dict.fromkeys(track.items.bodies for track in clip.tracks))
    record = {
        "title": _text(clip.title),
        "whose": clip.whose,
        "numbers": clip.numbers,
        "dt": clip.dt,
        "last": clip.last_step,
        "low": low,
        "high": high,
        "fixed": [_shape(shape) for shape in clip.around.fixed],
        "ground": [_shape(shape) for shape in clip.around.ground],
        "classes": _classes(clip),
        "items": [_items(bodies, clip.around) for bodies in kinds],
        "tracks": [_track(track, kinds.index(track.items.bodies), poses) for track in clip.tracks],
        "notes": [_text(note) for note in clip.notes],
        **poses.packed(),
    }
    text = json.dumps(record, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


class _Poses:
    """Poses of all items of an environment at a step, each kept once: those of equal environments are the same."""

    def __init__(self) -> None:
        self._known: dict[bytes, int] = {}
        self._positions: list[bytes] = []
        self._orientations: list[bytes] = []

    def add(self, position: NDArray[np.float64], orientation: NDArray[np.float64]) -> int:
        """The number under which the poses are kept; positions [item, 3], orientations [item, 4]."""
        where = (np.rint(position / RESOLUTION_M) * RESOLUTION_M).astype("<f4").tobytes()
        how = _quaternions(orientation).tobytes()
        number = self._known.setdefault(where + how, len(self._known))
        if number == len(self._positions):
            self._positions.append(where)
            self._orientations.append(how)
        return number

    def packed(self) -> dict[str, str]:
        """Everything that was added, in order: float32 x, y, z and int16 w, x, y, z, little-endian."""
        return {
            "positions": base64.b64encode(b"".join(self._positions)).decode(),
            "orientations": base64.b64encode(b"".join(self._orientations)).decode(),
        }


def _quaternions(orientation: NDArray[np.float64]) -> NDArray[np.int16]:
    # not finite or of no length: no rotation; the position says whether the item is drawn at all
    length = np.linalg.norm(orientation, axis=-1, keepdims=True)
    usable = np.isfinite(length) & (length > 0)
    unit = np.where(usable, orientation / np.where(usable, length, 1.0), [1.0, 0.0, 0.0, 0.0])
    return np.asarray(np.rint(unit / RESOLUTION_QUATERNION), dtype="<i2")


def _items(bodies: tuple[tuple[str, str], ...], around: Surroundings) -> list[dict[str, Any]]:
    return [
        # what is not known to have no shape is drawn as a dot
        {"name": _text(body[1]), "shapes": [_shape(s) for s in around.bodies[body]] if body in around.bodies else None}
        for body in bodies
    ]


def _track(track: Track, kind: int, poses: _Poses) -> dict[str, Any]:
    return {
        "label": _text(track.label),
        "short": _text(track.short),
        "items": kind,
        "steps": track.steps.tolist(),
        "poses": [poses.add(p, q) for p, q in zip(track.items.position, track.items.orientation, strict=True)],
        "apart": [None if math.isnan(metres) else float(f"{metres:.4g}") for metres in track.apart],
        "furthest": track.furthest.tolist(),
    }


def _shape(shape: Shape) -> dict[str, Any]:
    record = {"kind": shape.kind, "size": shape.size, "at": shape.position, "turn": shape.orientation}
    facets = facets_of(shape)
    if facets is None:
        return record
    return {**record, "kind": "faces", "size": box_of(shape), "points": facets[0], "faces": facets[1]}


def _classes(clip: Clip) -> dict[str, Any]:
    if clip.changes is None:
        return {"reason": _text(clip.not_compared)}
    c = clip.changes
    return {
        "n": clip.n_member,
        "steps": c.steps.tolist(),
        "distinct": c.so_far.tolist(),
        "instant": c.instant.tolist(),
        "leader": c.leader.tolist(),
        "size": c.size.tolist(),
        "first": c.first_divergence,
        "splits": c.splits.tolist(),
    }


def _bounds(clip: Clip) -> tuple[list[float], list[float]]:
    """Corners of a box [m] with what stands still, what moves at first, and where most of it gets near by."""
    begin = []
    for track in clip.tracks:
        reach = np.array([_reach(clip.around.bodies.get(body, ())) for body in track.items.bodies])[:, np.newaxis]
        first = track.items.position[0]
        begin += [_finite(first - reach), _finite(first + reach)]
    still = [shape.position + np.outer((-0.5, 0.5), box_of(shape)) for shape in clip.around.fixed]
    near = np.concatenate([*begin, *still, np.zeros((0, 3))])
    if not len(near):
        near = np.zeros((1, 3))
    middle = near.mean(axis=0)
    below = [np.array([[middle[0], middle[1], shape.position[2]]]) for shape in clip.around.ground]
    near = np.clip(np.concatenate([near, *below]), -_FAR_M, _FAR_M)
    low, high = near.min(axis=0), near.max(axis=0)
    room = (_GROWTH if still else _GROWTH_ALONE) * float(np.linalg.norm(high - low))
    for track in clip.tracks:
        where = _finite(track.items.position)
        if len(where):
            lowest, highest = np.percentile(where, (_FAR_PERCENT, 100 - _FAR_PERCENT), axis=0)
            low = np.minimum(low, np.maximum(lowest, near.min(axis=0) - room))
            high = np.maximum(high, np.minimum(highest, near.max(axis=0) + room))
    return low.tolist(), high.tolist()


def _reach(shapes: Sequence[Shape]) -> float:
    """How far shapes are from their body's origin at most [m]; somewhat more where they are off it."""
    return max((math.hypot(*s.position) + _radius(s) for s in shapes), default=0.0)


def _radius(shape: Shape) -> float:
    if shape.kind == "ellipsoid":
        return max(shape.size) / 2
    return sum(shape.size) if shape.kind in ("sphere", "capsule") else math.hypot(*box_of(shape)) / 2


def _finite(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of positions [..., 3], those that are finite, shape [n, 3]."""
    return positions[np.isfinite(positions).all(axis=-1)]


def _text(text: str) -> str:
    shown = printable(text)
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]}..."


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
