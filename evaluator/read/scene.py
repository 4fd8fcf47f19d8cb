"""What metrics need of a recording's scene: the board, and everything horizontal that holds bodies up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.lost_cubes import Board, Support
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, damage_in
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.trial_units import Extent, extent_of, reach_of

Array = npt.NDArray[np.float64]

_LEVEL = (1.0, 0.0, 0.0, 0.0)
_FAR_M = 1e6


def board_of(recording: Recording) -> Board | None:
    """The board that the recording's scene names, None where it names none; DamagedRecording where it is unreadable."""
    scene = recording.scene
    name = scene.get("board")
    if not name:
        return None
    with damage_in(recording.path):
        for body in checks.objects(scene, "bodies"):
            if body.get("name") == name:
                size = checks.vector(checks.mapping(body, "shape").get("size"), 3, "the board's size")
                centre = checks.vector(body.get("position"), 3, "the board's position")
                return Board(size, centre)
    raise DamagedRecording(f"{recording.path}: the scene has no body named {name!r}")


def supports_of(recording: Recording) -> tuple[Support, ...]:
    """Ground planes and level boxes among the scene's fixed bodies, and the floors of a model file; DamagedRecording
    where one is unreadable.

    What is inclined holds bodies up as well, but has no one height; nothing is said of it.
    """
    with damage_in(recording.path):
        bodies = [b for b in checks.objects(recording.scene, "bodies") if b.get("mass") is None]
        floors = [
            _ground(checks.number(floor, "height", -_FAR_M, _FAR_M))
            for floor in checks.objects(recording.geometry or {}, "floors")
        ]
        return tuple(floors + [support for body in bodies if (support := _support(body))])


def radii_of(recording: Recording, field: StateField) -> Array:
    """How far each body of a field of positions reaches from its centre, or a model's free body, with what hangs on it,
    from its origin [m], shape [item]; 0 where its shape is not known. DamagedRecording where one is unreadable."""
    found: dict[str, float] = {}
    reach = 0.0
    with damage_in(recording.path):
        for body in checks.objects(recording.scene, "bodies"):
            if body.get("group") == field.group:
                found[checks.text(body, "name")] = reach_of(checks.mapping(body, "shape"), most=_FAR_M)
        for floor in checks.objects(recording.geometry or {}, "floors"):
            reach = max(reach, checks.number(floor, "reach", 0.0, _FAR_M))
            reaches = checks.mapping(floor, "reaches")
            found.update({name: checks.number(reaches, name, 0.0, _FAR_M) for name in reaches})
    return np.array([found.get(name, reach) for name in field.items])


def extent_of_trials(recording: Recording, group: str) -> Extent | None:
    """Where the bodies of a group should come to lie; DamagedRecording where the scene is unreadable."""
    with damage_in(recording.path):
        return extent_of(recording.scene, group)


def _ground(height: float) -> Support:
    return Support(height, (-math.inf, -math.inf), (math.inf, math.inf))


def _support(body: dict[str, Any]) -> Support | None:
    shape = checks.mapping(body, "shape")
    if shape.get("kind") not in ("box", "plane"):
        return None
    if checks.vector(body.get("orientation", list(_LEVEL)), 4, "a body's orientation") != _LEVEL:
        return None
    x, y, z = checks.vector(body.get("position"), 3, "a body's position")
    if shape["kind"] == "plane":
        return _ground(z)
    length, width, height = checks.vector(shape.get("size"), 3, "a box's size")
    return Support(z + height / 2, (x - length / 2, y - width / 2), (x + length / 2, y + width / 2))
