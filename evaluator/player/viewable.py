"""Files that other viewers draw: recordings that have a view inside, and views made of those that have none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evaluator.player.clip import Clip
from evaluator.recording import Recording
from evaluator.sharing.viewer import write_view
from schemas.container import Container
from schemas.errors import UsageError

_DRAWN = ("SceneUpdate", "FrameTransforms", "PosesInFrame")


def has_view(path: Path) -> bool:
    """Whether a file has messages that Foxglove and rerun draw."""
    container = Container(path)
    return any(channel.message.removeprefix("foxglove.") in _DRAWN for channel in container.channels.values())


def views(recordings: Sequence[Recording], clip: Clip, folder: Path, *, spread: float) -> list[Path]:
    """Each recording itself, where it has a view inside, or a file in the folder with its environments of the clip."""
    found = []
    for index, recording in enumerate(recordings):
        if not isinstance(recording.path, Path):
            raise UsageError(f"{recording.path} is elsewhere; other programs are given files of this machine: copy it")
        if has_view(recording.path):
            found.append(recording.path)
            continue
        envs = [track.env for track in clip.tracks if track.recording == index] or [0]
        target = folder / f"{index}-{recording.path.stem}-view.mcap"
        found.append(write_view(recording.path, target, envs=envs, rate=30.0, spread=spread).path)
    return found
