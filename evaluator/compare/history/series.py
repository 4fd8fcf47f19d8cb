"""One configuration on one device over the points of a history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.compare.history.points import Point
from gpusimbench.evaluator.compare.matching import anywhere, machine
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.runs.groups import Group, GroupKey, group
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.text import plural


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
        alike: dict[tuple[GroupKey, str], list[Group[Run]]] = {}
        for one in groups:
            if not one.measured:
                alike.setdefault((anywhere(one), machine(one)), []).append(one)
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
