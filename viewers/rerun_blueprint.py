"""A blueprint with which rerun shows the view of a recording: bodies as boxes and balls, frames as axes, the log.

usage: python viewers/rerun_blueprint.py RECORDING [FILE.rbl]
       rerun RECORDING FILE.rbl

rerun reads poses and frames of a recording and, without being told, draws neither. Needs rerun-sdk (0.41 was tried).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from gpusimbench import open_recording
from gpusimbench.schemas import topics

AXIS_M = 0.03
"""Length of a frame's axes [m]."""


def blueprint_of(path: Path) -> Any:
    """A scene for each environment in the view, beside the log."""
    recording = open_recording(path)
    shapes = {solid.name: solid.shapes[0] for solid in recording.look.solids if solid.group and solid.shapes}
    scenes = []
    for env in recording.configuration.view:
        drawn: dict[str, Any] = {_entity("transforms", env): [rr.TransformAxes3D(AXIS_M)]}
        for field in recording.fields:
            found = [shapes[item] for item in field.items if item in shapes]
            kinds = {shape.kind for shape in found}
            if field.field != "position" or len(found) != len(field.items) or len(kinds) != 1:
                continue  # frames alone: an override is of one kind, and has a size for each pose
            sizes = [shape.size for shape in found]
            drawn[_entity(f"{field.group}_poses", env)] = {
                "box": lambda s=sizes: [rr.Boxes3D(half_sizes=[[edge / 2 for edge in size] for size in s])],
                "sphere": lambda s=sizes: [rr.Ellipsoids3D(half_sizes=[[size[0]] * 3 for size in s])],
            }.get(kinds.pop(), list)()
        contents = [f"/{name}" for name in drawn]
        scenes.append(rrb.Spatial3DView(origin="/", name=f"environment {env}", contents=contents, overrides=drawn))
    log = rrb.TextLogView(origin=topics.view("log", 0), name="events")
    shown = rrb.Horizontal(rrb.Grid(*scenes), log, column_shares=[3, 1])
    return rrb.Blueprint(shown, rrb.TimePanel(timeline="message_log_time"), collapse_panels=True)


def _entity(kind: str, env: int) -> str:
    return topics.view(kind, env).removeprefix("/")


def main() -> None:
    """Write the blueprint beside the recording, or where it is said."""
    path = Path(sys.argv[1])
    target = Path(sys.argv[2]) if len(sys.argv) > 2 else path.with_suffix(".rbl")
    blueprint_of(path).save(path.stem, str(target))  # rerun takes the name of the file for that of the application
    sys.stdout.write(f"{target}\n")


if __name__ == "__main__":
    main()
