"""The view that a recording has: which messages on which topics follow from its states and its look.

Whoever writes a recording makes them, and whoever checks one makes them again. No digest covers them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import EPOCH_NS, sim_time_ns
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.view.env_view import ROOT, EnvView
from gpusimbench.schemas.view.geometry import Look
from gpusimbench.schemas.view.motion import Motion, one_of

RATE = 30.0
"""Most poses a second of simulated time [Hz]."""

METADATA = "gsb-view"
"""Name of the metadata record with the layout: an attachment would have a digest, and change the content hash."""

LOG_TOPIC = topics.view("log", 0)
LOG_TYPE = "foxglove.Log"


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
        """What things look like, once."""
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


NAME = "foxglove-layout.json"


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
