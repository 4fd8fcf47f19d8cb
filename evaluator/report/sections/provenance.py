"""Where everything comes from, and how every metric was computed: a folded part for each group; and every file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.read.known_errors import options_in_force
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
    Tone,
    key_of,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE, figure, interval, mean_sd
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import by_simulator, facets, ordered
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.configuration import TELLING
from gpusimbench.schemas.gathering import gathered
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
    built = next((r for r in recordings if r.simulation), None)
    if built is None or (simulation := built.simulation) is None:
        yield Text("The runs ended before the engine said what it is.")
    else:
        told = {
            "version": simulation.version, "device": simulation.device, "between the clocks": simulation.timing_covers,
            "start of the capture phase": simulation.fresh_start, "scene": simulation.scene,
            **({"remarks": "; ".join(simulation.remarks)} if simulation.remarks else {}),
        }  # fmt: skip
        yield _records(number, "What the engine said", told)
        yield _records(number, "Options in force", options_in_force(built))
        yield _records(number, "Switches in force", simulation.switches)
    for index, (runs, recording) in enumerate(_origins(result)):
        yield _origin(f"{number}-{index}", runs, recording, result.label, machines)
    computed = [_method(found) for found in result.metrics.values() if not isinstance(found.value, Missing)]
    parts = (table(f"metrics-{number}", "", _TITLES, computed), *_not_computed(result))
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
    alike = gathered((_place(recording), recording) for recording in result.group.recordings)
    indices = {place: sorted({r.configuration.run_index for r in runs}) for place, runs in alike.items()}
    return [(in_ranges(indices[place], at_most=_PARTS), runs[0]) for place, runs in alike.items()]


def _place(recording: Run) -> str:
    found = recording.provenance
    return repr((found.host, found.gpus, found.software, found.environment))


def _not_computed(result: GroupResult) -> Iterator[Block]:
    """The reasons why metrics have no value, each with the names of its metrics."""
    names = gathered(
        (found.value.reason, found.name) for found in result.metrics.values() if isinstance(found.value, Missing)
    )
    if names:
        yield Items(tuple(Item(f"{', '.join(those)} not computed: {why}") for why, those in names.items()))


def _method(found: Estimate) -> Row:
    name, unit, better = Cell(found.name, code=True), Cell(found.unit or EMPTY.text), Cell(found.metric.direction.value)
    bounds = Cell(interval(found)) if found.ci95 else EMPTY
    how = "; ".join([found.method, *_estimate_notes(found)])
    n = Cell(str(found.n), float(found.n))
    return Row(
        (name, Cell(mean_sd(found), known(found.value)), unit, bounds, n, better, Cell(found.exactness), Cell(how))
    )


def _estimate_notes(found: Estimate) -> Iterator[str]:
    if extension := getattr(found.details, "extension", ""):
        yield extension
    floor = words.floor_of(found).w1
    if not isinstance(floor, Missing):
        yield (
            f"the first two sides, {figure(floor.observed, 'cm')} cm apart, are {figure(floor.floor_mean, 'cm')} cm "
            "apart on average with their environments exchanged at random, 95 % of the time below "
            f"{figure(floor.floor_q95, 'cm')} cm (p = {floor.p_value:.2g})"
        )


_FILES = ("file", "status", "group", "run", "content hash", "created (UTC)")
_DAY = len("2026-11-23")
_FEW = 10
"""Files that are listed at once; of more, a summary stands before the closed list."""


def every_file(source: Source) -> Section | None:
    """Every file; of many, a summary by simulator and the list closed below it. None without a file."""
    results, unreadable = source.evaluation.results, source.evaluation.unreadable
    rows = [_unread(failure) for failure in unreadable]
    rows += [_file(result, one) for result in results for one in result.group.recordings]
    if not rows:
        return None
    every = table("recordings", "", _FILES, rows)
    blocks: tuple[Block, ...] = (every,)
    if len(rows) > _FEW:
        said = "with content hash and date"
        blocks = (_in_short(source), Section("recordings-files", "Every file", (every,), said, folded=True))
    parts = [plural(len(rows), "file")]
    if bad := sum(_bad(one) for result in results for one in result.group.recordings):
        parts.append(f"{bad} not complete")
    if unreadable:
        parts.append(f"{len(unreadable)} could not be read")
    return Section("recordings", "Recordings", blocks, ", ".join(parts), folded=True)


def _in_short(source: Source) -> Table:
    titles = ("simulator", "files", "status", "scenes", "created (UTC)")
    rows = [_of_simulator(name, found) for name, found in ordered(source.evaluation.results, "simulator").items()]
    rows.sort(key=lambda row: all(cell.tone is not Tone.BAD for cell in row.cells))  # what deviates comes first
    legend = ["Files that are not complete or could not be read are listed under “What is wrong with this set”."]
    return table("recordings-simulators", "Files, by simulator", titles, rows, legend)


def _of_simulator(name: str, results: list[GroupResult]) -> Row:
    runs = [one for result in results for one in result.group.recordings]
    ends = sorted(Counter(_status(one) for one in runs).items(), key=lambda one: one[0] != "complete")
    days = sorted(one.provenance.created_utc[:_DAY] for one in runs if one.provenance.created_utc)
    bad = any(map(_bad, runs))
    return Row(
        (
            Cell(name, link=key_of("simulator", name)),
            Cell(str(len(runs)), float(len(runs))),
            Cell(", ".join(f"{count} {end}" for end, count in ends), tone=Tone.BAD if bad else Tone.PLAIN),
            Cell(", ".join(dict.fromkeys(result.group.key.scene for result in results))),
            Cell(NONE if not days else days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"),
        ),
        {"simulator": name},
    )


def _file(result: GroupResult, one: Run) -> Row:
    return Row(
        (
            Cell(one.path.name, code=True),
            Cell(_status(one), tone=Tone.BAD if _bad(one) else Tone.PLAIN),
            Cell(result.label),
            Cell(str(one.configuration.run_index), float(one.configuration.run_index)),
            Cell(one.content_hash or "none", code=bool(one.content_hash)),
            Cell(one.provenance.created_utc),
        ),
        facets(result.group.key),
    )


def _bad(one: Run) -> bool:
    return one.status != "complete" or bool(one.dropouts)


def _status(one: Run) -> str:
    return shown_status(one) + (", lost data" if one.dropouts else "")


def _unread(failure: Unreadable) -> Row:
    said = Cell("could not be read", tone=Tone.BAD)
    return Row((Cell(failure.path.name, code=True), said, EMPTY, EMPTY, Cell("none"), EMPTY))
