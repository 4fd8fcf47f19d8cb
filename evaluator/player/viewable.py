"""Files that other viewers draw: recordings that have a view of what is shown inside, and views made of others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gpusimbench.evaluator.player.clip import Clip
from gpusimbench.evaluator.player.viewer import write_view
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.mcap.reader import Container

_DRAWN = "foxglove.SceneUpdate"  # with which an environment's poses come


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
