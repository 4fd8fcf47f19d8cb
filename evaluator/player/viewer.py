"""Some environments of a recording as a file for viewers, and recordings that viewers can be given as they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.player.clip import Clip
from gpusimbench.evaluator.player.poses import hidden_groups, nothing_shown
from gpusimbench.evaluator.read.copying import LIBRARY
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import EPOCH_NS, sim_time_ns
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.writer import McapWriter
from gpusimbench.schemas.messages import embedded_schema, message_class
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.view.foxglove import event_line, status_line
from gpusimbench.schemas.view.geometry import Solid
from gpusimbench.schemas.view.kinematics import Vector
from gpusimbench.schemas.view.motion import Frame, Motion, one_of
from gpusimbench.schemas.view.recorded import NAME, ROOT, EnvView, layout
from gpusimbench.schemas.writing import new_file

_SCENE, _TRANSFORMS, _LOG = "/scene", "/tf", "/log"

Shown = tuple[EnvView, Sequence[Frame]]
"""An environment, and how what is in it moves."""

_LAST_NS = 1 << 62
_DRAWN = "foxglove.SceneUpdate"  # with which an environment's poses come


class ViewWriter:
    """Writes messages of Foxglove, each type and topic declared at its first use."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def scene(self, envs: Sequence[EnvView]) -> None:
        """Write the shapes and colours of all bodies, once."""
        entities = [entity for env in envs for entity in env.entities()]
        update = message_class("foxglove.SceneUpdate")(entities=entities)
        self._write(_SCENE, "foxglove.SceneUpdate", update, EPOCH_NS)

    def events(self, recording: Recording) -> None:
        """All at the beginning: they happened in wall time, of which simulated time knows nothing."""
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


@dataclass(frozen=True)
class View:
    """A file that was written.

    shapes      bodies and links that are drawn
    frames      that move
    times       points of simulated time
    seconds     of simulated time, from the first to the last
    notes       what is not drawn, and why
    layout      for Foxglove, JSON
    incomplete  the recording was cut short
    """

    path: Path
    shapes: int
    frames: int
    times: int
    seconds: float
    notes: tuple[str, ...]
    layout: str
    incomplete: bool


def write_view(source: Path, path: Path, *, envs: Sequence[int], rate: float, spread: float) -> View:
    """Write the view of some environments.

    rate    at most so many poses a second of simulated time [Hz]
    spread  environments whose origins are the same are put side by side along y, this far apart [m]

    UsageError where there is no such environment, no state, or the name is taken.
    """
    if not 1e-3 <= rate <= 1e6:
        raise UsageError(f"--rate is a number from 0.001 to 1e6, not {rate:g}")
    if not math.isfinite(spread):
        raise UsageError(f"--spread is a distance in metres, not {spread}")
    recording = Recording(source)
    n_env = recording.configuration.n_env
    for env in envs:
        if not 0 <= env < n_env:
            raise UsageError(f"--env is a number from 0 to {n_env - 1} in {source}, not {env}")
    chosen = tuple(dict.fromkeys(envs))
    views = _views(recording, chosen, spread)
    rows = _rows(recording, views[0].motion, rate)
    times = _times(recording, views[0].motion, rows)
    if not times:
        raise UsageError(f"{source} {nothing_shown(recording)}")
    shown = tuple((view, _frames(recording, view, rows)) for view in views)
    with new_file(path) as target:
        writer = ViewWriter(McapWriter(target.stream, profile="", library=LIBRARY, compression="zstd"))
        writer.scene(views)
        writer.events(recording)
        for row, time in enumerate(times):
            writer.row(shown, row, EPOCH_NS + time)
        text = writer.about(recording, views)
        writer.finish()
    solids = views[0].solids
    return View(
        path, len(shown) * sum(bool(solid.shapes) for solid in solids), sum(len(frames) for _, frames in shown),
        len(times), (times[-1] - times[0]) * 1e-9, tuple(_notes(recording, shown, solids)), text,
        recording.status == "incomplete",
    )  # fmt: skip


