"""A file for viewers alone: frames, shapes and events of some environments, in Foxglove's message types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.configuration import EPOCH_NS
from gpusimbench.schemas.mcap.writer import McapWriter
from gpusimbench.schemas.messages import embedded_schema, message_class
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.view.env_view import ROOT, EnvView
from gpusimbench.schemas.view.foxglove import event_line, status_line
from gpusimbench.schemas.view.layout import NAME, layout
from gpusimbench.schemas.view.motion import Frame

_SCENE, _TRANSFORMS, _LOG = "/scene", "/tf", "/log"

Shown = tuple[EnvView, Sequence[Frame]]
"""An environment, and how what is in it moves."""


class ViewWriter:
    """Writes messages of Foxglove, each type and topic declared at its first use."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def scene(self, envs: Sequence[EnvView]) -> None:
        """What things look like, once."""
        entities = [entity for env in envs for entity in env.entities()]
        update = message_class("foxglove.SceneUpdate")(entities=entities)
        self._write(_SCENE, "foxglove.SceneUpdate", update, EPOCH_NS)

    def events(self, recording: Recording) -> None:
        """All at the begin: they happened in wall time, of which simulated time knows nothing."""
        lines = [event_line(event.kind, event.phase, event.text, event.unix_ns) for event in recording.events]
        last = recording.events[-1].unix_ns if recording.events else EPOCH_NS
        lines.append(status_line(recording.status, recording.reason, last, good=recording.usable))
        for line in lines:
            self._write(_LOG, "foxglove.Log", line, EPOCH_NS)

    def row(self, shown: Sequence[Shown], row: int, time: int) -> None:
        """Where everything is at a time [ns]."""
        transforms = message_class("foxglove.FrameTransforms")()
        for env, frames in shown:
            transforms.transforms.extend(env.transforms(frames, row, time))
        self._write(_TRANSFORMS, "foxglove.FrameTransforms", transforms, time)
        for env, frames in shown:
            for group, poses in env.poses(frames, row, time).items():
                self._write(_poses(env, group), "foxglove.PosesInFrame", poses, time)

    def about(self, recording: Recording, envs: Sequence[EnvView]) -> str:
        """Where the view comes from, and how Foxglove is to show it; returns the layout."""
        self._writer.metadata(
            "gsb-view",
            {
                "run_id": printable(recording.provenance.run_id),
                "content_hash": recording.content_hash,
                "environments": ",".join(str(env.number) for env in envs),
            },
        )
        poses = [_poses(env, group) for env in envs for group in env.groups]
        text = layout(scenes=[_SCENE], log=_LOG, poses=poses, root=ROOT)
        self._writer.attachment(NAME, "application/json", text.encode(), log_time=EPOCH_NS, create_time=EPOCH_NS)
        return text

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()

    def _write(self, topic: str, kind: str, message: Any, time: int) -> None:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.schema(kind, "protobuf", embedded_schema(kind))
        if topic not in self._channels:
            self._channels[topic] = self._writer.channel(topic, self._schemas[kind], {})
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        data = message.SerializeToString()
        self._writer.message(self._channels[topic], data, log_time=time, publish_time=time, sequence=sequence)


def _poses(env: EnvView, group: str) -> str:
    return f"/{env.name}/{printable(group)}/poses"
