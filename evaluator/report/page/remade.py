"""The published tables, made again from these recordings, in the paper's layout."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results import paper_tables as remade
from gpusimbench.evaluator.results import published
from gpusimbench.evaluator.results.clamped_metrics import SUFFIX
from gpusimbench.evaluator.results.cost_metrics import GPU_MEMORY
from gpusimbench.evaluator.results.determinism_cost import DEFAULT
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.published import AtLargest, Variability
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey

_SPEED = {"free-fall": 1e4, "franka": 1e6}
_EXPONENT = {"free-fall": 4, "franka": 6}
_GB = 1e9
_LEAST = 5e-3  # of a printed distance [cm]: two decimals round it to 0.00


@dataclass(frozen=True)
class Figure:
    """A value as the paper prints it, its interval, and what the printed digits hide; or why there is none."""

    value: str = ""
    interval: str = ""
    note: str = ""
    why_not: str = ""


@dataclass(frozen=True)
class CapabilityCell:
    """One simulator in one scene; `why_not` where there is no sweep."""

    at: remade.AtMax | None
    fps: Figure
    memory: Figure
    paper: AtLargest | None
    why_not: str = ""


@dataclass(frozen=True)
class VariabilityRow:
    """One group of the second table, with the paper's row of its simulator."""

    result: GroupResult
    real: Figure
    parallel: Figure
    run_to_run: Figure
    faults: Faults
    paper: Variability | None


def section(source: Source) -> Section | None:
    """None where nothing here is of the published scenes."""
    capability = remade.capability(source.evaluation.sweeps, source.evaluation.results)
    shown = [r for r in remade.variability(source.evaluation.results) if r in source.shown]
    # beside the default, if there is one: the paper tells of no other level, and others are folded away
    shown.sort(key=lambda r: r.group.key.determinism != DEFAULT)
    rows = [_row(r, source, first=_is_first(r, shown)) for r in shown]
    if not capability and not rows:
        return None
    paper = {r.simulator: r for r in published.SCALING} if source.published else {}
    default, others = [
        [r for r in rows if (r.result.group.key.determinism == DEFAULT) is which] for which in (True, False)
    ]
    context = {
        "capability": [(row, _settings(row.key), list(_cells(row, paper))) for row in capability],
        "scenes": remade.CAPABILITY_SCENES,
        "notes": [line for scene in remade.CAPABILITY_SCENES for line in _timed_remarks(capability, scene)],
        "exponents": _EXPONENT,
        "variability": default,
        "levels": others,
        "missing": _missing(source),
        "no_real": _no_real(source),
        "paper": source.published,
    }
    return Section("remade", "The published tables, re-made", context, link="Published tables, re-made")


def _timed_remarks(rows: Sequence[remade.Capability], scene: str) -> list[str]:
    # one point of each row stands for it
    found = {r.label: row.label for row in rows if scene in row.at and (r := row.at[scene].sweep.at_max)}
    results = [r for row in rows if scene in row.at and (r := row.at[scene].sweep.at_max)]
    lines = timed.remarks(results, named=lambda result: found[result.label])
    return [f"{scene}: {line}" for line in lines if line != timed.LEGEND]


def _settings(key: GroupKey) -> str:
    given = ", ".join(f"{name}={value}" for name, value in json.loads(key.options).items())
    level = "" if key.determinism == DEFAULT else f"determinism {key.determinism}"
    return "; ".join(part for part in (key.version or "no version", given, level, key.device) if part)


def _cells(row: remade.Capability, paper: dict[str, published.Scaling]) -> Iterator[CapabilityCell]:
    told = paper.get(published.NAMES.get(row.key.simulator, ""))
    for scene in remade.CAPABILITY_SCENES:
        foreign = None if told is None else told.free_fall if scene == "free-fall" else told.franka
        at = row.at.get(scene)
        if at is None:
            why_not = f"no sweep of {scene} among these recordings"
            yield CapabilityCell(None, Figure(), Figure(), foreign, why_not)
        else:
            yield CapabilityCell(at, _scaled(at.fps, 1 / _SPEED[scene], 3), _memory(at.memory), foreign)


