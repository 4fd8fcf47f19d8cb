"""Distances between the environments of a run, and between runs, pair by pair, by classes of bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.render.document import Block, Document, Embed, Figure, Numbers, Section, Text, key_of
from gpusimbench.evaluator.render.figures import matrix
from gpusimbench.evaluator.report.sections.rows import footnotes_below, ordered, titled, with_lines, without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.details import BetweenEnvs, BetweenRuns, DistinctEnvs
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import in_ranges

_HOW = (
    "Each cell is the distance [cm] between two environments of one run, or between two runs. All matrices share "
    "one logarithmic scale of colours. Exact zeros are grey and hatched, outside the scale; the diagonal, an "
    "environment or run with itself, is blank. Where some are bit-identical and some are not, rows and columns are "
    "put together by class of bits, with a line between classes; the numbers at the axes are the original ones. Where "
    "every distance is exactly 0, a line of text says so."
)
_CLASSES = 12  # that a caption names
_PARTS = 8  # ranges of members that it names of each

_NAMES = ("w1_parallel", "w1_run_to_run")
"""Metrics whose distances are drawn: between environments, between runs."""


def section(source: Source) -> Section | Missing | None:
    """The matrices of every scene; None without a group, Missing where there are no distances."""
    of_scene = ordered(source.shown, "scene")
    if not of_scene:
        return None
    if not any(values is not None for r in source.shown for values in _distances(r)):
        return without("Consistency matrices", (_why_no_matrix(r, name) for r in source.shown for name in _NAMES))
    parts = [_of_scene(source, scene, results) for scene, results in of_scene.items()]
    n_drawn = sum(bool(one.svg) for one in Document("", tuple(parts)).figures())
    n_all = 2 * len(source.shown)
    said = f"{n_drawn} of {n_all} are drawn; a line for each of the others" if n_drawn else "nothing to draw"
    hatch = Embed(Markup(matrix.hatch()), Markup(), Markup())
    return Section("consistency", "Consistency matrices", (hatch, Text(_HOW), *parts), said, folded=True)


def _of_scene(source: Source, scene: str, results: Sequence[GroupResult]) -> Section:
    envs, runs = matrices(source, results)
    key = key_of("consistency", scene)
    blocks: list[Block] = [*with_lines(titled(source, envs))]
    if any(one.svg for one in runs):
        found = with_lines(titled(source, runs))
        blocks.append(Section(f"{key}-runs", "Distances between runs", found, folded=True))
    else:
        blocks += with_lines(titled(source, runs))
    blocks += footnotes_below(source, results)
    n_drawn = sum(bool(one.svg) for one in (*envs, *runs))
    said = ("1 matrix" if n_drawn == 1 else f"{n_drawn} matrices") if n_drawn else "no matrix is drawn"
    return Section(key, scene, tuple(blocks), said, folded=True, facets={"scene": scene})


def matrices(source: Source, results: Sequence[GroupResult]) -> tuple[list[Figure], list[Figure]]:
    """Of the environments of each group's first complete run, and of its runs; all matrices of a page on one scale."""
    numbers = {id(r): number for number, r in enumerate(source.evaluation.results)}
    scale = _scale(source.shown)
    envs = [_figure(r, _between_envs(r), f"matrix-envs-{numbers[id(r)]}", scale) for r in results]
    runs = [_figure(r, _between_runs(r), f"matrix-runs-{numbers[id(r)]}", scale) for r in results]
    return envs, runs


def _scale(shown: Sequence[GroupResult]) -> matrix.Scale | None:
    """The scale of all matrices."""
    return matrix.scale_of(values for r in shown for values in _distances(r) if values is not None)


