"""The law of the scene dice-drop: every face comes to lie on top equally often."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import ending_of
from gpusimbench.evaluator.runs.physics.facts import LawCounts
from gpusimbench.evaluator.runs.physics.world import world_of

Array = npt.NDArray[np.float64]

_FLAT = 0.996  # cosine of 5 degrees, within which a face points up
_STILL = 0.01  # speed of a die at rest, and of its corners [m/s]


def dice_laws(recording: Recording) -> tuple[LawCounts, ...] | Missing:
    """The law, of the dice of all environments, or why it cannot be measured."""
    if not recording.configuration.initial.startswith("random:"):
        return Missing("dice begin alike in all environments: record them with --initial random:SPREAD")
    return counted(recording)


def counted(recording: Recording) -> tuple[LawCounts, ...] | Missing:
    """The law of dice that began with drawn orientations, or why it cannot be measured."""
    read = ending_of(recording)
    if isinstance(read, Missing):
        return read
    walk, states = read
    world = world_of(recording, walk.items)
    if isinstance(world, Missing):
        return world
    if states.orientation is None or states.linear is None or states.angular is None:
        return Missing("orientations and velocities of the dice were not all recorded")
    reach = np.array([die.reach for die in world.moving])
    still = np.linalg.norm(states.linear[-1], axis=-1) < _STILL
    still &= np.linalg.norm(states.angular[-1], axis=-1) * reach < _STILL
    face, flat = faces(states.orientation[-1])
    counts = np.bincount(face[still & flat], minlength=6)
    return (
        LawCounts(
            "faces", "faces on top, chi-squared", tuple(map(int, counts)), face.size,
            "the other dice were moving or lay on no face",
        ),
    )  # fmt: skip


def faces(orientation: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Which face of each cube is on top, 0 to 5 for +x, +y, +z, -x, -y and -z of its axes, and whether it is level.

    orientation  quaternions wxyz, shape [..., 4]
    """
    up = rotations(orientation)[..., 2, :]  # height of the end of each axis
    both = np.concatenate([up, -up], axis=-1)
    return both.argmax(axis=-1), np.asarray(both.max(axis=-1) > _FLAT)
