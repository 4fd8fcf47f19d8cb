"""What any MCAP reader with any protobuf library has of a file: none of this project's readers."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.rotations import rotation

Messages = dict[str, list[tuple[int, Any]]]
"""By topic: log_time [ns] and decoded message, in order of time."""


def read(path: Path) -> tuple[Messages, Any]:
    """Messages by topic, and the summary; CRCs are checked."""
    found: Messages = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic].append((message.log_time, decoded))
        summary = reader.get_summary()
    return found, summary


def turned(q: Any, v: Any) -> Any:
    """A vector turned by a quaternion wxyz, by the matrix of it."""
    return rotation(q) @ np.array(v)


def chained(p: Any, q: Any) -> Any:
    """The Hamilton product of two quaternions wxyz."""
    a, b, c, d = p
    e, f, g, h = q
    return np.array([
        a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e,
    ])  # fmt: skip


def placed(transforms: Any) -> dict[str, tuple[Any, Any]]:
    """Position and quaternion wxyz of every frame in the root frame; KeyError where a chain does not reach it."""
    known: dict[str, tuple[Any, Any]] = {"world": (np.zeros(3), np.array([1.0, 0, 0, 0]))}
    for t in transforms.transforms:
        at, q = known[t.parent_frame_id]
        moved = turned(q, [t.translation.x, t.translation.y, t.translation.z])
        known[t.child_frame_id] = at + moved, chained(q, [t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z])
    return known


def states(found: Messages, topic: str, log_time: int, *, dt: float = 0.01) -> Any:
    """The array [env, item, width] that a topic of raw state blocks has at a time [ns]; KeyError where it has none."""
    for _, block in found[topic]:
        array = np.array(list(block.data64) or list(block.data)).reshape(
            block.steps, block.envs, block.items, block.width
        )
        for row in range(block.steps):
            if 1_000_000_000 + round((block.first_step + row * block.stride) * dt * 1e9) == log_time:
                return array[row]
    raise KeyError(log_time)
