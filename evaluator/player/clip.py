"""What a player shows: some environments of recordings, their names, their poses over time, and their classes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.player.classes import Changes, ComparableHashes, changes, compared, representatives
from gpusimbench.evaluator.player.poses import (
    Items,
    Surroundings,
    hidden_groups,
    items_of,
    nothing_shown,
    recorded_steps,
    surroundings,
)
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import NothingComparable, UsageError
from gpusimbench.schemas.provenance import engine_name
from gpusimbench.schemas.text import ordinal, printable

MOST_SHOWN = 8
"""Environments at a time; there are as many colours that every reader can keep apart."""

BUDGET_BYTES = 1_400_000
"""Of a clip's poses, as text in a page."""

_DEFAULT_SHOWN = 6
_NOT_COMPARED_SHOWN = 4
_RATE_HZ = 30.0
_BEFORE, _BEHIND = 12, 24  # recorded rows around the first divergence, all of which are kept
_POSE_BYTES = 20 * 4 / 3  # of an item: three float32 and four int16, in base64
_MOST_ITEMS = 1000


@dataclass(frozen=True)
class Labels:
    """Names of what is shown together.

    title    the simulator, its version and the scene
    whose    "environments", or "environments of 3 recordings"
    sources  one a recording: empty where there is but one, "run 3", or a letter where runs have the same number
    lettered whether they are letters
    """

    title: str
    whose: str
    sources: tuple[str, ...]
    lettered: bool

    def track(self, recording: int, env: int) -> str:
        """An environment in words."""
        source = self.sources[recording]
        return f"env {env} of {source}" if source else f"env {env}"

    def short(self, recording: int, env: int) -> str:
        """An environment in a small place."""
        source = self.sources[recording].removeprefix("run ")
        return f"{source}·{env}" if source else str(env)

    @property
    def numbers(self) -> str:
        """What the parts of a short name are."""
        source = "recording" if self.lettered else "run"
        return f"{source} · environment" if self.sources[0] else "environment"

    def legend(self, recordings: Sequence[Recording]) -> str:
        """Which file has which letter."""
        pairs = zip(self.sources, recordings, strict=True)
        return "recording " + ", ".join(f"{source} is {recording.path.name}" for source, recording in pairs)


def labels_of(recordings: Sequence[Recording]) -> Labels:
    """Names for recordings of one scene."""
    kinds = dict.fromkeys(_kind(recording) for recording in recordings)
    title = f"{' and '.join(kinds)}: {recordings[0].configuration.scene}"
    if len(recordings) == 1:
        return Labels(printable(title), "environments", ("",), False)
    runs = [recording.configuration.run_index for recording in recordings]
    if len(kinds) == 1 and len(set(runs)) == len(runs):
        return Labels(printable(title), f"environments of {len(runs)} runs", tuple(f"run {run}" for run in runs), False)
    return Labels(
        printable(title), f"environments of {len(runs)} recordings", tuple(map(_letter, range(len(runs)))), True
    )


def _kind(recording: Recording) -> str:
    version = recording.simulation.version if recording.simulation else ""
    return f"{engine_name(recording.configuration.simulator, recording.simulation)} {version}".strip()


def _letter(index: int) -> str:
    return chr(ord("a") + index) if index < 26 else f"file {index + 1}"


@dataclass(frozen=True)
class Track:
    """One environment that is shown.

    recording, env  index of the recording, number in it
    label, short    in words, and for a small place
    steps           simulator steps of the poses, shape [row]
    items           what moves
    apart           largest distance of an item from the same one of the first track, at each row that both have, else
                    NaN; shape [row] [m]
    furthest        that item, shape [row]
    """

    recording: int
    env: int
    label: str
    short: str
    steps: NDArray[np.int64]
    items: Items
    apart: NDArray[np.float64]
    furthest: NDArray[np.int64]


@dataclass(frozen=True)
class Clip:
    """Environments over time.

    title     what they are of
    whose     "environments", or "environments of 10 runs"
    numbers   what the parts of a track's short name are
    dt        simulator step [s]
    last_step of any recording
    tracks    none where there are no states
    around    what stands still, and the shapes of what moves
    n_member  how many environments the classes are of
    changes   of the classes; None where bits are not compared
    not_compared  why
    notes     sentences: what is left out, what is thinned
    """

    title: str
    whose: str
    numbers: str
    dt: float
    last_step: int
    tracks: tuple[Track, ...]
    around: Surroundings
    n_member: int
    changes: Changes | None
    not_compared: str
    notes: tuple[str, ...]


