"""Where everything comes from, and how every metric was computed: a folded part for each group, many by simulator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import (
    EMPTY,
    Block,
    Cell,
    Code,
    Facts,
    Item,
    Items,
    Row,
    Section,
    Table,
    Text,
    key_of,
    table,
)
from gpusimbench.evaluator.render.numbers import figure, interval, mean_sd
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import by_simulator, facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.configuration import TELLING
from gpusimbench.schemas.text import cut, first, in_ranges, plural

_DEPTH = 3
_PARTS = 20  # of a list of runs, and then "..."
_ROWS = 1000  # of a record of a stranger, and items of a list in it
_CHARACTERS = 10_000  # of a text in it
_Machines = dict[str, tuple[str, str]]
"""Label of the first group that was made at a place, and the key of the section that describes it, by the place."""

_TITLES = ("metric", "value", "unit", "95 % interval", "n", "better", "exactness", "method")


def section(source: Source) -> Section | None:
    """None where no group is left."""
    machines: _Machines = {}
    found = [(result, _of_group(number, result, machines)) for number, result in enumerate(source.evaluation.results)]
    if not found:
        return None
    said = f"machine, software, options and methods of {plural(len(found), 'group')}"
    return Section("provenance", "Provenance", by_simulator("provenance", found), said, folded=True)


def _of_group(number: int, result: GroupResult, machines: _Machines) -> Section:
    blocks = tuple(_blocks(number, result, machines))
    return Section(f"provenance-{number}", result.label, blocks, folded=True, facets=facets(result.group.key))


def _blocks(number: int, result: GroupResult, machines: _Machines) -> Iterator[Block]:
    key, recordings = result.group.key, result.group.recordings
    asked = {
        "simulator": key.simulator, "scene": key.scene, "envs": key.n_env, "dt [s]": key.dt, "seed": key.seed,
        "warm-up steps": key.warmup, "timed steps": key.timed_steps, "determinism": key.determinism,
        **{TELLING[name].title: TELLING[name].words(value) for name, value in key.settings},
        "options": recordings[0].configuration.options if recordings else {},
    }  # fmt: skip
    yield _records(number, "What was asked", asked)
    simulation = next((r.simulation for r in recordings if r.simulation), None)
    if simulation is None:
        yield Text("The runs ended before the engine said what it is.")
    else:
        told = {
            "version": simulation.version, "device": simulation.device, "between the clocks": simulation.timing_covers,
            "start of the capture phase": simulation.fresh_start, "scene": simulation.scene,
            **({"remarks": "; ".join(simulation.remarks)} if simulation.remarks else {}),
        }  # fmt: skip
        yield _records(number, "What the engine said", told)
        yield _records(number, "Options in force", simulation.options)
        yield _records(number, "Switches in force", simulation.switches)
    for index, (runs, recording) in enumerate(_origins(result)):
        yield _origin(f"{number}-{index}", runs, recording, result.label, machines)
    parts = (_methods(number, result), *_not_computed(result))
    yield Section(f"methods-{number}", "Every metric, and how it was computed", parts, folded=True)


def _origin(number: str, runs: str, recording: Run, label: str, machines: _Machines) -> Section:
    """Where some runs of a group were made: in full once, and by a link where it is the place of a group before."""
    title = f"Machine and software of {'run' if runs.isdecimal() else 'runs'} {runs}"
    key, place = key_of("machine", number, runs), _place(recording)
    parts: list[Block] = []
    if place in machines:
        before, its_key = machines[place]
        parts.append(Items((Item(f"The same as of {before}", link=its_key),)))
    else:
        machines[place] = (label, key)
        parts += _machine(number, recording)
    parts += [Text("Recorded by:"), Code((cut(" ".join(recording.provenance.argv), _CHARACTERS),))]
    return Section(key, title, tuple(parts))


def _machine(number: str, recording: Run) -> Iterator[Block]:
    found = recording.provenance
    yield _records(number, "Host", found.host)
    for index, gpu in enumerate(found.gpus):
        yield _records(number, f"GPU {index}", gpu)
    if not found.gpus:
        yield Text("No GPU.")
    yield _records(number, "Software", found.software)
    yield _records(number, "Environment variables", found.environment)


def _records(number: int | str, caption: str, record: Mapping[str, Any]) -> Section:
    rows = [(cut(name, _CHARACTERS), cut(value, _CHARACTERS)) for name, value in islice(_pairs(record), _ROWS + 1)]
    if len(rows) > _ROWS:
        rows = [*rows[:_ROWS], ("...", "the recording has more of them: gsb-info --json")]
    said: Block = Facts(tuple((name, Cell(value)) for name, value in rows)) if rows else Text("None.")
    return Section(key_of(caption, number), caption, (said,), plural(len(rows), "value"), folded=True)


def _pairs(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of a record; nested ones with dotted names down to a depth that can be read, lists as text."""
    for key in record:
        value, name = record[key], f"{prefix}{key}"
        if isinstance(value, dict) and value and prefix.count(".") < _DEPTH:
            yield from _pairs(value, f"{name}.")
        elif isinstance(value, (list, tuple)):
            yield name, ", ".join(first([*map(str, value)], _ROWS)) or "none"
        else:
            yield name, "none" if value is None or value in ("", {}) else str(value)


def _origins(result: GroupResult) -> list[tuple[str, Run]]:
    """One recording for each machine and software that the group's runs come from, with those runs' indices."""
    alike: dict[str, list[Run]] = {}
    for recording in result.group.recordings:
        alike.setdefault(_place(recording), []).append(recording)
    indices = {place: sorted({r.configuration.run_index for r in runs}) for place, runs in alike.items()}
    return [(in_ranges(indices[place], at_most=_PARTS), runs[0]) for place, runs in alike.items()]


def _place(recording: Run) -> str:
    found = recording.provenance
    return repr((found.host, found.gpus, found.software, found.environment))


def _methods(number: int, result: GroupResult) -> Table:
    computed = [found for found in result.metrics.values() if not isinstance(found.value, Missing)]
    return table(f"metrics-{number}", "", _TITLES, [_method(found) for found in computed])


def _not_computed(result: GroupResult) -> Iterator[Block]:
    """The reasons why metrics have no value, each with the names of its metrics."""
    names: dict[str, list[str]] = {}
    for found in result.metrics.values():
        if isinstance(found.value, Missing):
            names.setdefault(found.value.reason, []).append(found.name)
    if names:
        yield Items(tuple(Item(f"{', '.join(those)} not computed: {why}") for why, those in names.items()))


def _method(found: Estimate) -> Row:
    name, unit, better = Cell(found.name, code=True), Cell(found.unit or EMPTY.text), Cell(found.metric.direction.value)
    bounds = Cell(interval(found)) if found.ci95 else EMPTY
    how = "; ".join([found.method, *_more(found)])
    n = Cell(str(found.n), float(found.n))
    return Row(
        (name, Cell(mean_sd(found), known(found.value)), unit, bounds, n, better, Cell(found.exactness), Cell(how))
    )


def _more(found: Estimate) -> Iterator[str]:
    if extension := getattr(found.details, "extension", ""):
        yield extension
    floor = words.floor_of(found).w1
    if not isinstance(floor, Missing):
        yield (
            f"the first two sides, {figure(floor.observed, 'cm')} cm apart, are {figure(floor.floor_mean, 'cm')} cm "
            "apart on average with their environments exchanged at random, 95 % of the time below "
            f"{figure(floor.floor_q95, 'cm')} cm (p = {floor.p_value:.2g})"
        )
