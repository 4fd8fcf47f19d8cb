"""An evaluation as one HTML page that needs nothing but itself: no script, no network, no other file.

What recordings say is a stranger's text: the template escapes every value, figures escape their own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

import schemas
from evaluator import published as paper
from evaluator.groups import shown_status, status_notes
from evaluator.metrics.density import Density, marginal
from evaluator.metrics.radar import Axis
from evaluator.metrics.regime import REGIME_MEANING
from evaluator.report import accumulation, numbers, words
from evaluator.report.fidelity import fidelity_html
from evaluator.report.figures import density_map, lines, matrix, palette, radar_chart
from evaluator.report.scaling import beside_published, scene_sweeps
from evaluator.report.text import printable
from evaluator.results import Evaluation, GroupResult, Map, Metric, Reference
from evaluator.summary import Summary
from evaluator.sweeps import SOURCES, swept_only
from schemas.provenance import Deviation

_TEMPLATE = "report.html.j2"
_DEPTH = 3
_AXIS_UNITS = {
    Axis.THROUGHPUT: "env-steps/s",
    Axis.MEMORY: "GB",
    Axis.EMD_TO_REAL: "cm",
    Axis.PARALLEL: "cm",
    Axis.RUN_TO_RUN: "cm",
}

Marginals = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class Picture:
    """A figure with the words below it; `svg` is None where there is nothing to draw and the caption says why."""

    label: str
    caption: str
    svg: Markup | None


@dataclass(frozen=True)
class SceneMaps:
    """The density maps of one scene.

    scale     of the colours, shared by all; None where there is no map
    bin_cm    width of a hexagon [cm]
    pictures  a map for the reference and each group, or why there is none
    """

    scene: str
    scale: Markup | None
    bin_cm: str
    pictures: list[Picture]


@dataclass(frozen=True)
class Problem:
    """A file that a reader must know about: its name, what is wrong, and why."""

    name: str
    kind: str
    reason: str


def write_html(evaluation: Evaluation, folder: Path, *, published: bool, command: str) -> Path:
    """Write `index.html` into the folder, which is made where it is missing; returns the page's path.

    A reader never meets half a page: it is written beside and then put in place. OSError where that cannot be done.
    """
    # Names of files may hold bytes that are no text; they are shown as escapes instead of failing the report.
    content = render_html(evaluation, published=published, command=command).encode("utf-8", "backslashreplace")
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / "index.html"
    unfinished = folder / f".index.html.{os.getpid()}"
    try:
        unfinished.write_bytes(content)
        os.replace(unfinished, page)
    finally:
        unfinished.unlink(missing_ok=True)
    return page


def render_html(evaluation: Evaluation, *, published: bool, command: str) -> str:
    """The page's text.

    published  whether the paper's figures are shown as well, marked as the paper's
    command    that made the page, as a shell would take it
    """
    swept = swept_only(evaluation.results, evaluation.sweeps)
    shown = [r for r in evaluation.results if r.label not in swept]
    scaled = evaluation.comparison.radar
    notes = [(r.label, note) for r in evaluation.results for note in r.notes if note not in status_notes(r.group)]
    return (
        _environment()
        .get_template(_TEMPLATE)
        .render(
            evaluation=evaluation,
            results=evaluation.results,
            recordings=[(r.label, one) for r in evaluation.results for one in r.group.recordings],
            problems=list(_problems(evaluation)),
            accumulation=[(a, list(accumulation.rows(a)), accumulation.remarks(a)) for a in evaluation.accumulation],
            accumulation_titles=accumulation.TITLES,
            physics=fidelity_html([r.fidelity for r in shown]),
            notes=[("", note) for note in evaluation.notes] + notes,
            maps=list(_maps(evaluation, shown)),
            shown=shown,
            hidden=[r for r in evaluation.results if r.label in swept],
            sweeps=list(scene_sweeps(evaluation.sweeps)),
            parallel_matrices=[_matrix(r, r.parallel_matrix, "env", "w1_parallel") for r in shown],
            run_matrices=[_matrix(r, r.run_matrix, "run", "w1_run_to_run") for r in shown],
            contenders=evaluation.comparison.contenders,
            radar=Markup(radar_chart.radar_chart(scaled)) if scaled else None,
            axes=list(Axis),
            axis_units=_AXIS_UNITS,
            swatches=[Markup(lines.swatch(i)) for i in range(len(evaluation.comparison.contenders))],
            hatch=Markup(matrix.hatch()),
            deviations=_deviations(evaluation),
            regimes=REGIME_MEANING,
            paper=paper if published else None,
            beside=list(beside_published(evaluation.sweeps)) if published else [],
            command=command,
            version=schemas.__version__,
            colours={
                "light": Markup(palette.variables(dark=False)),
                "dark": Markup(palette.variables(dark=True)),
                "rules": Markup(palette.rules()),
            },
        )
        .lstrip()
    )


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        mean_sd=numbers.mean_sd,
        interval=_interval,
        figure=numbers.figure,
        pairs=lambda record: list(_pairs(record)),
        power=_power_of_two,
    )
    environment.globals.update(
        origins=_origins, simulation_of=_simulation_of, words=words, sources=SOURCES, status_of=shown_status
    )
    return environment


def _visible(value: Any) -> Any:
    """Text without characters that a page cannot hold; markup of our own is left alone."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def _interval(metric: Metric) -> str:
    if metric.ci95 is not None:
        return numbers.interval(metric)
    why_not = metric.extra.get("interval_why_not") or ("one run" if metric.n == 1 else "")
    return f"no interval: {why_not}" if why_not else "no interval"


