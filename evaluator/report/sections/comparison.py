"""Simulators under the same conditions: dot plots of the raw values, the radar, and which is the best for each need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from markupsafe import Markup

from gpusimbench.evaluator.metrics.guidelines import Guideline
from gpusimbench.evaluator.metrics.radar import LOWER_IS_BETTER, Axis, Radar
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Column,
    Figure,
    Gallery,
    Item,
    Items,
    Numbers,
    Row,
    Section,
    Table,
    Text,
    Tone,
    table,
)
from gpusimbench.evaluator.render.figures import radar_chart
from gpusimbench.evaluator.render.figures.dot_plot import Dot, dot_plot, is_logarithmic
from gpusimbench.evaluator.render.figures.plot import tick_label
from gpusimbench.evaluator.render.numbers import figure, interval
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.rows import Reasons, absences, facets, footnotes, lines_of, to_compare
from gpusimbench.evaluator.report.sections.scaling import steps_label
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.verdicts import for_probe
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.metrics import on_radar
from gpusimbench.evaluator.results.ranking import Contender
from gpusimbench.evaluator.runs.labels import options_given, row_names
from gpusimbench.evaluator.runs.physics.facts import NEWEST
from gpusimbench.schemas.text import few, plural

_TITLES = ("group", "value", "low", "high", "note")
_MECHANICS = f"broken checks of mechanics, {NEWEST.value}"
_NO_INTERVALS = (_MECHANICS, Axis.PARALLELISM.value)
_OF_SWEEPS = (Axis.THROUGHPUT, Axis.PARALLELISM, Axis.MEMORY)
_PLACES = 3  # that a caption names


def _bars(contender: Contender) -> str:
    """Why a contender must not be picked; empty if it may be."""
    return contender.figures.barred or contender.figures.barred_articulated


def _label(contender: Contender) -> str:
    return f"{contender.figures.name} †" if _bars(contender) else contender.figures.name


def _place(contenders: Sequence[Contender], *, swept: bool) -> str:
    """Scene, device and size of what an axis compares; all contenders share them, or have a sweep each."""
    if swept and any(c.sweep for c in contenders):
        keys, size = [c.sweep.key for c in contenders if c.sweep], "each simulator at its own N_env^max"
    else:
        keys = [r.group.key for c in contenders if (r := c.group or c.speed)]
        size = few([plural(n, "env", spec=",") for n in dict.fromkeys(key.n_env for key in keys)], _PLACES)
    places = dict.fromkeys(f"{key.scene} on {key.device}" if key.device else key.scene for key in keys)
    return ", ".join(filter(None, (few(list(places), _PLACES), size)))


def panels(contenders: tuple[Contender, ...]) -> Iterator[Figure]:
    """A panel for every axis of a radar, and a last panel for mechanics; contenders without a value have the reason."""
    for axis in Axis:
        dots, missing = [], dict[str, list[str]]()
        for index, contender in enumerate(contenders):
            dot = _dot(index, contender, axis)
            if dot is None:
                why = why_missing(contender.metrics.get(axis)) or "it was not measured"
                missing.setdefault(why, []).append(contender.figures.name)
            else:
                dots.append(dot)
        shown = on_radar(axis)
        title, unit = (shown.title, shown.unit) if shown else (axis.value, "envs")
        about = _place(contenders, swept=axis in _OF_SWEEPS)
        yield _picture(title, unit, dots, missing, about, larger=axis not in LOWER_IS_BETTER)
    yield _mechanics(contenders)


def _dot(index: int, contender: Contender, axis: Axis) -> Dot | None:
    name = _label(contender)
    if axis is Axis.PARALLELISM:
        if contender.sweep is None or contender.sweep.n_max is None:
            return None
        sweep, n_max = contender.sweep, contender.sweep.n_max
        following = next((p.n_env for p in sweep.points if p.n_env > n_max), None)
        said = f"{name}: {n_max:,}; {sweep.ends}"
        if following is None:
            return Dot(index, name, float(n_max), open=True, said=said)
        return Dot(index, name, float(n_max), float(n_max), float(following), said=said)
    metric = contender.metrics.get(axis)
    if not metric or isinstance(metric.value, Missing):
        return None
    low, high = metric.ci95 or (None, None)
    why_not = (
        ""
        if metric.ci95
        else f", no interval: {words.why_no_interval(metric, 'one run' if metric.n == 1 else 'none was computed')}"
    )
    said = (
        f"{name}: {figure(metric.value, metric.unit)} {metric.unit} {interval(metric) if metric.ci95 else ''}{why_not}"
    )
    return Dot(index, name, metric.value, low, high, said=said)


def _mechanics(contenders: tuple[Contender, ...]) -> Figure:
    dots, missing = [], dict[str, list[str]]()
    for index, contender in enumerate(contenders):
        name = _label(contender)
        found = contender.group.fidelity if contender.group else None
        if found is None or not found.rows:
            why_not = found.checks_missing if found else "no group of it ran under the shared conditions"
            missing.setdefault(why_not, []).append(name)
            continue
        broken = found.of(CheckVerdict.BROKEN)
        said = ", ".join(row.check.title for row in broken) or f"all {found.held} that could be made hold"
        dots.append(Dot(index, name, float(len(broken)), said=f"{name}: {said}"))
    return _picture(_MECHANICS, "checks", dots, missing, _place(contenders, swept=False), larger=False)


def _picture(
    what: str, unit: str, dots: list[Dot], missing: dict[str, list[str]], about: str, *, larger: bool
) -> Figure:
    key = f"dots-{what.lower().replace(' ', '-')}"
    absent = absences(missing)
    if not dots:
        return Figure(what, f"Nothing to show: {absent}.", None)
    tick = steps_label if unit in ("env-steps/s", "envs") else tick_label
    svg = dot_plot(dots, value=f"{what} [{unit}]", tick=tick, best_first=larger)
    rows = [(d.label, d.value, d.low, d.high, d.said) for d in dots]
    whiskers = what not in _NO_INTERVALS and any(d.low is not None for d in dots)
    reading = "Whiskers are 95 % intervals over runs." if whiskers else ""
    caption = _read(what, dots, absent, larger=larger)
    return Figure(what, caption, Markup(svg), key, Numbers(_TITLES, rows), about, reading)


def _read(what: str, dots: list[Dot], absent: str, *, larger: bool) -> str:
    said = [f"{'Larger' if larger else 'Smaller'} is better; best on top."]
    if is_logarithmic(dots):
        said.append("Logarithmic axis.")
    zeros = sum(d.value == 0 for d in dots)
    if zeros:
        said.append(f"Open circle: exactly 0 ({zeros}).")
    if what == Axis.PARALLELISM.value:
        said.append("Whisker: up to the next number that was tried, where no run was complete. Arrow: none failed.")
    elif what != _MECHANICS and (alone := sum(d.low is None and d.value > 0 for d in dots)):
        said.append(f"No whisker, no interval ({alone}): too few runs, or none that differ.")
    if absent:
        said.append(f"Not here: {absent}.")
    return " ".join(said)


_RADAR_CAPTION = (
    "Rim: the best of these groups. Middle: the worst of them. The scale is relative: another set of groups gives "
    "another picture. An outline is open at an axis without a value. Where all groups are equal they stand at the rim."
)

_HOW = (
    "Raw values, a dot for each group that can be compared, with 95 % intervals over runs. A radar scales its axes "
    "from the worst to the best of its groups; these axes are not scaled."
)


def _axis_title(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.title if shown else axis.value


def _axis_unit(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.unit if shown else "log2 of environments"


def _radar_figure(contenders: Sequence[Contender], radar: Radar) -> Figure:
    """The radar with the values that it scales; without a drawing where outlines could not be told apart."""
    rows = [
        (c.figures.name, _axis_title(axis), value, _axis_unit(axis), radar.values[c.figures.name][axis],
         why_missing(c.metrics.get(axis)) if value is None else "")
        for c in contenders for axis, value in c.figures.axis_values().items()
    ]  # fmt: skip
    titles = ("group", "axis", "value", "unit", "scaled: 1 is the best of these, 0 the worst", "why there is no value")
    title = "Six axes, scaled over these groups"
    if len(radar.values) > radar_chart.AT_MOST:
        why_not = (
            f"No radar: {len(radar.values)} groups are compared, and more than {radar_chart.AT_MOST} outlines cannot "
            "be told apart. The dot plots show the same values with intervals."
        )
        return Figure(title, why_not, None)
    svg = Markup(radar_chart.radar_chart(radar))
    about = _place(contenders, swept=True)
    return Figure(title, _RADAR_CAPTION, svg, "radar", Numbers(titles, rows), about)


def section(source: Source) -> Section | None:
    """None where fewer than two simulators ran under the same conditions."""
    compared = source.evaluation.comparison
    if compared.radar is None:
        return None
    contenders, names = _as_in_tables(source, compared.contenders)
    scaled = replace(compared.radar, values={names[name]: found for name, found in compared.radar.values.items()})
    drawn = [*panels(contenders)]
    barred = lines_of([(f"† not recommended: {why}", c.figures.name) for c in contenders if (why := _bars(c))])
    empty = [Item(f"{one.label}: {one.caption}") for one in drawn if not one.svg]
    blocks: list[Block] = [Text(_HOW), Gallery(tuple(one for one in drawn if one.svg), 20)]
    blocks += [barred] if barred else []
    blocks += [Items(tuple(empty))] if empty else []
    blocks += [
        Section(
            "radar",
            "Radar",
            (_radar_figure(contenders, scaled), _values(contenders, scaled)),
            "the same values on six axes, scaled over these groups",
            folded=True,
        )
    ]
    called = {c.speed.label: c.figures.name for c in contenders if c.speed}
    notes = timed.remarks((c.speed for c in contenders if c.speed), named=lambda r: called[r.label])
    notes += footnotes(source, (r for c in contenders if (r := c.group or c.speed)))
    if notes:
        blocks.append(to_compare("comparison", notes))
    return Section(
        "comparison", "Simulators compared, with intervals", tuple(blocks), _summary(contenders), folded=True
    )


def _as_in_tables(source: Source, contenders: Sequence[Contender]) -> tuple[tuple[Contender, ...], dict[str, str]]:
    """Those that are shown, named as tables name their groups; and these names by those that they have elsewhere.

    Groups that only gsb-probe needs are left out: they are other runs of what is compared.
    """
    results = [(c, c.group or c.speed) for c in contenders]
    keys = [r.group.key for _, r in results if r]
    marks = [source.marks.get(r.footnotes, "") for _, r in results if r]
    given = options_given(run for _, r in results if r for run in r.group.recordings)
    named = iter(row_names(keys, given, marks))
    names = {c.figures.name: next(named) if r else c.figures.name for c, r in results}
    if len(set(names.values())) < len(names):  # two devices or sizes
        names = {name: name for name in names}
    shown = [c for c, r in results if not (r and for_probe(r))]
    kept = shown if len(shown) > 1 else contenders
    return tuple(replace(c, figures=replace(c.figures, name=names[c.figures.name])) for c in kept), names


def _summary(contenders: Sequence[Contender]) -> str:
    barred = sum(bool(_bars(c)) for c in contenders)
    said = f"{len(contenders)} groups that ran under the same conditions"
    return f"{said}; {barred} of them {'is' if barred == 1 else 'are'} not recommended" if barred else said


def _values(contenders: Sequence[Contender], of: Radar) -> Table:
    reasons = Reasons()
    axes = [(axis, on_radar(axis)) for axis in Axis]
    columns = [
        Column("group"),
        *(
            Column(
                shown.titled if shown else axis.value, "below the value: scaled, 1 is the best of these, 0 the worst"
            )
            for axis, shown in axes
        ),
    ]
    rows = []
    for contender in contenders:
        values = contender.figures.axis_values()
        cells = [_contender_cell(contender)]
        for axis, shown in axes:
            value = values[axis]
            if value is None:
                cells.append(reasons.cell(why_missing(contender.metrics.get(axis)) or "it was not measured"))
                continue
            text = numbers.figure(value, shown.unit) if shown else f"{contender.figures.n_max:,}"
            cells.append(Cell(text, float(value), notes=(f"({of.values[contender.figures.name][axis]:.2f})",)))
        group = contender.group or contender.speed
        rows.append(Row(tuple(cells), facets(group.group.key) if group else {}))
    return table("radar", "Values behind the radar, and in brackets as it scales them", columns, rows, reasons.legend)


def _contender_cell(contender: Contender) -> Cell:
    notes = []
    if contender.sweep and contender.sweep.n_max is not None:
        notes.append(
            f"throughput and memory at {plural(contender.sweep.n_max, 'env', spec=',')} of {contender.sweep.key.scene}"
        )
    if contender.group:
        key = contender.group.group.key
        notes.append(f"distances at {plural(key.n_env, 'env')} of {key.scene}")
    if contender.speed:
        notes += timed.beside(contender.speed.timed)
    return Cell(contender.figures.name, notes=tuple(notes), tone=Tone.BAD if _bars(contender) else Tone.PLAIN)


_PICKED = (
    "Each pick follows from its rule and from these recordings, and from nothing else. INVALID runs, bodies that went "
    "through the floor, broken checks of mechanics and broken laws in closed form, in any scene, bar a pick, however "
    "good its figures are."
)
_MOST_NAMED = 6


def guidelines(source: Source) -> Section | None:
    """None where fewer than two simulators ran under the same conditions."""
    found = source.evaluation.comparison.guidelines
    if not found:
        return None
    shown = table(
        "guidelines",
        "The best simulator for each need",
        ["need, and the rule", "recommended, and the next best", "best first", "not recommended"],
        [(Cell(one.need, notes=(one.rule,)), _pick(one), _ranking(one), _others(one)) for one in found],
    )
    picked = sum(bool(one.pick) for one in found)
    said = f"a simulator is named for {picked or 'none'} of {plural(len(found), 'need')}"
    return Section("guidelines", "The best simulator for each need", (Text(_PICKED), shown), said, folded=True)


def _pick(one: Guideline) -> Cell:
    if isinstance(one.pick, Missing):
        return Cell("none", notes=(one.pick.reason,), tone=Tone.QUIET)
    following = (
        f"next: {one.runner_up}" if one.runner_up else f"no other {'is ranked' if one.unranked else 'qualifies'}"
    )
    return Cell(one.pick, notes=(following,), tone=Tone.GOOD)


def _ranking(one: Guideline) -> Cell:
    if not one.ranking:
        return Cell("-", tone=Tone.QUIET)
    first, *others = (f"{place}. {said}" for place, said in enumerate(one.ranking, start=1))
    return Cell(first, notes=tuple(others))


def _others(one: Guideline) -> Cell:
    first, *others = (*_not_picked(one), "-")
    return Cell(first, notes=tuple(others[:-1]), tone=Tone.QUIET)


def _not_picked(one: Guideline) -> Iterator[str]:
    yield from (f"qualifies too, not ranked: {said}" for said in one.unranked)
    for title, names in (("do not qualify", one.disqualified), ("lack a figure", one.unmeasured)):
        if names:
            yield f"{title}: {few(names, _MOST_NAMED)}"
    for said in one.barred:
        yield f"barred: {said}"