def _views(recording: Recording, envs: Sequence[int], spread: float) -> tuple[EnvView, ...]:
    origins = recording.simulation.env_origins if recording.simulation else ()
    places = _places(origins, envs, spread)
    try:
        return tuple(
            EnvView(
                env, place,
                Motion(recording.fields, recording.look, origin=origins[env] if origins else (0.0, 0.0, 0.0)),
                recording.look.solids,
            )
            for env, place in zip(envs, places, strict=True)
        )  # fmt: skip
    except DamagedRecording as error:
        said = str(error).removeprefix(f"{recording.path}: ")
        raise DamagedRecording(f"{recording.path}: {said}") from None


def _places(origins: Sequence[Vector], envs: Sequence[int], spread: float) -> list[Vector]:
    places: list[Vector] = []
    taken: dict[Vector, int] = {}
    for env in envs:
        x, y, z = origins[env] if origins else (0.0, 0.0, 0.0)
        before = taken.get((x, y, z), 0)
        taken[x, y, z] = before + 1
        places.append((x, y + before * spread, z))
    return places


def _rows(recording: Recording, motion: Motion, rate: float) -> slice:
    # at most `rate` times a simulated second; none where a field has none
    stop = min((len(recording.state(field.group, field.field)) for field in motion.fields), default=0)
    c = recording.configuration
    step = one_of(rate, dt=c.dt, stride=c.stride)
    return slice(-(c.first_step // c.stride) % step, stop, step)


def _times(recording: Recording, motion: Motion, rows: slice) -> tuple[int, ...]:
    if not rows.stop:
        return ()
    field = motion.fields[0]
    steps = recording.state(field.group, field.field).steps[rows]
    times = tuple(sim_time_ns(int(step), recording.configuration.dt) for step in steps)
    if times and times[-1] > _LAST_NS:
        raise DamagedRecording(f"{recording.path}: {times[-1]} ns is no time that a run lasts")
    return times


def _frames(recording: Recording, view: EnvView, rows: slice) -> tuple[Frame, ...]:
    states = [recording.state(field.group, field.field)[rows, view.number] for field in view.motion.fields]
    return view.motion.frames(states)


def _notes(recording: Recording, shown: Sequence[Shown], solids: Sequence[Solid]) -> list[str]:
    notes = list(recording.look.notes)
    motion = shown[0][0].motion
    drawn = {solid.name for solid in solids if solid.shapes}
    bare = [part.name for part in motion.parts if part.name not in drawn]
    if bare:
        notes.append(f"no shape in the scene for {', '.join(bare[:5])}: only frames are shown")
    for group in hidden_groups(recording):
        notes.append(f"the group {group} has no positions, and no robot that its joints belong to: it is not shown")
    if len({view.place for view, _ in shown}) < len(shown):
        notes.append("environments at the same place are drawn into each other; --spread puts them side by side")
    return notes


def envs_inside(path: Path) -> set[int]:
    """Environments that a recording has a view of inside, which Foxglove and rerun draw."""
    channels = Container(path).channels.values()
    parts = [topics.parse_view(channel.topic) for channel in channels if channel.message == _DRAWN]
    return {part.env for part in parts if part is not None}


def views(recordings: Sequence[Recording], clip: Clip, folder: Path, *, spread: float) -> list[Path]:
    """Each recording itself, where its view has all its environments of the clip, or a file with them in the folder.

    Nobody is shown other environments than the clip is said to show.
    """
    found = []
    for index, recording in enumerate(recordings):
        if not isinstance(recording.path, Path):
            raise UsageError(
                f"{recording.path} is not on this machine: download it, because other programs open local files only"
            )
        envs = [track.env for track in clip.tracks if track.recording == index] or [0]
        if envs_inside(recording.path).issuperset(envs):
            found.append(recording.path)
            continue
        target = folder / f"{index}-{recording.path.stem}-view.mcap"
        found.append(write_view(recording.path, target, envs=envs, rate=30.0, spread=spread).path)
    return found