def make_clip(
    recordings: Sequence[Recording], *, title: str = "", envs: Sequence[int] = (), budget: int = BUDGET_BYTES
) -> Clip:
    """Choose what is shown of recordings of one scene, and read it.

    title   default: the simulator, its version and the scene
    envs    of each recording; default: one that stands for each bitwise class, those that split off first
    budget  bytes that the poses may take in a page; more are thinned

    NothingComparable where there are no states; UsageError where recordings do not go together, or have no such env.
    """
    check_shown(recordings, envs)
    labels = labels_of(recordings)
    rows = [recorded_steps(recording) for recording in recordings]
    for recording, steps in zip(recordings, rows, strict=True):
        if not steps.size:
            why = f": {recording.status}: {recording.reason}" if recording.reason else ""
            raise NothingComparable(f"{recording.path} {nothing_shown(recording)}{why}")
    among = compared(recordings)
    chosen = _chosen(recordings, among, envs)
    seen, not_compared = _changes(among, chosen)
    first = seen.first_divergence if seen else None
    picked = [_picked(steps, r, first) for steps, r in zip(rows, recordings, strict=True)]
    around = surroundings(recordings[0])
    tracks = _tracks(recordings, chosen, labels, rows, picked, budget)
    n_member = among.hashes.shape[1] if isinstance(among, ComparableHashes) else 0
    last = int(max(steps[-1] for steps in rows))
    return Clip(
        title or labels.title, labels.whose, labels.numbers, recordings[0].configuration.dt, last, tracks, around,
        n_member, seen, not_compared, tuple(_notes(recordings, labels, among, seen, tracks, rows, around)),
    )  # fmt: skip


def check_shown(recordings: Sequence[Recording], envs: Sequence[int]) -> None:
    """UsageError where recordings do not go together, lack an environment, or more are asked for than are shown."""
    first = recordings[0]
    for other in recordings[1:]:
        if other.configuration.scene != first.configuration.scene:
            raise UsageError(
                f"{first.path} is of {first.configuration.scene}, {other.path} of {other.configuration.scene}: "
                "recordings that are shown together must have the same scene"
            )
        if other.configuration.dt != first.configuration.dt:
            raise UsageError(
                f"{first.path} steps by {first.configuration.dt:g} s, {other.path} by {other.configuration.dt:g} s: "
                "recordings that are shown together must have the same time step"
            )
    for recording in recordings:
        n_env = recording.configuration.n_env
        for env in envs:
            if not 0 <= env < n_env:
                raise UsageError(f"{recording.path} has no environment {env}: it has 0 to {n_env - 1}")
    if len(set(envs)) * len(recordings) > MOST_SHOWN:
        asked = f"{len(set(envs))} environments of {len(recordings)} recordings"
        raise UsageError(f"{asked} are too many to tell apart: at most {MOST_SHOWN} are shown at a time")


def _chosen(
    recordings: Sequence[Recording], among: ComparableHashes | str, envs: Sequence[int]
) -> list[tuple[int, int]]:
    """Recording and environment of each track."""
    if envs:
        return [(index, env) for env in dict.fromkeys(envs) for index in range(len(recordings))]
    if isinstance(among, ComparableHashes):
        members = representatives(among, _DEFAULT_SHOWN)
        return [(int(among.recording[member]), int(among.env[member])) for member in members]
    if len(recordings) > 1:
        return [(index, 0) for index in range(min(len(recordings), MOST_SHOWN))]
    return [(0, env) for env in range(min(recordings[0].configuration.n_env, _NOT_COMPARED_SHOWN))]


def _changes(among: ComparableHashes | str, chosen: Sequence[tuple[int, int]]) -> tuple[Changes | None, str]:
    if isinstance(among, str):
        return None, among
    members = [among.member(*one) for one in chosen]
    if None in members:
        return None, "the shown environments have different origins, which are part of their bits"
    return changes(among, [member for member in members if member is not None]), ""


def _picked(steps: NDArray[np.int64], recording: Recording, first: int | None) -> tuple[int, range]:
    """One of how many recorded rows is shown, and the rows around the first divergence that are all shown."""
    c = recording.configuration
    every = max(1, math.ceil(1 / (_RATE_HZ * c.dt * c.stride) - 1e-9))
    if first is None:
        return every, range(0)
    at = int(np.searchsorted(steps, first))
    return every, range(max(0, at - _BEFORE), min(len(steps), at + _BEHIND))


