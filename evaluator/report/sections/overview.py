"""The first screen: what was asked of each simulator with the answer, speed against divergence, and who is fastest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.render.document import (
    Beside,
    Block,
    Cell,
    Column,
    Facts,
    Figure,
    Item,
    Items,
    Row,
    Table,
    Text,
    Tone,
    facts,
    key_of,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE, ranked
from gpusimbench.evaluator.report.leaders import Fastest, Speed, fastest, not_ranked
from gpusimbench.evaluator.report.sections import probed, scatter
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.timed import TOO_SHORT
from gpusimbench.evaluator.report.verdicts import (
    LAWS,
    NOT_COMPARED,
    QUESTIONS,
    TO_REFERENCE,
    judged,
    meaning_of_cm,
    usual,
)
from gpusimbench.evaluator.results.cost_metrics import FPS, ranked_throughput
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import is_instrument
from gpusimbench.schemas.text import plural

_DEPENDS = (
    ("same at any N", "yes: the same initial state has the same bits among more or fewer envs, where probed", "number"),
    ("same in any slot", "yes: the same initial state has the same bits in another slot, where probed", "slot"),
)
"""Title, meaning and question of gsb-probe that the first screen answers, where any run was made for it."""

_DISTANCE = 4
"""Column of a scatter's numbers that has the distance."""

_HOW_TO_READ = (
    "Lines: 95 % intervals. Hollow: INVALID, misplaced contacts, or mechanics broken. Shaded strip: exactly 0. A mark "
    "without a name is another group of the simulator with its shape and colour. †: timed or run in another way than "
    "others."
)

_NOT_TIMED = (Text("Throughput was not measured: no recording has a timed phase.", Tone.QUIET),)

_ROOMY = 4
"""Simulators at most, for whom every cell of the first screen has a line for each of its notes."""


def overview(source: Source) -> tuple[Block, ...]:
    """The blocks of the first screen."""
    evaluation = source.evaluation
    found = list(fastest(evaluation.results))
    figure, fastest_table = tuple(_scatter(evaluation)), tuple(_fastest_table(found, evaluation.results))
    below: list[Block] = [Beside((figure, fastest_table))] if figure and fastest_table else [*figure, *fastest_table]
    speed = _speed_alone(evaluation.results, found) if evaluation.timed else _NOT_TIMED
    return (Items((_state_of_the_set(evaluation),)), *_matrix(evaluation), *speed, *below)


def asked_of(evaluation: Evaluation) -> str:
    """What was evaluated, in a line."""
    results = evaluation.results
    n = sum(len(r.group.recordings) for r in results)
    counts = [
        plural(n, "recording"),
        plural(len({r.group.key.simulator for r in results}), "simulator"),
        plural(len({r.group.key.scene for r in results}), "scene"),
        plural(len({r.group.key.device for r in results} - {""}), "device"),
    ]
    reference = evaluation.reference
    compared = f"; compared with {reference.label}" if reference else ""
    placed = f"; positions at {evaluation.sampled()}" if evaluation.placed else ""
    return f"{', '.join(counts)}{placed}{compared}."


def _matrix(evaluation: Evaluation) -> Iterator[Block]:
    """The answers, and why those questions that a table of several simulators leaves out have none."""
    lawful = any(judged(result) for result in evaluation.results)
    questions = [*QUESTIONS, *([LAWS] if lawful else []), *([TO_REFERENCE] if evaluation.reference else [])]
    asked = [Column(title, meaning) for title, meaning, _ in _DEPENDS] if evaluation.probed else []
    names = dict.fromkeys(r.group.key.simulator for r in evaluation.results)
    rows = [_engine(name, usual([r for r in evaluation.results if r.group.key.simulator == name])) for name in names]
    rows.sort(key=lambda row: (row[1], row[0]))
    matrix = table(
        "simulators",
        "What each simulator did" if len(rows) > 1 else "",
        ["simulator", *(one.column for one in questions), *asked],
        [
            Row((head, *(one.answer(results) for one in questions), *_depends(name, evaluation)), {"simulator": name})
            for name, _, head, results in rows
        ],
    )
    every = range(len(matrix.columns))
    unasked = [i for i in every if len(rows) > 1 and all(row.cells[i].text == NOT_COMPARED for row in matrix.rows)]
    kept = [i for i in every if i not in unasked]
    yield replace(
        matrix,
        columns=tuple(matrix.columns[i] for i in kept),
        rows=tuple(replace(row, cells=tuple(row.cells[i] for i in kept)) for row in matrix.rows),
        compact=len(rows) > _ROOMY,
    )
    if said := meaning_of_cm((cell.text for row in matrix.rows for cell in row.cells), evaluation.results):
        yield Text(said, Tone.QUIET)
    if unasked:
        yield Text(f"Not compared: {'; '.join(_unasked(matrix, i) for i in unasked)}.", Tone.QUIET)


def _unasked(matrix: Table, column: int) -> str:
    """A question without any answer, and the reasons."""
    reasons = dict.fromkeys(note for row in matrix.rows for note in row.cells[column].notes)
    why = f" ({', '.join(reasons)})" if reasons else ""
    return f"{matrix.columns[column].title}{why}"


def _depends(name: str, evaluation: Evaluation) -> Iterator[Cell]:
    if evaluation.probed:
        ours = [one for one in evaluation.probed if one.arms.key.simulator == name]
        yield from (probed.depends(ours, key) for _, _, key in _DEPENDS)


def _engine(name: str, results: list[GroupResult]) -> tuple[str, bool, Cell, list[GroupResult]]:
    versions = dict.fromkeys(r.group.key.version for r in results if r.group.key.version)
    instrument = all(is_instrument(r.group.key) for r in results)
    notes = [", ".join(versions) or "no version", *(["an instrument with known answers"] if instrument else [])]
    return name, instrument, Cell(name, notes=tuple(notes), link=key_of("simulator", name)), results