def _power_of_two(count: int) -> Markup:
    return Markup("2<sup>{}</sup>").format(count.bit_length() - 1)


def _problems(evaluation: Evaluation) -> Iterator[Problem]:
    for failure in evaluation.unreadable:
        yield Problem(failure.path.name, "could not be read", str(failure.error))
    for result in evaluation.results:
        for recording in result.group.recordings:
            if recording.status != "complete":
                yield Problem(recording.path.name, shown_status(recording), recording.reason)
            for lost in recording.dropouts:
                yield Problem(recording.path.name, "lost data", lost)


def _maps(evaluation: Evaluation, shown: list[GroupResult]) -> Iterator[SceneMaps]:
    for scene in dict.fromkeys(r.group.key.scene for r in shown):
        results = [r for r in shown if r.group.key.scene == scene]
        missing = [
            Picture(r.label, f"No map: {_why_no_cloud(r, evaluation)}.", None) for r in results if r.cloud is None
        ]
        shared = evaluation.maps.get(scene)
        if shared is None:
            yield SceneMaps(scene, None, "", missing)
            continue
        scale = Markup(density_map.count_scale(shared.max_count))
        bin_cm = f"{shared.grid.bin_m * 100:g}"
        yield SceneMaps(scene, scale, bin_cm, [*_scene_maps(results, evaluation.reference, shared), *missing])


def _scene_maps(results: list[GroupResult], reference: Reference | None, shared: Map) -> Iterator[Picture]:
    shown: list[tuple[str, Density, Marginals]] = []
    if reference is not None and reference.density is not None and reference.scene == results[0].group.key.scene:
        shown.append((f"reference: {reference.label}", reference.density, _sides(reference, shared)))
    shown += [(r.label, r.cloud.density, r.cloud.marginals) for r in results if r.cloud is not None]
    share_max = max((_largest_share(density, sides) for _, density, sides in shown), default=1.0)
    board = _board(results[0])
    for label, density, sides in shown:
        svg = density_map.density_map(density, sides, shared, name=label, share_max=share_max, board=board)
        yield Picture(label, density_map.caption(density), Markup(svg))


def _sides(reference: Reference, shared: Map) -> Marginals:
    x, y = reference.positions[..., 0], reference.positions[..., 1]
    return marginal(x, shared.edges[0]), marginal(y, shared.edges[1])


def _largest_share(density: Density, sides: Marginals) -> float:
    n_point = int(density.counts.sum()) + density.off_map
    return max(float(density_map.shares(counts, n_point).max(initial=0.0)) for counts in sides)


def _why_no_cloud(result: GroupResult, evaluation: Evaluation) -> str:
    metric = result.metrics.get("w1_parallel")
    if metric and metric.value is not None and result.group.key.scene not in evaluation.maps:
        return "the groups of this scene lie too far apart for one map"
    return metric.why_not if metric and metric.why_not else "no positions were recorded at the sample time"


def _board(result: GroupResult) -> density_map.Outline | None:
    """The board that the scene names, where its description can be read."""
    board = result.group.recordings[0].board if result.group.recordings else None
    if board is None:
        return None
    (x, y), (length, width) = board.centre[:2], board.size[:2]
    return density_map.Outline(x - length / 2, x + length / 2, y - width / 2, y + width / 2)


def _matrix(result: GroupResult, values: NDArray[np.float64] | None, of: str, name: str) -> Picture:
    if values is None:
        metric = result.metrics.get(name)
        why_not = (metric.why_not or metric.extra.get("no_matrix")) if metric else ""
        why_not = why_not or "it was not computed"
        return Picture(result.label, f"No matrix: {why_not}.", None)
    svg = Markup(matrix.matrix_map(values, of=of, name=result.label))
    return Picture(result.label, matrix.caption(values, of=of), svg)


def _deviations(evaluation: Evaluation) -> list[tuple[Deviation, list[str]]]:
    """Every parameter that was not honoured, once, with the groups that it holds for."""
    found: dict[Deviation, list[str]] = {}
    for result in evaluation.results:
        simulation = _simulation_of(result)
        for deviation in dict.fromkeys(simulation.deviations if simulation else ()):
            found.setdefault(deviation, []).append(result.label)
    return list(found.items())


def _simulation_of(result: GroupResult) -> Any:
    return next((r.simulation for r in result.group.recordings if r.simulation), None)


def _origins(result: GroupResult) -> list[tuple[str, Summary]]:
    """One recording for each machine and software that the group's runs come from, with those runs' indices."""
    alike: dict[str, list[Summary]] = {}
    for recording in result.group.recordings:
        p = recording.provenance
        alike.setdefault(repr((p.host, p.gpus, p.software, p.environment)), []).append(recording)
    return [(", ".join(str(r.configuration.run_index) for r in runs), runs[0]) for runs in alike.values()]


def _pairs(record: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of a record; nested ones with dotted names down to a depth that can be read, lists as text."""
    for key in record:
        value, name = record[key], f"{prefix}{key}"
        if isinstance(value, dict) and value and prefix.count(".") < _DEPTH:
            yield from _pairs(value, f"{name}.")
        elif isinstance(value, (list, tuple)):
            yield name, ", ".join(str(v) for v in value) or "none"
        else:
            yield name, "none" if value is None or value in ("", {}) else str(value)