def _tracks(
    recordings: Sequence[Recording],
    chosen: Sequence[tuple[int, int]],
    labels: Labels,
    steps: Sequence[NDArray[np.int64]],
    picked: Sequence[tuple[int, range]],
    budget: int,
) -> tuple[Track, ...]:
    n_item = max(len(items_of(recordings[r], e, [range(1)]).bodies) for r, e in {r: (r, e) for r, e in chosen}.values())
    if not n_item or n_item > _MOST_ITEMS:
        raise NothingComparable(f"{recordings[0].path} has {n_item} bodies and links that could be shown")
    room = int(budget / (n_item * _POSE_BYTES * len(chosen)))
    found: list[Track] = []
    for index, env in chosen:
        every, window = picked[index]
        n_row = len(steps[index])
        every = max(every, math.ceil(n_row / max(1, room - len(window))))
        coarse = range(0, n_row, every)
        items = items_of(recordings[index], env, [coarse, *([window] if window else [])])
        rows = np.concatenate([np.array(coarse, dtype=np.int64), np.array(window, dtype=np.int64)])
        _, once = np.unique(rows, return_index=True)
        kept = Items(items.bodies, items.position[once], items.orientation[once])
        at = steps[index][rows[once]]
        apart, furthest = _apart(found[0] if found else None, at, kept)
        found.append(Track(index, env, labels.track(index, env), labels.short(index, env), at, kept, apart, furthest))
    return tuple(found)


def _apart(
    first: Track | None, steps: NDArray[np.int64], items: Items
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    apart, furthest = np.full(len(steps), np.nan), np.zeros(len(steps), dtype=np.int64)
    if first is None or first.items.bodies != items.bodies:
        return apart, furthest
    _, mine, theirs = np.intersect1d(steps, first.steps, return_indices=True)
    distance = np.linalg.norm(items.position[mine] - first.items.position[theirs], axis=-1)
    known = np.isfinite(distance).all(axis=1)
    furthest[mine[known]] = distance[known].argmax(axis=1)
    apart[mine[known]] = distance[known].max(axis=1)
    return apart, furthest


def _notes(
    recordings: Sequence[Recording],
    labels: Labels,
    among: ComparableHashes | str,
    seen: Changes | None,
    tracks: Sequence[Track],
    rows: Sequence[NDArray[np.int64]],
    around: Surroundings,
) -> list[str]:
    notes = [labels.legend(recordings)] if labels.lettered else []
    notes += recordings[0].look.notes
    if seen is not None and seen.so_far[-1] > len(set(seen.leader[-1].tolist())):
        notes.append(
            f"{len(tracks)} environments are shown, of {seen.so_far[-1]} bitwise classes in the end; those that split "
            "off first are shown first"
        )
    notes += dict.fromkeys(filter(None, (recording.apart_by_design for recording in recordings)))
    if isinstance(among, ComparableHashes) and among.left_out:
        notes.append(among.left_out)
    if seen is not None and not seen.complete:
        notes.append(f"changes of classes after step {seen.steps[-1]} are not shown: there are too many")
    strides = sorted({recording.configuration.stride for recording in recordings})
    if strides != [1]:
        told = " or ".join(ordinal(stride) for stride in strides if stride > 1)
        notes.append(f"states were recorded at every {told} step only; in between, the last recorded state is shown")
    if any(len(track.steps) < len(rows[track.recording]) for track in tracks):
        kept = ", ".join(dict.fromkeys(f"{len(t.steps)} of {len(rows[t.recording])}" for t in tracks))
        diverge = seen is not None and seen.first_divergence is not None
        near = ", among them every state around the first divergence" if diverge else ""
        notes.append(f"this page has {kept} recorded states{near}")
    if around.left_out:
        notes.append(f"{around.left_out} shapes of the scene are not drawn: there are too many")
    shapeless = sum(body not in around.bodies for body in tracks[0].items.bodies)
    if shapeless:
        one = "1 body has no known shape and is shown as a dot"
        notes.append(one if shapeless == 1 else f"{shapeless} bodies have no known shape and are shown as dots")
    if hidden := hidden_groups(recordings[0]):
        notes.append(f"not shown: {', '.join(hidden)} (joints, and scene.json describes no robot that they move)")
    for recording in recordings:
        if recording.status != "complete":
            notes.append(f"recording {recording.path.name} is {recording.status}: {recording.reason}")
    if any(recording.scene != recordings[0].scene for recording in recordings[1:]):
        notes.append("the recordings describe the scene differently; the description of the first one is drawn")
    return notes
