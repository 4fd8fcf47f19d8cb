"""A history of recordings: curves over its points, their changes, and what is known for certain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from gpusimbench.evaluator.compare.counted import (
    all_alike,
    apart_by_chance,
    compare_bits,
    compare_determinism,
    compare_mechanics,
    compare_misplaced,
    compare_validity,
)
from gpusimbench.evaluator.compare.finding import DIFFERENT, FAILING, Change, Finding, Settings, exit_code_of
from gpusimbench.evaluator.compare.history.curves import Curve, Shift, curves_of, searched
from gpusimbench.evaluator.compare.history.series import Entry, Point, Points, Series, series_of
from gpusimbench.evaluator.compare.matching import Pair
from gpusimbench.evaluator.compare.outcome import (
    JOINT_OUTCOMES,
    compare_outcomes,
    distances,
    has_positions,
    joint_distances,
)
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.runs.groups import status_notes
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural


@dataclass(frozen=True)
class Fact:
    """A statement on two neighbouring points that needs no statistics: `previous` is the base, `point` the head."""

    point: int
    previous: int
    finding: Finding


@dataclass(frozen=True)
class Traced:
    """A series with what was found in it.

    curves  of its quantities
    facts   what is another at a point than at the one before, for certain
    newest  what the newest pair says of bits, runs and mechanics, changed or not
    """

    series: Series
    curves: tuple[Curve, ...]
    facts: tuple[Fact, ...]
    newest: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Event:
    """A change at a point: of a quantity's curve, or a fact."""

    traced: Traced
    point: int
    previous: int
    axis: Axis
    title: str
    change: Change
    curve: Curve | None = None
    shift: Shift | None = None
    finding: Finding | None = None


@dataclass(frozen=True)
class History:
    """What was found.

    points    in order
    traced    one for each configuration and device
    settings  what counts; `gates` decide where `gated`
    gated     whether the newest point has to pass
    tests     curves that were searched by a test: each may take alpha / tests of the chance of a false alarm
    lost      recordings that were cut short or lost data
    notes     on what is left out or split
    """

    points: tuple[Point, ...]
    traced: tuple[Traced, ...]
    settings: Settings
    gated: bool
    tests: int
    lost: int
    notes: tuple[str, ...]

    @property
    def unreadable(self) -> list[tuple[str, Unreadable]]:
        """Label of the point, and the file."""
        return [(point.label, one) for point in self.points for one in point.unreadable]

    @property
    def events(self) -> list[Event]:
        """All changes, those of the newest points first."""
        return sorted((event for one in self.traced for event in _events(one)), key=lambda event: -event.point)

    @property
    def newest(self) -> int:
        """Index of the newest point that has a run."""
        return max((entry.point for one in self.traced for entry in one.series.entries), default=-1)

    @property
    def failing(self) -> list[Event]:
        """Changes at the newest point that fail a gate; none where nothing is gated."""
        if not self.gated:
            return []
        gates = self.settings.gates
        return [e for e in self.events if e.point == self.newest and e.axis in gates and e.change in FAILING]

    @property
    def undecided(self) -> list[tuple[Traced, Axis, str, str]]:
        """Series, axis, title and reason of what a gate asks of the newest point and the history does not tell."""
        if not self.gated:
            return []
        return [found for one in self.traced for found in self._open(one) if found[1] in self.settings.gates]

    def _open(self, one: Traced) -> Iterator[tuple[Traced, Axis, str, str]]:
        if one.series.entries[-1].point != self.newest:
            return
        for curve in one.curves:
            if why := curve.undecided(self.newest, self.settings):
                yield one, curve.axis, curve.metric.title, why
        for finding in one.newest:
            if why := finding.undecided(self.settings):
                yield one, finding.axis, finding.title, why

    @property
    def compared(self) -> bool:
        """Whether any two points were compared."""
        return any(len(one.series.entries) > 1 for one in self.traced)

    @property
    def exit_code(self) -> ExitCode:
        """The exit code of gsb-compare, as of two sets."""
        lost = bool(self.unreadable or self.lost)
        return exit_code_of(failing=bool(self.failing), lost=lost, decided=self.compared and not self.undecided)


