"""The messages of a view: frames, shapes and events of some environments, for Foxglove and whoever reads its types."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from evaluator.recording import Recording
from evaluator.report.text import printable
from evaluator.sharing import foxglove
from evaluator.sharing.layout import NAME, layout
from evaluator.sharing.motion import ROBOT, Frame
from evaluator.sharing.shapes import IDENTITY, Solid, Vector
from schemas.configuration import EPOCH_NS
from schemas.mcap_writer import McapWriter

_ROOT = "world"
_SCENE, _TRANSFORMS, _LOG = "/scene", "/tf", "/log"

_FIXED: tuple[foxglove.Colour, ...] = ((0.55, 0.55, 0.58),)
_BODY: tuple[foxglove.Colour, ...] = ((0.84, 0.65, 0.38), (0.70, 0.50, 0.27))  # neighbours differ
_LINK: tuple[foxglove.Colour, ...] = ((0.92, 0.92, 0.92), (0.75, 0.77, 0.80))


@dataclass(frozen=True)
class ShownEnv:
    """An environment, where it stands in the view [m], and what moves in it."""

    number: int
    place: Vector
    frames: tuple[Frame, ...]

    @property
    def name(self) -> str:
        """Of its frame, and the begin of others."""
        return f"env{self.number}"

    def frame(self, name: str) -> str:
        """The frame of a body or link; with an empty name, the environment's own."""
        return f"{self.name}/{printable(name)}" if name else self.name

    def groups(self) -> dict[str, list[Frame]]:
        """Bodies by the topic of their poses; links have none, since they are relative to each other."""
        found: dict[str, list[Frame]] = {}
        for frame in self.frames:
            if frame.group != ROBOT:
                found.setdefault(f"/{self.name}/{printable(frame.group)}/poses", []).append(frame)
        return found


class ViewWriter:
    """Writes messages of Foxglove, each type and topic declared at its first use."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def scene(self, envs: Sequence[ShownEnv], solids: Sequence[Solid]) -> None:
        """What things look like, once; who moves takes its shapes along."""
        entities = []
        for env in envs:
            there = {frame.name for frame in env.frames}
            for index, solid in enumerate(solids):
                if not solid.shapes or (solid.group and solid.name not in there):
                    continue
                tones = _FIXED if not solid.group else _LINK if solid.group == ROBOT else _BODY
                entities.append(
                    foxglove.entity(
                        EPOCH_NS, env.frame(solid.name if solid.group else ""), env.frame(solid.name),
                        solid.shapes, tones[index % len(tones)],
                    )
                )  # fmt: skip
        self._write(_SCENE, "SceneUpdate", foxglove.message_class("SceneUpdate")(entities=entities), EPOCH_NS)

    def events(self, recording: Recording) -> None:
        """All at the begin: they happened in wall time, of which simulated time knows nothing."""
        level = foxglove.message_class("Log").Level
        for event in recording.events:
            text = " ".join(filter(None, (event.kind.replace("_", " ").lower(), event.phase, event.text)))
            self._log(level.Value("ERROR" if event.kind == "GATE" else "INFO"), text, event.unix_ns)
        status = f"status {recording.status}{': ' if recording.reason else ''}{recording.reason}"
        last = recording.events[-1].unix_ns if recording.events else EPOCH_NS
        self._log(level.Value("INFO" if recording.usable else "ERROR"), status, last)

    def _log(self, level: int, text: str, unix_ns: int) -> None:
        message = foxglove.message_class("Log")(level=level, message=text, name="gsb")
        message.timestamp.FromNanoseconds(unix_ns)
        self._write(_LOG, "Log", message, EPOCH_NS)

    def row(self, envs: Sequence[ShownEnv], row: int, time: int) -> None:
        """Where everything is at a time [ns]."""
        transforms = foxglove.message_class("FrameTransforms")()
        for env in envs:
            transforms.transforms.append(foxglove.transform(time, _ROOT, env.name, env.place, IDENTITY))
            for frame in env.frames:
                transforms.transforms.append(
                    foxglove.transform(
                        time, env.frame(frame.parent), env.frame(frame.name),
                        frame.position[row].tolist(), frame.orientation[row].tolist(),
                    )
                )  # fmt: skip
        self._write(_TRANSFORMS, "FrameTransforms", transforms, time)
        for env in envs:
            for topic, frames in env.groups().items():
                poses = foxglove.message_class("PosesInFrame")(frame_id=env.name)
                poses.timestamp.FromNanoseconds(time)
                poses.poses.extend(
                    foxglove.pose(frame.position[row].tolist(), frame.orientation[row].tolist()) for frame in frames
                )
                self._write(topic, "PosesInFrame", poses, time)

    def about(self, recording: Recording, envs: Sequence[ShownEnv]) -> str:
        """Where the view comes from, and how Foxglove is to show it; returns the layout."""
        self._writer.metadata(
            "gsb-view",
            {
                "run_id": printable(recording.provenance.run_id),
                "content_hash": recording.content_hash,
                "environments": ",".join(str(env.number) for env in envs),
            },
        )
        text = layout(scene=_SCENE, log=_LOG, poses=[topic for env in envs for topic in env.groups()], root=_ROOT)
        self._writer.attachment(NAME, "application/json", text.encode(), log_time=EPOCH_NS, create_time=EPOCH_NS)
        return text

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()

    def _write(self, topic: str, kind: str, message: Any, time: int) -> None:
        if kind not in self._schemas:
            schema = foxglove.embedded_schema(kind)
            self._schemas[kind] = self._writer.schema(f"foxglove.{kind}", "protobuf", schema)
        if topic not in self._channels:
            self._channels[topic] = self._writer.channel(topic, self._schemas[kind], {})
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        data = message.SerializeToString()
        self._writer.message(self._channels[topic], data, log_time=time, publish_time=time, sequence=sequence)