def _state_of_the_set(evaluation: Evaluation) -> Item:
    """What is wrong with the set, in a line."""
    parts = []
    if evaluation.unreadable:
        parts.append(f"{plural(len(evaluation.unreadable), 'file')} could not be read")
    runs = [run for r in evaluation.results for run in r.group.recordings]
    if left_out := sum(not run.usable for run in runs):
        verb = "is" if left_out == 1 else "are"
        parts.append(f"{plural(left_out, 'run')} of {len(runs)} failed, {verb} INVALID or lost data, and {verb} in no "
                     "figure")  # fmt: skip
    if wrong := sum(r.validity.misplaced.n_run for r in evaluation.results if r.validity.misplaced):
        parts.append(f"{plural(wrong, 'run')} with misplaced contacts")
    if count := evaluation.unmet.count:
        rules = len(evaluation.unmet.findings)
        parts.append(f"{plural(rules, 'rule')} of {PROTOCOL} not met ({plural(count, 'finding')})")
    if not parts:
        asked = any("scene" not in run.unmet for run in runs)  # the protocol is for the benchmark's scenes
        met = "every run is complete, and every rule of the protocol is met" if asked else "and every run is complete"
        return Item(f"Every file was read, {met}.", Tone.GOOD)
    return Item(f"What is wrong with this set: {'; '.join(parts)}.", Tone.WARNING, link="problems")


def _scatter(evaluation: Evaluation) -> Iterator[Figure]:
    """The figure of the scene in which most groups have both a speed and a distance, in fewer words."""
    drawn = [one for one in scatter.pictures(evaluation) if one.svg and _apart(one)]
    if drawn:
        most = max(drawn, key=lambda one: len(one.numbers.rows))
        yield replace(most, caption=_HOW_TO_READ)


def _apart(one: Figure) -> bool:
    """Whether it shows several groups, of which any is away from exactly zero."""
    return len(one.numbers.rows) > 1 and any(row[_DISTANCE] for row in one.numbers.rows)


def _fastest_table(found: Sequence[Fastest], results: Sequence[GroupResult]) -> Iterator[Table]:
    if not found:
        return
    yield table(
        "fastest",
        "The fastest valid simulator of each scene",
        ["scene, device", f"fastest [{FPS.unit}]", "next", "faster, not ranked"],
        [
            Row(
                (_where(one), _speed_cell(one.first), _speed_cell(one.second), _barred(one, results)),
                {"scene": one.scene},
            )
            for one in found
        ],
    ).without_empty_columns()


def _speed_alone(results: Sequence[GroupResult], found: Sequence[Fastest]) -> Iterator[Facts]:
    """The highest throughput of each simulator in each scene where it is compared with no other."""
    compared = {(one.scene, one.device) for one in found}
    names = {r.group.key.simulator for r in results}
    timed: dict[tuple[str, str], list[GroupResult]] = {}
    for result in results:
        key = result.group.key
        if (key.scene, key.device) in compared or (len(names) > 1 and is_instrument(key)):
            continue
        if ranked_throughput(result.metrics[FPS.name]) > 0.0:
            timed.setdefault((key.scene, key.simulator), []).append(result)
    if timed:
        yield facts(
            *(
                (
                    f"{'highest throughput' if len(those) > 1 else 'throughput'}, {scene} [{FPS.unit}]",
                    _speed(max(those, key=lambda result: ranked_throughput(result.metrics[FPS.name]))),
                )
                for (scene, _), those in timed.items()
            )
        )


def _speed(result: GroupResult) -> Cell:
    said = ranked(result.metrics[FPS.name])
    brief = (TOO_SHORT,) if result.timed.unreliable else ()
    named = f"{result.label}, {plural(result.group.key.n_env, 'env', spec=',')}"
    bounds = said.range and f"95 % interval {said.range}"
    return replace(said, range=bounds, notes=(named, *said.notes, *brief))


def _where(found: Fastest) -> Cell:
    return Cell(found.scene, notes=(found.device or "no device",), link="throughput")


def _speed_cell(speed: Speed | None) -> Cell:
    if speed is None:
        return Cell("none", tone=Tone.QUIET)
    fps, key = ranked(speed.result.metrics[FPS.name]), speed.result.group.key
    unchecked = ("mechanics not checked",) if speed.unchecked else ()
    return Cell(f"{key.simulator}: {fps.text}", notes=(plural(key.n_env, "env", spec=","), *fps.notes, *unchecked))


def _barred(found: Fastest, results: Sequence[GroupResult]) -> Cell:
    others = found.other_steps
    apart = [f"{one.result.group.key.simulator}: {ranked(one.result.metrics[FPS.name]).text}" for one in others]
    untold = [f"not compared, timed over other steps: {'; '.join(apart)}"] if apart else []
    if not found.faster:
        return Cell("; ".join(untold) or NONE, tone=Tone.QUIET)
    by_kind = not_ranked(found, results)
    simulators = [speed.result.group.key.simulator for speed, _ in found.faster]
    names = {  # of one simulator with several reasons, which group has which
        why: [r.label if simulators.count(r.group.key.simulator) > 1 else r.group.key.simulator for r in those]
        for why, those in by_kind.items()
    }
    notes = [why if len(names) == 1 else f"{', '.join(those)}: {why}" for why, those in names.items()]
    speeds = [r.metrics[FPS.name] for those in by_kind.values() for r in those]
    listed = zip((name for those in names.values() for name in those), map(ranked, speeds), strict=True)
    return Cell("; ".join(f"{name}: {fps.text}" for name, fps in listed), notes=(*notes, *untold), tone=Tone.BAD)