def trace(found: Points, settings: Settings, work: Work, *, gated: bool = False) -> History:
    """Find what changed over the points of a history."""
    series, notes = series_of(found.points, work)
    drawn = [list(curves_of(one)) for one in series]
    tests = sum(curve.tested for curves in drawn for curve in curves)
    level = settings.alpha / max(tests, 1)
    traced = [
        _traced(one, tuple(searched(curve, level, settings) for curve in curves), settings, work)
        for one, curves in zip(series, drawn, strict=True)
    ]
    copies = [f"{point.label}: {note}" for point in found.points for note in point.notes]
    runs = [run for point in found.points for run in point.runs]
    lost = sum(run.status == "incomplete" or bool(run.dropouts) for run in runs)
    told = (
        *found.notes,
        *copies,
        *notes,
        *_of_states(series, found.points),
        *_of_machines(traced, found.points),
        *_of_runs(series, found.points),
    )
    return History(found.points, tuple(traced), settings, gated, tests, lost, told)


def _traced(series: Series, curves: tuple[Curve, ...], settings: Settings, work: Work) -> Traced:
    facts: list[Fact] = []
    newest: tuple[Finding, ...] = ()
    for before, after in zip(series.entries, series.entries[1:], strict=False):
        newest = tuple(_certain(before, after, settings, work))
        facts += [Fact(after.point, before.point, one) for one in newest if one.change in DIFFERENT]
    return Traced(series, curves, tuple(facts), newest)


def _certain(before: Entry, after: Entry, settings: Settings, work: Work) -> Iterator[Finding]:
    """What two neighbouring points tell without statistics."""
    one, other = before.runs, after.runs
    pair = Pair("", before.group, after.group, (), same_machine=True)
    found: list[object] = [compare_validity(pair)]
    if one.runs and other.runs:
        found.append(compare_misplaced(one.runs, other.runs))
        certain = all_alike(one) and all_alike(other)
        found += compare_mechanics(one.runs, other.runs, certain=certain)
        if certain:
            # all runs of a point end at the same bits: two speak for all
            ends = one.runs[:2], other.runs[:2]
            found.append(compare_outcomes(distances(*ends, work), settings, applies=has_positions(*ends)))
            found += [
                compare_outcomes(joint_distances(*ends, unit), settings, applies=True, asked=asked)
                for unit, asked in JOINT_OUTCOMES.items()
            ]
        found += [*compare_determinism(one, other), compare_bits(one.runs, other.runs)]
    yield from (item for item in found if isinstance(item, Finding))


def _of_states(series: Sequence[Series], points: Sequence[Point]) -> Iterator[str]:
    """Neighbouring points whose states differ, which is no change as long as a point has a single run."""
    for one in series:
        apart = [
            (before, after, since)
            for before, after in pairwise(one.entries)
            if (since := apart_by_chance(before.runs.runs, after.runs.runs)) is not None
        ]
        if apart:
            before, after, since = apart[-1]
            more = f", and so at {plural(len(apart) - 1, 'earlier point')}" if len(apart) > 1 else ""
            yield (
                f"{one.heading}: states of {points[after.point].label} differ from those of "
                f"{points[before.point].label} from step {since} on{more}; whether runs of one point differ as well is "
                "not known: record two runs a point"
            )


def _of_runs(series: Sequence[Series], points: Sequence[Point]) -> Iterator[str]:
    """Runs that no quantity is computed from."""
    for one in series:
        for entry in one.entries:
            yield from (f"{points[entry.point].label}: {one.heading}: {note}" for note in status_notes(entry.group))


def _of_machines(traced: Sequence[Traced], points: Sequence[Point]) -> Iterator[str]:
    """Points at which all simulators of a device became faster, or slower, by one another's side."""
    devices = gathered((one.series.device, one) for one in traced)
    for device, several in devices.items():
        for index, point in enumerate(points):
            here = [one for one in several if any(entry.point == index for entry in one.series.entries[1:])]
            ways = {
                (one.series.key.simulator, shift.after > shift.before)
                for one in here
                for curve in one.curves
                for shift in curve.shifts
                if curve.axis is Axis.THROUGHPUT and shift.point == index
            }
            simulators = {one.series.key.simulator for one in here}
            if len(simulators) > 1 and len(ways) == len(simulators) and len({way for _, way in ways}) == 1:
                yield (
                    f"{point.label}: the throughput of all {len(simulators)} simulators on {device} changed the same "
                    "way: the machine may be what changed"
                )


def _events(one: Traced) -> Sequence[Event]:
    shifts = [
        Event(one, s.point, s.previous, c.axis, c.metric.title, s.change, curve=c, shift=s)
        for c in one.curves
        for s in c.shifts
    ]
    facts = [
        Event(one, f.point, f.previous, f.finding.axis, _title(f.finding), f.finding.change, finding=f.finding)
        for f in one.facts
    ]
    return [*shifts, *facts]


def _title(finding: Finding) -> str:
    # its sides are points here, no base and head
    return "states, by bits" if finding.axis is Axis.BITS else finding.title
