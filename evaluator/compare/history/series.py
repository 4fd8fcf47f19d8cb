"""The points in time of a history, a folder each; and one configuration on one device over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.evaluator.compare.matching import anywhere, machine
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable, read_all, without_copies
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.runs.groups import Group, GroupKey, group
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.memory import with_peers
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

ORDER = "points are in the order of the earliest start time that their recordings have; labels are names of folders"


@dataclass(frozen=True)
class Point:
    """One version or commit.

    label       name of its folder
    begins      earliest start time of its runs, UTC; empty where none says it
    runs        recordings that could be read, each run once
    unreadable  files that could not
    notes       on copies
    """

    label: str
    begins: str
    runs: tuple[Run, ...]
    unreadable: tuple[Unreadable, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Points:
    """All points of a history, in order, and what is said of the folder."""

    points: tuple[Point, ...]
    notes: tuple[str, ...]


def read_points(folder: Path, reader: Reader, work: Work) -> Points:
    """Read a history: folders in `folder` are points, hidden ones aside; recordings of a point lie in it and below it.

    UsageError where there is none, or where a run belongs to two points.
    """
    if not folder.is_dir():
        raise UsageError(f"--history is a folder that has a folder for each version or commit, and {folder} is none")
    places = {inside.name: _recordings(inside) for inside in sorted(folder.iterdir()) if _is_point(inside)}
    if not any(places.values()):
        raise UsageError(
            f"{folder} has no folder with recordings (*.mcap); --history takes a folder that has one for each version "
            "or commit"
        )
    notes = [f"{label} has no recordings (*.mcap), and is left out" for label, inside in places.items() if not inside]
    if loose := len(list(folder.glob("*.mcap"))):
        what = "recording that lies" if loose == 1 else "recordings that lie"
        notes.append(f"{loose} {what} in {folder.name} itself, in no folder of a version or commit: left out")
    wanted = [place for inside in places.values() for place in inside]
    read = dict(zip(wanted, read_all(wanted, reader, work), strict=True))
    points = [_point(label, [read[place] for place in inside]) for label, inside in places.items() if inside]
    _refuse_shared(points)
    undated = [point.label for point in points if point.runs and not point.begins]
    if undated:
        notes.append(f"no recording says when it was made in {', '.join(undated)}: placed first, by name")
    points.sort(key=lambda point: (point.begins, point.label))
    return Points(tuple(points), tuple(notes))


def _recordings(folder: Path) -> list[Path]:
    # what a run has reserved and not yet written to is empty
    partial = [path for path in folder.rglob(f"*.mcap{PARTIAL}") if path.stat().st_size > 0]
    return sorted([*(path for path in folder.rglob("*.mcap") if path.is_file()), *partial])


def _is_point(inside: Path) -> bool:
    return inside.is_dir() and not inside.name.startswith(".")


def _point(label: str, files: Sequence[Run | Unreadable]) -> Point:
    found = without_copies(files)
    times = [run.provenance.created_utc for run in found.runs if run.provenance.dated]
    return Point(label, min(times, default=""), tuple(with_peers(found.runs)), found.unreadable, found.notes)


def _refuse_shared(points: Sequence[Point]) -> None:
    known: dict[str, tuple[str, Run]] = {}
    for point in points:
        for run in point.runs:
            label, first = known.setdefault(run.provenance.run_id, (point.label, run))
            if first is not run:
                raise UsageError(
                    f"{first.path} of {label} and {run.path} of {point.label} are one run, which belongs to one point "
                    "in time: remove it from the other"
                )


@dataclass(frozen=True)
class Entry:
    """The runs of a point: all that were asked for the same there, and the complete ones as metrics take them."""

    point: int
    group: Group[Run]
    runs: GroupRuns


@dataclass(frozen=True)
class Series:
    """A configuration on a device, at the points that have it.

    label    of the configuration, unique for a scene, number of environments and step
    key      what was asked for, on whatever machine
    device   that steps, by name
    scene    first characters of the digest of the scene's description, where the same name had several; else empty
    entries  in the order of the points
    """

    label: str
    key: GroupKey
    device: str
    scene: str
    entries: tuple[Entry, ...]

    @property
    def heading(self) -> str:
        """Which configuration."""
        envs = plural(self.key.n_env, "env")
        scene = f"{self.key.scene} ({self.scene})" if self.scene else self.key.scene
        return f"{self.label}, {scene}, {envs}, dt {self.key.dt:g} s"


def series_of(points: Sequence[Point], work: Work) -> tuple[list[Series], list[str]]:
    """All series in a fixed order, and notes on what is split or left out.

    Points are of one series where the same was asked for, on the same machine (CPU, threads, GPUs by name), of the same
    description of the scene. Versions, packages, drivers and environment variables may differ: they are what changed.
    """
    found: dict[GroupKey, dict[tuple[str, str], list[Entry]]] = {}
    notes: list[str] = []
    measured = 0
    for index, point in enumerate(points):
        groups = group(point.runs)
        measured += sum(len(g.recordings) for g in groups if g.measured)
        alike = gathered(((anywhere(one), machine(one)), one) for one in groups if not one.measured)
        for (key, place), several in alike.items():
            if len(several) > 1:
                notes.append(
                    f"{point.label}: {len(several)} groups of {key.simulator}, {key.scene}, {plural(key.n_env, 'env')} "
                    "were asked for the same, in different versions or conditions: left out, because a point is one "
                    "version"
                )
                continue
            of_key = found.setdefault(key, {})
            entry = Entry(index, several[0], GroupRuns(several[0].complete, work=work))
            of_key.setdefault(_place(place, several[0].key.scene_hash, of_key), []).append(entry)
    if measured:
        notes.append("real trials are left out")
    keys = sorted(found, key=lambda key: (key.scene, key.simulator, key.n_env, key.dt, key.determinism, key.options))
    plain = [_plain(key) for key in keys]
    distinct = list(dict.fromkeys(plain))
    given = options_given(run for point in points for run in point.runs)
    named = dict(zip(distinct, labels(distinct, given), strict=True))
    series: list[Series] = []
    for key, same in zip(keys, plain, strict=True):
        scenes = {scene for _, scene in found[key]}
        split = [
            Series(named[same], key, _device(entries), scene[:8] if len(scenes) > 1 else "", tuple(entries))
            for (_, scene), entries in found[key].items()
        ]
        if len(split) > 1:
            notes.append(_split(split, points))
        series += split
    return series, notes


def _place(place: str, scene: str, known: dict[tuple[str, str], list[Entry]]) -> tuple[str, str]:
    """Machine and scene; a group that was never built does not know its scene, and joins the last on its machine."""
    if scene:
        return place, scene
    return next((one for one in reversed(known) if one[0] == place), (place, scene))


def _plain(key: GroupKey) -> GroupKey:
    # labels read JSON; scene, environments and step stand beside them in every heading
    return replace(key, scene="", n_env=0, dt=0.0, conditions="{}", switches="{}", layout="{}")


def _device(entries: Sequence[Entry]) -> str:
    built = [entry.group.key.device for entry in entries if entry.group.key.version]
    return built[-1] if built else entries[-1].group.key.device


def _split(series: Sequence[Series], points: Sequence[Point]) -> str:
    parts = "; ".join(
        f"{one.device}{f' (scene {one.scene})' if one.scene else ''} at {_span(one, points)}" for one in series
    )
    what = "device" if len({one.device for one in series}) > 1 else "machine or scene"
    return f"{series[0].heading}: {what} changed: the curve is split, and points are compared within a part: {parts}"


def _span(series: Series, points: Sequence[Point]) -> str:
    first, last = (points[series.entries[end].point].label for end in (0, -1))
    return first if first == last else f"{first} to {last} ({plural(len(series.entries), 'point')})"
