"""How environments, and runs, come apart: since which step, how fast, and which left which; and environments in motion,
coloured by which of them are bit-identical so far."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, first_reaching
from gpusimbench.evaluator.metrics.identity import SplitTree
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.player.page import markup, script, style
from gpusimbench.evaluator.render.document import (
    EMPTY,
    Block,
    Cell,
    Column,
    Embed,
    Figure,
    Item,
    Items,
    Numbers,
    Section,
    Table,
    Text,
    Tone,
)
from gpusimbench.evaluator.render.figures import divergence as chart
from gpusimbench.evaluator.render.figures.tree import members, tree_chart, window
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, of_groups, with_lines, without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.details import DistinctEnvs, DistinctRuns
from gpusimbench.evaluator.results.result import GroupResult, RunSpread
from gpusimbench.schemas.text import plural

_MM = 1e3
_UNKNOWN = "not known: "
_BRANCHES = ("lowest", "left", "at step", "simulated time [s]", "left together", "stayed together", "that stayed")

_PLAYED = (
    "Environments of a group over simulated time, all its complete runs together. Environments whose states were "
    "bit-identical at every step so far have one colour: colours split where bits split. One environment of each class "
    "is shown, those that split off first; groups that part first come first. Groups that only "
    "gsb-probe needs are left out."
)


@dataclass(frozen=True)
class Onset:
    """One group's row: since when anything differs, and how it grows.

    envs, runs  first step and time at which the first bit differs; "never", or why it is not known
    doubling    median time in which the largest distance doubles [s], or a dash with the reason in `no_doubling`
    to_1mm      earliest time of a run at which it reaches 1 mm, or 1 mrad of hinges [s]; a dash where it never does
    """

    result: GroupResult
    envs: str
    runs: str
    doubling: str
    no_doubling: str
    to_1mm: str


def section(source: Source) -> Section | None:
    """A row for every group whose states were captured; figures for those in which anything came apart."""
    told = [r for r in source.shown if not _first(r, "distinct_envs").startswith(_UNKNOWN) or _spreads(r)]
    if not told:
        return None
    onsets = [onset(r) for r in told]
    how = Text(
        "How far two runs lie apart at each step cannot be told from one file at a time: gsb-diff A B reads both files "
        "and gives it."
    )
    blocks: tuple[Block, ...] = (_table(source, onsets), how)
    return Section("divergence", "How environments and runs come apart", blocks, _summary(onsets), folded=True)


def _summary(onsets: Sequence[Onset]) -> str:
    envs, runs = (sum(getattr(one, of).startswith("step") for one in onsets) for of in ("envs", "runs"))
    if not envs and not runs:
        return f"nothing comes apart in {plural(len(onsets), 'group')}, as far as bits were compared"
    return f"of {plural(len(onsets), 'group')}, environments come apart in {envs} and runs in {runs}"


def _table(source: Source, onsets: Sequence[Onset]) -> Table:
    units = sorted({s.spread.unit for one in onsets for s in one.result.spreads if s.spread} or {"m"})
    found = {one.result.label: one for one in onsets}
    limit, reasons = " or ".join(f"{FIT_LIMIT_M * _MM:g} m{unit}" for unit in units), Reasons()
    columns = [
        _first_column("envs", "; the first of all runs", found, reasons),
        _first_column("runs", "", found, reasons),
    ]
    columns += [
        (
            Column("distance doubles in [s]", f"median over runs, of the largest distance while it is below {limit}"),
            lambda r: _doubling(found[r.label], reasons),
        ),
        (
            Column(f"envs {limit} apart by [s]", "first recorded state of any run at which they are; perhaps earlier"),
            lambda r: _number(found[r.label].to_1mm),
        ),
    ]
    results = [one.result for one in onsets]
    made = of_groups(
        source, "divergence", "When environments and runs come apart", results, columns, reasons,
        more=lambda r: with_lines(pictures(source, r)),
    )  # fmt: skip
    return replace(made, opened="An opened row shows how its environments and runs came apart.")


def _first_column(of: str, which: str, found: Mapping[str, Onset], reasons: Reasons) -> tuple[Column, Written]:
    meaning = f"by hashes of the whole state at every captured step{which}"
    return Column(f"{of}: first bit differs", meaning), lambda r: _first_cell(getattr(found[r.label], of), reasons)


def _doubling(found: Onset, reasons: Reasons) -> Cell:
    return reasons.cell(found.no_doubling) if found.doubling == NONE else _number(found.doubling)


def _first_cell(said: str, reasons: Reasons) -> Cell:
    if said.startswith(_UNKNOWN):
        return reasons.cell(said.removeprefix(_UNKNOWN), "not known")
    return Cell(said, tone=Tone.GOOD if said == "never" else Tone.BAD)


def _number(said: str) -> Cell:
    return EMPTY if said == NONE else Cell(said, float(said))


def _spreads(result: GroupResult) -> list[RunSpread]:
    return [s for s in result.spreads if s.spread]


def onset(result: GroupResult) -> Onset:
    """When anything differs in a group."""
    rate = result.metrics["divergence_rate"]
    reached = [t for s in _spreads(result) if (t := _reaches(s)) is not None]
    return Onset(
        result,
        _first(result, "distinct_envs"),
        _first(result, "distinct_runs"),
        words.doubling(rate),
        why_missing(rate.value),
        f"{min(reached):g}" if reached else NONE,
    )


def _first(result: GroupResult, name: str) -> str:
    metric = result.metrics[name]
    if isinstance(metric.value, Missing):
        return f"{_UNKNOWN}{metric.value.reason}"
    details = _distinct(result, name)
    if details.timed_steps:
        return f"{_UNKNOWN}no states were captured"
    step = details.first_difference_step
    return "never" if step is None else f"step {step}, {step * result.group.key.dt:g} s"


def _distinct(result: GroupResult, name: str) -> DistinctEnvs | DistinctRuns:
    details = result.metrics[name].details
    return details if isinstance(details, DistinctEnvs | DistinctRuns) else DistinctRuns()


def _reaches(found: RunSpread) -> float | None:
    if not found.spread:
        return None
    return first_reaching(np.array(found.spread.times), _values(found.spread.largest), FIT_LIMIT_M)


def _values(found: Sequence[float | None]) -> NDArray[np.float64]:
    return np.array([np.nan if v is None else v for v in found])


def pictures(source: Source, result: GroupResult) -> list[Figure]:
    """Growth and trees of a group; none where nothing came apart."""
    number = source.evaluation.results.index(result)
    growth = _growth(result, f"divergence-{number}")
    trees = [_tree(result, of, f"tree-{of}s-{number}") for of in ("env", "run")]
    if growth.svg or any(tree is not None and tree.svg for tree in trees):
        return [growth, *(tree for tree in trees if tree is not None)]
    return []


def _growth(result: GroupResult, key: str) -> Figure:
    label = "distance between environments"
    curves = list(_curves(result))
    if not curves:
        why_not = why_missing(result.spreads[0].spread) if result.spreads else "no run is complete"
        return Figure(label, f"No curve: {why_not}.", None)
    step = _distinct(result, "distinct_envs").first_difference_step
    onset = None if step is None else step * result.group.key.dt
    unit, what = _followed(result)
    svg = chart.divergence_chart(curves, onset=onset, name=result.label, unit=unit)
    if not svg:
        differs = "recorded position" if what == "body" else "coordinate of a joint"
        return Figure(label, f"No curve: no {differs} differs between environments.", None)
    rows = [
        (c.label, *(round(float(v), 12) if np.isfinite(v) else None for v in (c.times[i], c.largest[i], c.rms[i])))
        for c in curves
        for i in chart.shown_rows(c)
    ]
    return Figure(label, _caption(result, curves), Markup(svg), key, Numbers(_columns(unit), rows), _about(result))


def _columns(unit: str) -> tuple[str, ...]:
    return ("run", "simulated time [s]", f"largest distance [{unit}]", f"rms distance [{unit}]")


def _followed(result: GroupResult) -> tuple[str, str]:
    """The unit of the distances of a group, and what they are of."""
    first = next((s.spread for s in result.spreads if s.spread), None)
    return ("m", "body") if first is None or first.bodies else (first.unit, "joint")


def _about(result: GroupResult) -> str:
    return f"{result.label}, {result.group.key.scene}"


def _curves(result: GroupResult) -> Iterator[chart.Curve]:
    """One for all runs whose distances are the same."""
    alike: dict[tuple[object, ...], list[RunSpread]] = {}
    for one in _spreads(result):
        assert one.spread
        alike.setdefault((one.spread.steps, one.spread.largest, one.spread.rms), []).append(one)
    for index, found in enumerate(alike.values()):
        spread = found[0].spread
        assert spread
        fit = spread.fit if spread.fit and not spread.fit.why_no_rate else None
        runs = f"run{'s' if len(found) > 1 else ''} {', '.join(str(one.run) for one in found)}"
        times = np.array(spread.times)
        yield chart.Curve(index, runs, times, _values(spread.largest), _values(spread.rms), fit)


def _caption(result: GroupResult, curves: Sequence[chart.Curve]) -> str:
    what = _followed(result)[1]
    points = len(curves[0].times)
    thick, thin = ("Filled", "Open") if points < chart.LINE_FROM else ("Thick", "Thin")
    said = [
        f"{thick}: the largest distance of a {what} from where it is in environment 0. {thin}: root mean square, all "
        "pairs."
    ]
    fits = [c for c in curves if c.fit]
    if fits and fits[0].fit:
        one = fits[0].fit
        doubling = f", doubling in {one.doubling_time:.2g} s" if one.doubling_time else ""
        said.append(
            f"Dashed: the exponential through {fits[0].label}, {one.rate:.3g} per s{doubling}, fitted in the shaded "
            f"window from {one.begin_s:g} to {one.end_s:g} s (R² {one.r_squared:.2f}, {one.n_point} points)."
        )
    elif points < chart.LINE_FROM:
        said.append(f"States were recorded at {plural(points, 'step')}: too few for a line, and for a growth rate.")
    elif why_not := why_missing(result.metrics["divergence_rate"].value):
        said.append(f"No growth rate: {why_not.removeprefix('no rate: ')}.")
    if fallen := max(s.spread.fallen for s in _spreads(result) if s.spread):
        said.append(f"Without bodies that fell off the board, unless none is left to compare: up to {fallen} in a run.")
    return " ".join(said)


def _tree(result: GroupResult, of: str, key: str) -> Figure | None:
    metric = result.metrics[f"distinct_{of}s"]
    details = _distinct(result, f"distinct_{of}s")
    tree = details.tree
    runs = [r.configuration.run_index for r in result.group.complete]
    label = "environments" + (f" of run {runs[0]}" if of == "env" and runs else "") if of == "env" else "runs"
    if tree is None:
        why_not = why_missing(metric.value)
        return Figure(label, f"No tree: {why_not}.", None) if why_not else None
    names = details.run_indices if isinstance(details, DistinctRuns) else range(len(details.classes[0]))
    dt = result.group.key.dt
    svg = tree_chart(tree, dt=dt, of=of, names=names, label=result.label)
    if not svg:
        return Figure(label, f"No tree: no two {of}s differ in any bit.", None)
    rows = [
        (
            names[b.sample], "" if b.parent is None else names[tree.branches[b.parent].sample], b.step, b.step * dt,
            b.left, b.stayed, members(b, of, names),
        )
        for b in tree.branches
    ]  # fmt: skip
    about = f"{_about(result)}, which left which"
    return Figure(label, _tree_said(tree, dt), Markup(svg), key, Numbers(_BRANCHES, rows), about)


def _tree_said(tree: SplitTree, dt: float) -> str:
    first, last = tree.branches[1].step, tree.branches[-1].step
    begin, end = window(tree)
    when = f"at step {first}" if first == last else f"between steps {first} and {last}"
    said = f"{len(tree.branches) + tree.not_kept} histories, which split {when} of {tree.last_step}."
    if end - begin < tree.last_step - tree.first_step:
        said += f" The axis covers {begin * dt:.3g} to {end * dt:.3g} s: nothing splits before or after."
    if tree.not_kept:
        said += f" {tree.not_kept} branches that left later are not drawn."
    return said


def playback(source: Source) -> Section | Missing | None:
    """None where playback was not asked for or nothing was captured, Missing where no group can be shown."""
    found = source.playback
    if found is None or not (found.clips or found.not_shown):
        return None
    if not found.clips:
        return without("Playback", (f"{'; '.join(one.labels)}: {one.reason}" for one in found.not_shown))
    blocks: list[Block] = [Text(_PLAYED), Embed(markup(found.clips), Markup(style()), Markup(script()))]
    if found.not_shown:
        not_shown = tuple(Item(f"{'; '.join(one.labels)}: {one.reason}") for one in found.not_shown)
        blocks.append(Section("not-played", "Not shown", (Items(not_shown),)))
    return Section("playback", "Playback", tuple(blocks), f"{plural(len(found.clips), 'group')} to watch", folded=True)
