"""What the outcome of a recording is: the free bodies whose positions W1 compares, and the joints.

No name of a group means anything here. The free bodies of the outcome are, in this order:

1. the groups that the scene declares, a list of names under "outcome" in scene.json;
2. where the scene names a board, the groups whose bodies all begin over its rectangle, by the positions in scene.json:
   of inclined-collision the cubes, and not the ball, which begins on the slope beside the board. Boards and first
   positions are in files of all versions, so that old files are evaluated by the same rule;
3. all groups that have positions.

What is of no recorded group, and what has no positions, is not there to be chosen. Groups without positions that have
"qpos", or orientations alone, are joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.fields import StateField

NO_BODIES = Missing('no positions of free bodies were recorded (W1 needs a group with the field "position")')


def outcome_of(recording: Recording) -> tuple[StateField, ...] | Missing:
    """Positions of the bodies that the outcome is, a field a group, or the reason why there are none.

    DamagedRecording where what the scene declares is unreadable.
    """
    fields = positional(recording.fields)
    if not fields:
        return NO_BODIES
    if declared := declared_outcome(recording):
        chosen = tuple(field for field in fields if field.group in declared)
        if not chosen:
            names = ", ".join(declared)
            return Missing(f"no positions of {names} were recorded, which the scene declares as its outcome")
        return _alike(chosen)
    over = _over_board(recording)
    return _alike(tuple(field for field in fields if field.group in over) or fields)


def declared_outcome(recording: Recording) -> tuple[str, ...]:
    """Names of the groups that scene.json declares as the outcome; empty where it declares none."""
    with damage_in(f"{recording.path}: scene.json"):
        return checks.texts(recording.scene, "outcome")


def positional(fields: Sequence[StateField]) -> tuple[StateField, ...]:
    """The fields that tell where free bodies are."""
    return tuple(field for field in fields if field.field == "position" and field.items)


def joint_fields(fields: Sequence[StateField]) -> tuple[StateField, ...]:
    """The fields that tell where joints are: "qpos" of hinges and slides, "orientation" of ball joints."""
    bodies = {field.group for field in positional(fields)}
    return tuple(
        field
        for field in fields
        if (field.field == "qpos" and field.width == 1)
        or (field.field == "orientation" and field.width == 4 and field.group not in bodies)
    )


def _alike(fields: tuple[StateField, ...]) -> tuple[StateField, ...] | Missing:
    layouts = {(field.dtype, field.frame, field.components) for field in fields}
    if len(layouts) == 1:
        return fields
    names = ", ".join(field.group for field in fields)
    return Missing(
        f"the groups {names} record positions in different frames, number types or components, which are not compared "
        'together; "outcome" in scene.json can name those that belong together'
    )


def _over_board(recording: Recording) -> frozenset[str]:
    board = board_of(recording)
    if board is None:
        return frozenset()
    (x, y, _), (length, width, _) = board.centre, board.size
    over: dict[str, bool] = {}
    with damage_in(recording.path):
        for body in checks.objects(recording.scene, "bodies"):
            group = checks.text(body, "group", default="")
            if body.get("mass") is None or not group:
                continue
            at = checks.vector(body.get("position"), 3, "a body's position")
            inside = abs(at[0] - x) <= length / 2 and abs(at[1] - y) <= width / 2
            over[group] = over.get(group, True) and inside
    return frozenset(group for group, inside in over.items() if inside)


class OutcomeArray:
    """Positions of the bodies of an outcome, all groups one behind the other, read when asked for.

    field  the first group's, whose frame and components all have
    steps  simulator step of each row
    """

    def __init__(self, recording: Recording, fields: Sequence[StateField]) -> None:
        self.field = fields[0]
        self._arrays = [recording.state(field.group, field.field) for field in fields]
        rows = min(map(len, self._arrays))
        self.steps = self._arrays[0].steps[:rows]

    def __len__(self) -> int:
        return len(self.steps)

    def at_step(self, step: int) -> NDArray[Any]:
        """As recorded at a simulator step [m], [env, item, component]; KeyError where the step was not recorded."""
        return _joined([array.at_step(step) for array in self._arrays])

    def read(self, rows: slice) -> NDArray[Any]:
        """Some rows as recorded [m], [step, env, item, component]."""
        return _joined([array.read(rows, slice(None)) for array in self._arrays])


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-2)