def _memory(metric: Estimate | None) -> Figure:
    if metric is None:
        return _scaled(None, 1.0, 1)
    scale = metric.metric.per_unit / _GB
    found = _scaled(metric, scale, 1)
    if isinstance(metric.value, Missing) or metric.name == GPU_MEMORY[0]:
        return found
    if metric.name in GPU_MEMORY:
        return Figure(found.value, found.interval, "of the process: others were on the GPU")
    return Figure(found.value, found.interval, "of the host: it ran on the CPU")


def _scaled(metric: Estimate | None, scale: float, decimals: int) -> Figure:
    if metric is None:
        return Figure(why_not="no run is complete")
    if isinstance(metric.value, Missing):
        return Figure(why_not=metric.value.reason)
    value = f"{metric.value * scale:.{decimals}f}"
    note = f"{metric.value * scale:.2g}" if float(value) == 0 else ""
    if metric.ci95 is None:
        return Figure(value, _no_interval(metric), note)
    low, high = (f"{end * scale:.{decimals}f}" for end in metric.ci95)
    return Figure(value, f"[{low}, {high}]", note)


def _no_interval(metric: Estimate) -> str:
    if metric.n == 1:
        return "one run"
    return words.why_no_interval(metric, "no interval")


def _is_first(result: GroupResult, shown: list[GroupResult]) -> bool:
    return next(r for r in shown if r.group.key.simulator == result.group.key.simulator) is result


def _no_real(source: Source) -> str:
    """Why no group has a distance to real trials; empty where some has."""
    reference = source.evaluation.reference
    if reference is None:
        return source.evaluation.reference_note
    return "" if reference.measured else "the reference is another simulation, not measured"


def _row(result: GroupResult, source: Source, *, first: bool) -> VariabilityRow:
    name = published.NAMES.get(result.group.key.simulator)
    beside = source.published and first
    told = next((r for r in published.VARIABILITY if r.simulator == name), None) if beside else None
    real, parallel, between = (result.metrics[n] for n in ("w1_real", "w1_parallel", "w1_run_to_run"))
    distance = Figure("–") if _no_real(source) else _printed(real, 3)
    printed = [_beside(_printed(metric, 2), result, metric) for metric in (parallel, between)]
    return VariabilityRow(result, distance, printed[0], printed[1], faults(result), told)


def _beside(figure: Figure, result: GroupResult, metric: Estimate) -> Figure:
    """With what the value is without the flight of cubes that left the board."""
    fell, clamped = (known(result.metrics[name].value) for name in ("left_board", metric.name + SUFFIX))
    if not fell or clamped is None:
        return figure
    said = f"clamped to the board: {numbers.distance(clamped)}; {numbers.figure(fell, '')} cubes off it per env"
    return replace(figure, note="; ".join(part for part in (figure.note, said) if part))


def _printed(metric: Estimate, decimals: int) -> Figure:
    """Mean and SD [cm] with the paper's decimals, and what those hide of a small value."""
    if isinstance(metric.value, Missing):
        return Figure(why_not=metric.value.reason)
    value = f"{metric.value:.{decimals}f}"
    if metric.sd is not None:
        value += f" ± {metric.sd:.{decimals}f}"
    note = ""
    if metric.value < _LEAST:
        note = "exactly 0" if metric.value == 0 else f"not 0: {numbers.distance(metric.value)}"
    interval = numbers.interval(metric) if metric.ci95 else "" if metric.value == 0 else _no_interval(metric)
    return Figure(value, interval, note)


def _missing(source: Source) -> list[str]:
    """The paper's simulators of which nothing is here."""
    there = {r.group.key.simulator for r in source.evaluation.results if r.group.complete}
    return [name for simulator, name in published.NAMES.items() if simulator not in there]
