"""A history as a document: verdict and changes, then a curve for each quantity of each configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from markupsafe import Markup

from gpusimbench.evaluator.compare.finding import FAILING, Change
from gpusimbench.evaluator.compare.history import words
from gpusimbench.evaluator.compare.history.curves import FACT, Curve, Sample, Shift
from gpusimbench.evaluator.compare.history.history import Event, History, Traced
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    EMPTY,
    Block,
    Cell,
    Code,
    Document,
    Figure,
    Gallery,
    Item,
    Items,
    Numbers,
    Section,
    Table,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.figures.history import Dot, Level, Mark, history_chart
from gpusimbench.evaluator.render.numbers import NONE, bounds, figure
from gpusimbench.evaluator.results.metric import Direction
from gpusimbench.schemas.text import plural

_LINES, _NOTES = 5, 2
"""Changes and notes that the short text lists."""

_TONES = {Change.REGRESSION: Tone.BAD, Change.CHANGED: Tone.WARNING, Change.IMPROVEMENT: Tone.GOOD}
_TITLE = "What changed, and when"
_LEAD = "Points are in the order of the earliest start time of their recordings; a label is the name of a folder."
_METHOD = (
    "A change point is a place where the mean of a quantity's points changes: circular binary segmentation, a "
    "t-test of points with Bonferroni's bound for all places. Points are the unit, not runs, so differences from "
    "one recording session to the next count as noise. Chance of any false alarm among all curves: at most {alpha}, "
    "if points without a change are independent and normally distributed."
)
_FACTS = (
    "Facts have no p: bits, runs that fail, or values that are equal in all runs of a point. Other changes have none "
    "where the points of each level are equal: nothing shows how much points differ by chance."
)


def short(history: History) -> Document:
    """At most fifteen lines: the verdict, the newest changes, what was left out."""
    counting = [event for event in history.events if event.change is not Change.SMALL]
    shown = [Item(_line(event, history), _tone(event)) for event in counting[:_LINES]]
    more = [f"{len(counting) - _LINES} more changes"] if len(counting) > _LINES else []
    if small := len(history.events) - len(counting):
        more.append(f"{plural(small, 'difference')} too small to count")
    notes = [Item(f"note: {note}", Tone.QUIET) for note in history.notes[:_NOTES]]
    if (rest := len(history.notes) - _NOTES) > 0:
        notes.append(Item(f"note: {rest} more", Tone.QUIET))
    tail = f"{'; '.join([*more, ''])}--all prints every curve, --html FILE draws them"
    return Document("", (_verdict(history), Items((*shown, *notes, Item(tail, Tone.QUIET)))))


def full(history: History, command: str = "") -> Document:
    """Everything, for a page and for --all."""
    blocks: list[Block] = [_verdict(history)]
    if history.events:
        blocks.append(_changes(history))
    if history.undecided:
        told = (
            f"{one.series.heading}, {one.series.device}: {title} ({axis.value}): {why}"
            for one, axis, title, why in history.undecided
        )
        blocks.append(Section("undecided", "Not decided", (items(*told),)))
    if left := [*history.notes, *(f"{label}: {one.error}" for label, one in history.unreadable)]:
        blocks.append(Section("notes", "Split or left out", (items(*left),)))
    keys = _keys(history)
    blocks += [_section(one, key, history) for one, key in zip(history.traced, keys, strict=True)]
    blocks.append(
        Section("points", "Points in time", (_points(history),), plural(len(history.points), "point"), folded=True)
    )
    alpha = f"{history.settings.alpha * 100:.3g} %"
    made_by = (Text(_METHOD.format(alpha=alpha), Tone.QUIET), Text(_FACTS, Tone.QUIET))
    return Document(
        _TITLE, tuple(blocks), lead=_LEAD, made_by=(*made_by, *((Code((command,)),) if command else ()))
    )  # fmt: skip


def _verdict(history: History) -> Text:
    worse = any(e.change in FAILING and e.point == history.newest for e in history.events)
    return Text(words.headline(history), Tone.BAD if worse or history.failing else Tone.PLAIN)


def _line(event: Event, history: History) -> str:
    told = words.said(event, history)
    return f"{told} [{event.traced.series.heading}]" if len(history.traced) > 1 else told


def _tone(event: Event) -> Tone:
    return _TONES.get(event.change, Tone.PLAIN)


def _changes(history: History) -> Table:
    keys = dict(zip(map(id, history.traced), _keys(history), strict=True))
    rows: list[list[Cell | str]] = [
        [
            history.points[event.point].label,
            Cell(event.traced.series.heading, notes=(event.traced.series.device,), link=keys[id(event.traced)]),
            event.title,
            Cell(words.verdict(event), tone=_tone(event)),
            words.amount(event),
            _p_value(event),
        ]
        for event in history.events
    ]
    columns = ("point", "configuration", "quantity", "verdict", "by how much", "p")
    return table("changes", "Changes, those of the newest points first", columns, rows)


def _p_value(event: Event) -> Cell:
    p = event.shift.p_value if event.shift else FACT
    if isinstance(p, Missing):
        return Cell("fact" if p is FACT else "none", tone=Tone.QUIET)
    return Cell(f"{p:.2g}" if p >= 1e-12 else "< 1e-12", p)


def _keys(history: History) -> list[str]:
    return [key_of("series", number, one.series.label) for number, one in enumerate(history.traced, start=1)]


def _section(one: Traced, key: str, history: History) -> Section:
    counting = sum(c.shifts[i].change is not Change.SMALL for c in one.curves for i in range(len(c.shifts)))
    counting += sum(fact.finding.change is not Change.SMALL for fact in one.facts)
    changed, steady = (
        tuple(_figure(curve, one, key, history) for curve in one.curves if curve.varies and _counts(curve) is moved)
        for moved in (True, False)
    )
    blocks: list[Block] = [Gallery(changed, 30.0)] if changed else []
    if one.curves:
        blocks.append(_quantities(one, key, history))
    if one.facts:
        blocks.append(items(*(Item(_fact(event, history), _tone(event)) for event in _facts(one, history))))
    if steady:
        said = plural(len(steady), "curve")
        drawn = (Gallery(steady, 30.0),)
        blocks.append(Section(f"{key}-steady", "Quantities without a change that counts", drawn, said, folded=True))
    entries = one.series.entries
    summary = f"{one.series.device}: {plural(len(entries), 'point')}, {plural(counting, 'change')}"
    return Section(
        key, one.series.heading, tuple(blocks), summary, folded=not counting,
        facets={"simulator": one.series.key.simulator, "scene": one.series.key.scene, "device": one.series.device},
    )  # fmt: skip


def _facts(one: Traced, history: History) -> list[Event]:
    return [event for event in history.events if event.traced is one and event.finding]


def _fact(event: Event, history: History) -> str:
    note = words.note(event.finding) if event.finding else ""
    return f"{words.said(event, history)}{f' ({note})' if note else ''}"


def _quantities(one: Traced, key: str, history: History) -> Table:
    rows: list[list[Cell | str]] = [
        [
            curve.metric.titled,
            str(len(curve.known)),
            _value(curve.known[0] if curve.known else None, curve),
            _value(curve.known[-1] if curve.known else None, curve),
            _shifts(curve, history),
            curve.changes_missing or (words.visible(curve) or NONE if curve.tested else "any"),
        ]
        for curve in one.curves
    ]
    columns = (
        "quantity",
        "points",
        "first value",
        "newest value",
        "changes",
        "smallest change visible at the next point",
    )
    return table(f"{key}-quantities", "", columns, rows)


def _value(sample: Sample | None, curve: Curve) -> Cell:
    if sample is None or isinstance(sample.value, Missing):
        return EMPTY
    unit = curve.metric.unit
    span = bounds(sample.ci95, lambda end: figure(end, unit)) if sample.ci95 else ""
    return Cell(figure(sample.value, unit), sample.value, sample.ci95, span)


def _shifts(curve: Curve, history: History) -> Cell:
    told = tuple(f"{history.points[s.point].label}: {_ratio(s, curve)} ({s.change.value})" for s in curve.shifts)
    return Cell(told[0], notes=told[1:]) if told else Cell("none", tone=Tone.QUIET)


def _ratio(shift: Shift, curve: Curve) -> str:
    unit = curve.metric.unit
    return words.percent(shift.ratio) if shift.ratio is not None else f"to {figure(shift.after, unit)} {unit}".strip()


def _figure(curve: Curve, one: Traced, key: str, history: History) -> Figure:
    names = [point.label for point in history.points]
    dots = list(_dots(curve, names))
    marks = [Mark(s.point, f"{_ratio(s, curve)} at {names[s.point]}", s.change in FAILING) for s in curve.shifts]
    marks.sort(key=lambda mark: mark.at)
    drawn = history_chart(
        dots, names, value=curve.metric.titled, tick=lambda v: f"{v:,.10g}", marks=marks, levels=_levels(curve)
    )
    better = "" if curve.metric.direction is Direction.NEITHER else f", {curve.metric.direction.value} is better"
    rows = [
        (names[s.point], None if isinstance(s.value, Missing) else s.value, *(s.ci95 or (None, None)), s.n)
        for s in curve.samples
    ]
    return Figure(
        f"{curve.metric.titled}{better}",
        " ".join([f"{curve.metric.method}.", *_legend(curve)]),
        Markup(drawn),
        key=f"{key}-{curve.metric.name}",
        numbers=Numbers(("point", curve.metric.titled, "95 % low", "95 % high", "runs"), rows),
        about=one.series.heading,
    )  # fmt: skip


def _counts(curve: Curve) -> bool:
    return any(shift.change is not Change.SMALL for shift in curve.shifts)


def _legend(curve: Curve) -> list[str]:
    """What is drawn beside the points of a curve."""
    said = []
    if any(sample.ci95 for sample in curve.known):
        said.append("Bars: 95 % intervals of a point's runs.")
    if _levels(curve):
        said.append("Dashed: levels between changes.")
    return said


def _dots(curve: Curve, names: Sequence[str]) -> Iterator[Dot]:
    for sample in curve.known:
        assert not isinstance(sample.value, Missing)
        low, high = sample.ci95 or (None, None)
        told = f"{names[sample.point]}: {figure(sample.value, curve.metric.unit)} {curve.metric.unit}".strip()
        yield Dot(sample.point, sample.value, low, high, f"{told}, {plural(sample.n, 'run')}")


def _levels(curve: Curve) -> list[Level]:
    """Levels between changes, in the unit; none where no change was found."""
    if not curve.shifts or curve.exact:
        return []
    places = [sample.point for sample in curve.known]
    firsts = [places[0], *(s.point for s in curve.shifts)]
    lasts = [*(s.previous for s in curve.shifts), places[-1]]
    values = [curve.shifts[0].before, *(s.after for s in curve.shifts)]
    return [Level(*one) for one in zip(firsts, lasts, values, strict=True)]


def _points(history: History) -> Table:
    versions: dict[int, dict[str, None]] = {}
    for one in history.traced:
        for entry in one.series.entries:
            if version := entry.group.key.version:
                told = f"{one.series.key.simulator} {version}"
                versions.setdefault(entry.point, {}).setdefault(told)
    rows: list[list[Cell | str]] = [
        [
            point.label,
            point.begins or NONE,
            Cell(str(len(point.runs)), float(len(point.runs))),
            Cell(str(len(point.unreadable)), float(len(point.unreadable))),
            ", ".join(versions.get(index, ())) or NONE,
        ]
        for index, point in enumerate(history.points)
    ]
    columns = ("point", "first run [UTC]", "recordings", "unreadable", "versions")
    return table("points-table", "", columns, rows)
