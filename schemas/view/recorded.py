"""The view that a recording has: which messages on which topics follow from its states and its look.

Whoever writes a recording makes them, and whoever checks one makes them again. No digest covers them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import EPOCH_NS, sim_time_ns
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.view import foxglove
from gpusimbench.schemas.view.geometry import IDENTITY, Look, Solid
from gpusimbench.schemas.view.kinematics import ROBOT, Vector
from gpusimbench.schemas.view.motion import Frame, Motion, one_of

ROOT = "world"

_FIXED: tuple[foxglove.Colour, ...] = ((0.55, 0.55, 0.58),)
_BODY: tuple[foxglove.Colour, ...] = ((0.84, 0.65, 0.38), (0.70, 0.50, 0.27))  # neighbours differ
_LINK: tuple[foxglove.Colour, ...] = ((0.92, 0.92, 0.92), (0.75, 0.77, 0.80))

RATE = 30.0
"""Most poses a second of simulated time [Hz]."""

METADATA = "gsb-view"
"""Name of the metadata record with the layout: an attachment would have a digest, and change the content hash."""

LOG_TOPIC = topics.view("log", 0)
LOG_TYPE = "foxglove.Log"

NAME = "foxglove-layout.json"


class EnvView:
    """An environment, drawn in a frame of its own.

    number  of the environment
    place   where it stands in the root frame [m]
    motion  of what moves in it
    solids  that are drawn
    """

    def __init__(self, number: int, place: Vector, motion: Motion, solids: Sequence[Solid]) -> None:
        self.number = number
        self.place = place
        self.motion = motion
        self.solids = tuple(solids)
        # links have no poses of their own, since they are relative to each other
        self.groups = tuple(dict.fromkeys(part.group for part in motion.parts if part.group != ROBOT))
        frames = [f"{self.name}/{name}" for name in _distinct(part.name for part in motion.parts)]
        self._frames = {(p.group, p.name): frame for p, frame in zip(motion.parts, frames, strict=True)}
        self._by_name = {p.name: frame for p, frame in zip(motion.parts, frames, strict=True)}
        parents = [self.name if part.parent is None else frames[part.parent] for part in motion.parts]
        self._names = list(zip(parents, frames, strict=True))

    @property
    def name(self) -> str:
        """The name of its frame, and the beginning of the names of others."""
        return f"env{self.number}"

    def entities(self) -> list[Any]:
        """What things look like, as SceneEntity; who moves takes its shapes along."""
        made = []
        names = _distinct(solid.name for solid in self.solids)  # of two entities of one name, viewers draw the second
        for index, (solid, name) in enumerate(zip(self.solids, names, strict=True)):
            frame = self._frame_of(solid)
            if not solid.shapes or frame is None:
                continue
            tones = _FIXED if not solid.group else _LINK if solid.group == ROBOT else _BODY
            colour = tones[index % len(tones)]
            made.append(foxglove.entity(EPOCH_NS, frame, f"{self.name}/{name}", solid.shapes, colour))
        return made

    def _frame_of(self, solid: Solid) -> str | None:
        # a program that logs its states may call a group otherwise than its scene does
        if not solid.group:
            return self.name
        return self._frames.get((solid.group, solid.name), self._by_name.get(solid.name))

    def transforms(self, frames: Sequence[Frame], row: int, time_ns: int) -> list[Any]:
        """Where its frame and those of everything that moves in it are at a time [ns], as FrameTransform."""
        return [
            foxglove.transform(time_ns, ROOT, self.name, self.place, IDENTITY),
            *(
                foxglove.transform(time_ns, *names, frame.position[row].tolist(), frame.orientation[row].tolist())
                for names, frame in zip(self._names, frames, strict=True)
            ),
        ]

    def poses(self, frames: Sequence[Frame], row: int, time_ns: int) -> dict[str, Any]:
        """Poses of the bodies of each group in the environment's frame, as PosesInFrame."""
        return {
            group: foxglove.poses(
                time_ns,
                self.name,
                (
                    foxglove.pose(frame.position[row].tolist(), frame.orientation[row].tolist())
                    for frame in frames
                    if frame.part.group == group
                ),
            )
            for group in self.groups
        }


def _distinct(names: Iterable[str]) -> Iterator[str]:
    """Names for viewers, none empty and none twice: who would have another's gets a number."""
    taken = set()
    for number, name in enumerate(names):
        shown = printable(name)
        while not shown or shown in taken:
            shown += f"#{number}"
        taken.add(shown)
        yield shown


