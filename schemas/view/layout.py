"""A Foxglove layout: the scene at the left, events at the right."""

from __future__ import annotations

import json
from collections.abc import Sequence

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
