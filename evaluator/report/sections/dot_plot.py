"""Raw values of what is compared, each with its interval: a panel for every axis of a radar, and for mechanics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from markupsafe import Markup

from gpusimbench.evaluator.metrics.radar import LOWER_IS_BETTER, Axis
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.render.document import Figure, Numbers
from gpusimbench.evaluator.render.figures.axis import tick_label
from gpusimbench.evaluator.render.figures.dot_plot import Dot, dot_plot, is_logarithmic
from gpusimbench.evaluator.render.numbers import figure, interval
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.scaling import steps_label
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.metrics import on_radar
from gpusimbench.evaluator.results.ranking import Contender
from gpusimbench.evaluator.runs.physics.facts import NEWEST

_TITLES = ("group", "value", "low", "high", "note")
_MECHANICS = f"broken checks of mechanics, {NEWEST.value}"


def panels(contenders: tuple[Contender, ...]) -> list[Figure]:
    """A panel for every axis of a radar, and the last for mechanics; those without a value say why."""
    return [*_panels(contenders), _mechanics(contenders)]


def bars(contender: Contender) -> str:
    """Why a contender earns no pick; empty where nothing speaks against it."""
    return contender.figures.barred or contender.figures.barred_articulated


def _label(contender: Contender) -> str:
    return f"{contender.figures.name} †" if bars(contender) else contender.figures.name


def _panels(contenders: tuple[Contender, ...]) -> Iterator[Figure]:
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
        yield _picture(title, unit, dots, missing, larger=axis not in LOWER_IS_BETTER)


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
    return _picture(_MECHANICS, "checks", dots, missing, larger=False)


def _picture(what: str, unit: str, dots: list[Dot], missing: dict[str, list[str]], *, larger: bool) -> Figure:
    key = f"dots-{what.lower().replace(' ', '-')}"
    absent = _absent(missing)
    if not dots:
        return Figure(what, f"Nothing to show: {absent}.", None)
    tick = steps_label if unit in ("env-steps/s", "envs") else tick_label
    svg = dot_plot(dots, value=f"{what} [{unit}]", tick=tick, best_first=larger)
    rows = [(d.label, d.value, d.low, d.high, d.said) for d in dots]
    return Figure(what, _said(what, dots, absent, larger=larger), Markup(svg), key, Numbers(_TITLES, rows))


def _said(what: str, dots: list[Dot], absent: str, *, larger: bool) -> str:
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


def _absent(missing: dict[str, list[str]]) -> str:
    return "; ".join(f"{_few(names)} ({why})" for why, names in missing.items())


def _few(names: Iterable[str]) -> str:
    found = list(names)
    return ", ".join(found) if len(found) <= 3 else f"{len(found)} groups"
