"""Some environments of a recording as a file for viewers: shapes once, poses over simulated time, events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from evaluator.recording import Recording
from evaluator.sharing.copying import LIBRARY
from evaluator.sharing.motion import Rows, frames_of, rows_at
from evaluator.sharing.shapes import Solid, Vector, solids_of
from evaluator.sharing.target import new_file
from evaluator.sharing.view_writer import ShownEnv, ViewWriter
from schemas.configuration import EPOCH_NS
from schemas.errors import UsageError
from schemas.mcap_writer import McapWriter


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
    rows = rows_at(recording, rate)
    if not rows.times:
        raise UsageError(f"{source} holds no states of bodies or joints; there is nothing to show")
    chosen = tuple(dict.fromkeys(envs))
    shown = tuple(
        ShownEnv(env, place, frames_of(recording, env, rows))
        for env, place in zip(chosen, _places(recording, chosen, spread), strict=True)
    )
    solids = solids_of(recording)
    with new_file(path) as target:
        writer = ViewWriter(McapWriter(target.stream, profile="", library=LIBRARY, compression="zstd"))
        writer.scene(shown, solids)
        writer.events(recording)
        for row, time in enumerate(rows.times):
            writer.row(shown, row, EPOCH_NS + time)
        text = writer.about(recording, shown)
        writer.finish()
    return View(
        path, len(shown) * sum(bool(solid.shapes) for solid in solids), sum(len(env.frames) for env in shown),
        len(rows.times), _seconds(rows), tuple(_notes(recording, shown, solids)), text,
        recording.status == "incomplete",
    )  # fmt: skip


def _places(recording: Recording, envs: Sequence[int], spread: float) -> list[Vector]:
    origins = recording.simulation.env_origins if recording.simulation else ()
    places: list[Vector] = []
    taken: dict[Vector, int] = {}
    for env in envs:
        x, y, z = origins[env] if origins else (0.0, 0.0, 0.0)
        before = taken.get((x, y, z), 0)
        taken[x, y, z] = before + 1
        places.append((x, y + before * spread, z))
    return places


def _seconds(rows: Rows) -> float:
    return (rows.times[-1] - rows.times[0]) * 1e-9


def _notes(recording: Recording, envs: Sequence[ShownEnv], solids: Sequence[Solid]) -> list[str]:
    notes = []
    drawn = {solid.name for solid in solids if solid.shapes}
    bare = [frame.name for frame in envs[0].frames if frame.name not in drawn]
    if bare:
        notes.append(f"no shape in the scene for {', '.join(bare[:5])}: only frames are shown")
    moving = {frame.group for frame in envs[0].frames}
    for group in dict.fromkeys(field.group for field in recording.fields):
        if group not in moving:
            notes.append(f"the group {group} has no positions, and no robot that its joints belong to: it is not shown")
    if len({env.place for env in envs}) < len(envs):
        notes.append("environments at the same place are drawn into each other; --spread puts them side by side")
    return notes