class ViewMessage(NamedTuple):
    """A message of a view, and its log_time [ns]."""

    topic: str
    log_time: int
    message: Any


class RecordedView:
    """One environment's part of the view.

    env      its number
    types    message type by topic
    one_of   of so many recorded rows one is shown, the first of them

    DamagedRecording where fields or look are not of the format, or hold nothing to show.
    """

    def __init__(
        self,
        env: int,
        *,
        fields: Sequence[StateField],
        look: Look,
        env_origins: Sequence[Sequence[float]],
        dt: float,
        stride: int,
    ) -> None:
        origin = tuple(env_origins[env]) if env_origins else (0.0, 0.0, 0.0)
        motion = Motion(fields, look, origin=origin)
        if not motion.parts:
            raise DamagedRecording("the states are of no bodies or joints that could be shown")
        if any(field.group == topics.VIEW for field in fields):
            raise DamagedRecording(f"the group {topics.VIEW!r} of states has the name that topics of views begin with")
        self.env = env
        self.one_of = one_of(RATE, dt=dt, stride=stride)
        self._shown = EnvView(env, origin, motion, look.solids)
        self._dt, self._stride = dt, stride
        self._scene, self._transforms = topics.view("scene", env), topics.view("transforms", env)
        self._poses = {group: topics.view(f"{group}_poses", env) for group in self._shown.groups}
        self.types = {
            self._scene: "foxglove.SceneUpdate",
            self._transforms: "foxglove.FrameTransforms",
            **dict.fromkeys(self._poses.values(), "foxglove.PosesInFrame"),
        }

    @property
    def fields(self) -> tuple[StateField, ...]:
        """Whose states are needed, in this order."""
        return self._shown.motion.fields

    def scene(self) -> ViewMessage:
        """The message with the shapes and colours of all bodies."""
        update = message_class("foxglove.SceneUpdate")(entities=self._shown.entities())
        return ViewMessage(self._scene, EPOCH_NS, update)

    def rows(self, rows: Sequence[int], states: Sequence[NDArray[np.floating]]) -> Iterator[ViewMessage]:
        """Where everything is at some rows of the recording, from an array [row, item, width] of each of `fields`."""
        frames = self._shown.motion.frames(states)
        for at, row in enumerate(rows):
            time = EPOCH_NS + sim_time_ns(row * self._stride, self._dt)
            transforms = message_class("foxglove.FrameTransforms")()
            transforms.transforms.extend(self._shown.transforms(frames, at, time))
            yield ViewMessage(self._transforms, time, transforms)
            for group, poses in self._shown.poses(frames, at, time).items():
                yield ViewMessage(self._poses[group], time, poses)


def layout_of(views: Sequence[RecordedView]) -> str:
    """The Foxglove layout of a recording, JSON."""
    by_type: dict[str, list[str]] = {}
    for view in views:
        for topic, kind in view.types.items():
            by_type.setdefault(kind, []).append(topic)
    return layout(
        scenes=by_type["foxglove.SceneUpdate"], log=LOG_TOPIC, poses=by_type.get("foxglove.PosesInFrame", ()), root=ROOT
    )


def layout(*, scenes: Sequence[str], log: str, poses: Sequence[str], root: str) -> str:
    """The layout as JSON.

    scenes, log, poses  topics; poses are there, and hidden
    root                the frame that the camera stays with
    """
    topics = {**dict.fromkeys(scenes, {"visible": True}), **dict.fromkeys(poses, {"visible": False})}
    camera = {
        "perspective": True, "distance": 1.5, "phi": 60, "thetaOffset": 45, "targetOffset": [0.0, 0.0, 0.0],
        "target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.01, "far": 1000,
    }  # fmt: skip
    grid = {"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "size": 10}
    return (
        json.dumps(
            {
                "configById": {
                    "3D!scene": {
                        "cameraState": camera, "followMode": "follow-none", "followTf": root,
                        "scene": {"transforms": {"showLabel": False, "axisScale": 0}}, "topics": topics,
                        "layers": {"grid": {**grid, "frameId": root, "divisions": 10}},
                    },
                    "RosOut!events": {"topicToRender": log, "minLogLevel": 1, "searchTerms": []},
                },
                "globalVariables": {},
                "userNodes": {},
                "playbackConfig": {"speed": 1},
                "layout": {"first": "3D!scene", "second": "RosOut!events", "direction": "row", "splitPercentage": 75},
            },
            indent=1,
        )
        + "\n"
    )  # fmt: skip
