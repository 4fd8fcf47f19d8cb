"""Where a link is in its parent's frame, by the values of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.view.rotation import about, product, rotate, unit

Vector = tuple[float, ...]

Key = tuple[str, str]
"""Group and name of a body or link."""

Placed = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Positions [row, 3] [m] and orientations [row, 4] wxyz."""

ROBOT = "robot"
"""Group of links: of the robot of a scene, and of every body of a model that is not free."""


@dataclass(frozen=True)
class Joint:
    """A hinge, a slide or a ball joint.

    kind         "hinge", "slide" or "ball"
    group, name  that its values are recorded under: of a ball joint orientations, of others qpos
    axis         unit vector in the link's frame; of a ball joint without meaning
    anchor       in the link's frame [m]; the link turns about it
    reference    value at which the link is where it is described [rad or m]
    """

    kind: str
    group: str
    name: str
    axis: Vector = (0.0, 0.0, 1.0)
    anchor: Vector = (0.0, 0.0, 0.0)
    reference: float = 0.0

    @property
    def field(self) -> str:
        """Name of the state field with its values."""
        return f"{self.group}/{'orientation' if self.kind == 'ball' else 'qpos'}"


@dataclass(frozen=True)
class Link:
    """How a link hangs on another.

    parent       that it hangs on; None for the env's frame
    position     in the parent's frame, at the joints' references [m]
    orientation  the same, wxyz
    joints       in order: each moves the link in the frame that those before it lead to
    """

    name: str
    parent: Key | None
    position: Vector
    orientation: Vector
    joints: tuple[Joint, ...] = ()

    def placed(self, values: Sequence[NDArray[np.float64]], n_row: int) -> Placed:
        """Its pose in the parent's frame at n_row rows.

        values  of each joint: [row, 1], of a ball joint [row, 4]
        """
        position: NDArray[np.float64] = np.broadcast_to(np.array(self.position), (n_row, 3))
        orientation: NDArray[np.float64] = np.broadcast_to(np.array(self.orientation), (n_row, 4))
        for joint, value in zip(self.joints, values, strict=True):
            if joint.kind == "slide":
                position = position + rotate(orientation, np.array(joint.axis)) * (value - joint.reference)
                continue
            turn = unit(value) if joint.kind == "ball" else about(joint.axis, value[:, 0] - joint.reference)
            turned = product(orientation, turn)
            if any(joint.anchor):
                anchor = np.array(joint.anchor)
                position = position + rotate(orientation, anchor) - rotate(turned, anchor)
            orientation = turned
        return position, orientation
