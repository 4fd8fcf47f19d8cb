"""MuJoCo's qpos, as tasks are recorded with it, taken apart into states of bodies and joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fields import ENV, StateField, body_field, joint_field
from gpusimbench.schemas.vector import PHYSICS

QPOS = f"{ENV}/{PHYSICS}qpos"
"""The field of a task's recording that has it, one item of as many numbers as the model has coordinates."""

_PARTS = {
    "free": (("position", 3), ("orientation", 4)),
    "hinge": (("qpos", 1),),
    "slide": (("qpos", 1),),
    "ball": (("orientation", 4),),
}


class Coordinate(NamedTuple):
    """A joint of a model, in the order of qpos.

    kind         "free", "hinge", "slide" or "ball"
    group, name  as geometry.json has them
    """

    kind: str
    group: str
    name: str


@dataclass(frozen=True)
class Coordinates:
    """Where in qpos the states of bodies and joints are.

    fields   of these states, as recordings of models have them
    columns  of qpos, [item, width], one a field
    """

    fields: tuple[StateField, ...]
    columns: tuple[NDArray[np.int64], ...]

    def states(self, qpos: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Arrays [row, item, width] by the names of fields, from qpos [row, 1, coordinate]."""
        return {
            field.name: qpos[:, 0][:, columns] for field, columns in zip(self.fields, self.columns, strict=True)
        }  # fmt: skip


def coordinates_of(order: Iterable[Coordinate], known: Mapping[str, StateField]) -> Coordinates | None:
    """How to take qpos apart; None where it was not recorded, other states were, or the model has other coordinates.

    order  of the model's joints
    known  recorded fields by name
    """
    recorded = known.get(QPOS)
    if recorded is None or any(field.group != ENV for field in known.values()):
        return None
    found: dict[tuple[str, str], list[tuple[str, range]]] = {}
    at = 0
    for kind, group, name in order:
        for part, width in _PARTS[kind]:
            found.setdefault((group, part), []).append((name, range(at, at + width)))
            at += width
    if not found or at != recorded.width:
        return None
    fields = [
        (joint_field if part == "qpos" else body_field)(group, part, recorded.dtype, tuple(name for name, _ in items))
        for (group, part), items in found.items()
    ]
    return Coordinates(tuple(fields), tuple(np.array([list(at) for _, at in items]) for items in found.values()))
