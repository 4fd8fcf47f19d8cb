"""Parameters of a scene that engines could not honour: parameter by engine, and every statement with its reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.render.document import Section, Table, Text, key_of, table
from gpusimbench.evaluator.render.figures.matrix import letter
from gpusimbench.evaluator.report.sections.rows import ordered
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.provenance import Deviation
from gpusimbench.schemas.text import few, plural

_HOW = (
    "Parameters of the scene that an engine could not honour, by its adapter's own statement: what the scene wants, "
    "and what each engine has instead. A dash states no deviation."
)
_LABELS = 3
_COLUMNS = 6
_SHORT = 12
"""Characters of a cell; what is longer stands below the matrix, under a letter."""


@dataclass(frozen=True)
class Matrix:
    """The deviations of one scene.

    columns  simulators that deviate in the same way, with the groups that are meant where others of theirs do not
    rows     a parameter, what the scene wants, and for each column what it has instead; empty where no deviation is
             stated
    legend   letters that stand for words
    """

    scene: str
    columns: list[tuple[list[str], list[str]]]
    rows: list[tuple[str, str, list[str]]]
    legend: list[tuple[str, str]]


def section(source: Source) -> Section | None:
    """A matrix for each scene, and below it every statement in the adapter's own words; None where none is stated."""
    found = _deviations(source.evaluation)
    if not found:
        return None
    matrices = [_matrix(scene, results) for scene, results in ordered(source.evaluation.results, "scene").items()]
    groups = len(source.evaluation.results)
    said_of = "by the adapters of the simulators"
    statements = table(
        "deviations",
        "",
        ["parameter", "wanted", "used", "reason", "groups"],
        [
            (d.parameter, d.wanted, d.used, d.reason, "all" if 1 < len(labels) == groups else ", ".join(labels))
            for d, labels in found
        ],
    )
    scenes = tuple(_of_scene(one) for one in matrices if one.rows)
    listed = Section("deviations-statements", "Every statement, with its reason", (statements,), said_of, folded=True)
    said = plural(len(found), "parameter") + " that an engine could not honour"
    return Section("deviations", "Deviations from the scene", (Text(_HOW), *scenes, listed), said, folded=True)


def _of_scene(found: Matrix) -> Section:
    said = plural(len({parameter for parameter, _, _ in found.rows}), "parameter")
    return Section(key_of("deviations-of", found.scene), found.scene, tuple(_tables(found)), said, folded=True)


def _tables(found: Matrix) -> Iterator[Table]:
    """The matrix in parts of as many columns as a page has room for."""
    for begin in range(0, len(found.columns), _COLUMNS):
        part = slice(begin, begin + _COLUMNS)
        rows = [(parameter, wanted, cells[part]) for parameter, wanted, cells in found.rows]
        yield _table(replace(found, columns=found.columns[part], rows=[row for row in rows if any(row[2])]), begin)


def _table(found: Matrix, begin: int) -> Table:
    titles, notes = [], []
    for number, (names, labels) in enumerate(found.columns, start=begin + 1):
        titles.append(", ".join(names) + (f" (note {number})" if labels else ""))
        if labels:
            notes.append(f"note {number}: {few(labels, _LABELS, by='; ')}")
    cells = {text for row in found.rows for text in (row[1], *row[2])}
    used = [f"{letter} {said}" for letter, said in found.legend if any(letter in text for text in cells)]
    legend = [*used, *notes]
    rows = [(parameter, wanted, *cells) for parameter, wanted, cells in found.rows]
    return table(key_of("deviations", found.scene, begin), "", ["parameter", "wanted", *titles], rows, legend)


def _stated(result: GroupResult) -> tuple[Deviation, ...] | None:
    """What a group's engine states; None where no run came so far."""
    simulation = next((r.simulation for r in result.group.recordings if r.simulation), None)
    return tuple(dict.fromkeys(simulation.deviations)) if simulation else None


def _matrix(scene: str, results: Sequence[GroupResult]) -> Matrix:
    alike = gathered(
        (frozenset((d.parameter, d.wanted, d.used) for d in stated), result)
        for result in results
        if (stated := _stated(result)) is not None
    )
    wanted = sorted({(parameter, value) for stated in alike for parameter, value, _ in stated})
    letters: dict[str, str] = {}
    rows = [
        (parameter, _short(value, letters), [_used(stated, parameter, value, letters) for stated in alike])
        for parameter, value in wanted
    ]
    return Matrix(scene, _columns(list(alike.values())), rows, [(letter, said) for said, letter in letters.items()])


_Stated = tuple[str, str, str]


def _columns(found: Sequence[Sequence[GroupResult]]) -> list[tuple[list[str], list[str]]]:
    simulators = [list(dict.fromkeys(r.group.key.simulator for r in results)) for results in found]
    counts = Counter(name for names in simulators for name in names)
    return [
        (names, [r.label for r in results if counts[r.group.key.simulator] > 1])
        for names, results in zip(simulators, found, strict=True)
    ]


def _used(stated: frozenset[_Stated], parameter: str, wanted: str, letters: dict[str, str]) -> str:
    used = sorted(used for name, value, used in stated if (name, value) == (parameter, wanted))
    return "; ".join(_short(one, letters) for one in used)


def _short(said: str, letters: dict[str, str]) -> str:
    if len(said) <= _SHORT:
        return said
    return letters.setdefault(said, f"({letter(len(letters)).lower()})")


def _deviations(evaluation: Evaluation) -> list[tuple[Deviation, list[str]]]:
    """Every parameter that was not honoured, once, with the groups that it holds for."""
    found = gathered((deviation, result.label) for result in evaluation.results for deviation in _stated(result) or ())
    return list(found.items())