def _distances(result: GroupResult) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Between environments, and between runs [cm]."""
    envs, runs = _NAMES
    return result.metrics[envs].of(BetweenEnvs).matrix_cm, result.metrics[runs].of(BetweenRuns).matrix_cm


def _why_no_matrix(result: GroupResult, name: str) -> str:
    metric = result.metrics[name]
    return why_missing(metric.value) or why_missing(metric.of(BetweenEnvs).matrix_of) or "it was not computed"


@dataclass(frozen=True)
class _Between:
    """Distances between environments, or between runs, with all that their matrix shows.

    of          "env" or "run"
    metric      whose distances they are
    values      [cm]; None where there is no matrix
    classes     of bits, one number each; empty where they are not known, and `no_classes` says why
    names       the numbers at the axes
    """

    of: str
    metric: str
    values: NDArray[np.float64] | None
    classes: Sequence[int]
    no_classes: str
    names: Sequence[int]


def _between_envs(result: GroupResult) -> _Between:
    distinct, distances = result.metrics["distinct_envs"], result.metrics["w1_parallel"].of(BetweenEnvs)
    values, drawn = distances.matrix_cm, distances.matrix_of
    of_runs = distinct.of(DistinctEnvs).classes
    classes = of_runs[drawn] if isinstance(drawn, int) and drawn < len(of_runs) else ()
    names = range(len(values)) if values is not None else ()
    return _Between("env", "w1_parallel", values, classes, why_missing(distinct.value), names)


def _between_runs(result: GroupResult) -> _Between:
    distinct, between = result.metrics["distinct_runs"].value, result.metrics["w1_run_to_run"].of(BetweenRuns)
    classes = () if isinstance(distinct, Missing) else between.classes or ()
    values = between.matrix_cm
    names: Sequence[int] = between.run_indices or ()
    if values is not None and len(names) != len(values):
        names = range(len(values))
    return _Between("run", "w1_run_to_run", values, classes, why_missing(distinct), names)


def _figure(result: GroupResult, between: _Between, key: str, scale: matrix.Scale | None) -> Figure:
    values, of, classes, names = between.values, between.of, between.classes, between.names
    if values is None:
        return Figure(result.label, f"No matrix: {_why_no_matrix(result, between.metric)}.", None)
    if len(values) > 1 and not values.any():
        return Figure(result.label, _all_zero(len(values), of, classes), None)
    svg = Markup(matrix.matrix_map(values, of=of, name=result.label, classes=classes, names=names, scale=scale))
    said = f"{matrix.caption(values, of=of)} {_order(len(values), between)}"
    about = f"Distances between {of}s, {result.group.key.scene}"
    return Figure(result.label, said, svg, key, _numbers(values, of, classes, names), about)


def _all_zero(n: int, of: str, classes: Sequence[int]) -> str:
    """What stands in place of a matrix of zeros."""
    apart = f"All {n} {of}s are 0 cm apart at the sample step"
    if len(classes) != n:
        return f"{apart}; whether their bits differ is not known."
    count = len(set(classes))
    if count == 1:
        return f"{apart}: bit-identical at every captured step."
    return f"{apart}, in {count} classes of bits."


def _order(n: int, between: _Between) -> str:
    """What order the n rows stand in, and which of them are the same by bits."""
    of, classes = between.of, between.classes
    if n < 2:
        return ""
    if len(classes) != n:
        return f"In original order: {between.no_classes or 'classes of bits are not known'}."
    count = len(set(classes))
    if count == 1:
        return f"All {n} {of}s are bit-identical at every captured step."
    if count == n:
        return f"In original order: each {of} is a class of its own by its bits."
    if not matrix.grouped(n, classes):
        return f"In original order, {count} classes of bits: larger matrices are drawn in blocks."
    said = []
    for number in range(min(count, _CLASSES)):
        members = [between.names[i] for i, one in enumerate(classes) if one == number]
        plural = "s" if len(members) > 1 else ""
        said.append(f"class {matrix.letter(number)}: {of}{plural} {in_ranges(members, at_most=_PARTS)}")
    if count > _CLASSES:
        said.append(f"and {count - _CLASSES} more classes")
    return f"Ordered by class of bits: {'; '.join(said)}."


def _numbers(values: NDArray[np.float64], of: str, classes: Sequence[int], names: Sequence[int]) -> Numbers:
    """The cells that are drawn, row by row in the order in which they are drawn."""
    order = matrix.by_class(classes) if matrix.grouped(len(values), classes) else np.arange(len(values))
    drawn, block = matrix.in_blocks(np.asarray(values, dtype=np.float64)[np.ix_(order, order)])
    shown = [f"{of} {names[i]}" for i in order[::block].tolist()]
    titles = (f"distance [cm], {of}", *shown)
    return Numbers(titles, [(one, *map(_cell, row)) for one, row in zip(shown, drawn.tolist(), strict=True)])


def _cell(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None
