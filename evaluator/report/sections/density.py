"""Where bodies lie at the sample time: density maps with marginals, on one extent, grid and scale for a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import Density, marginal
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.render.document import Block, Figure, Numbers, Section, Text, key_of
from gpusimbench.evaluator.render.figures import density_map
from gpusimbench.evaluator.render.table_files import CsvCell
from gpusimbench.evaluator.report.sections.rows import footnotes_below, titled, with_lines, without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import GroupResult, Map
from gpusimbench.schemas.text import plural

_HOW = (
    "Where bodies lie at t = {time:g} s, all environments and runs of a group together, each environment in its own "
    "frame. Colour: the number of positions in a hexagon {width} cm wide; all maps of this scene share scale and "
    "extent. Empty hexagons are not drawn. Bars at the top and the right: share of a group's positions in strips along "
    "x and y, on one scale for all maps. Shaded with a dashed edge: the board."
)
_DIGITS = 9  # nanometres: the grid's own rounding is not told

Marginals = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class SceneMaps:
    """The density maps of one scene.

    scale     of the colours, shared by all, as a picture; None where there is no map
    bin_cm    width of a hexagon [cm]
    pictures  a map for the reference and each group, or why there is none
    """

    scene: str
    scale: Figure | None
    bin_cm: str
    pictures: list[Figure]


def section(source: Source) -> Section | Missing | None:
    """A section for each scene; None without a group, Missing where nothing is drawn."""
    found = list(scene_maps(source.evaluation, source.shown))
    if not found:
        return None
    n_drawn = sum(bool(one.svg) for maps in found for one in maps.pictures)
    if not n_drawn:
        return without("Density maps", (_why_no_cloud(r, source.evaluation) for r in source.shown))
    n_scene = sum(maps.scale is not None for maps in found)
    said = f"{plural(n_drawn, 'map')} of {plural(n_scene, 'scene')}"
    return Section("density", "Density maps", tuple(_of_scene(source, one) for one in found), said, folded=True)


def _of_scene(source: Source, maps: SceneMaps) -> Section:
    blocks: list[Block] = []
    if maps.scale:
        blocks += [Text(_HOW.format(time=source.evaluation.sampled_at(maps.scene), width=maps.bin_cm)), maps.scale]
    n_drawn = sum(bool(one.svg) for one in maps.pictures)
    said = plural(n_drawn, "map") if n_drawn else "no map"
    of_scene = [r for r in source.shown if r.group.key.scene == maps.scene]
    key, facets = key_of("density", maps.scene), {"scene": maps.scene}
    return Section(
        key,
        maps.scene,
        (*blocks, *with_lines(titled(source, maps.pictures)), *footnotes_below(source, of_scene)),
        said,
        folded=True,
        facets=facets,
    )


def scene_maps(evaluation: Evaluation, shown: list[GroupResult]) -> Iterator[SceneMaps]:
    for index, scene in enumerate(dict.fromkeys(r.group.key.scene for r in shown)):
        results = [r for r in shown if r.group.key.scene == scene]
        missing = [
            Figure(r.label, f"No map: {_why_no_cloud(r, evaluation)}.", None) for r in results if r.cloud is None
        ]
        shared = evaluation.maps.get(scene)
        if shared is None:
            yield SceneMaps(scene, None, "", missing)
            continue
        drawn = Markup(density_map.count_scale(shared.max_count))
        key = key_of("density-scale", index, scene)
        scale = Figure(f"Colours of {scene}", "positions in a hexagon, logarithmic", drawn, key)
        bin_cm = f"{shared.grid.bin_m * 100:g}"
        yield SceneMaps(scene, scale, bin_cm, [*_scene_maps(index, results, evaluation.reference, shared), *missing])


def _scene_maps(nth: int, results: list[GroupResult], reference: Reference | None, shared: Map) -> Iterator[Figure]:
    scene = results[0].group.key.scene
    shown: list[tuple[str, Density, Marginals]] = []
    if reference is not None and reference.density is not None and reference.scene == scene:
        shown.append((f"reference: {reference.label}", reference.density, _sides(reference, shared)))
    shown += [(r.label, r.cloud.density, r.cloud.marginals) for r in results if r.cloud is not None]
    share_max = max((_largest_share(density, sides) for _, density, sides in shown), default=1.0)
    board = _board(results[0])
    for index, (label, density, sides) in enumerate(shown):
        svg = density_map.density_map(density, sides, shared, name=label, share_max=share_max, board=board)
        key = key_of("density", nth, index, scene, label)
        numbers = _numbers(density, sides, shared)
        yield Figure(label, density_map.caption(density), Markup(svg), key, numbers, f"Density map, {scene}")


def _numbers(density: Density, sides: Marginals, shared: Map) -> Numbers:
    """Every hexagon, every strip of the marginals that holds a position, and what lies off the map."""
    rows: list[tuple[CsvCell, ...]] = [
        ("hexagon", round(float(x), _DIGITS), round(float(y), _DIGITS), int(count))
        for (x, y), count in zip(density.centres, density.counts, strict=True)
    ]
    for axis, (counts, edges) in enumerate(zip(sides, shared.edges, strict=True)):
        for count, middle in zip(counts, (edges[:-1] + edges[1:]) / 2, strict=True):
            if count:
                at = round(float(middle), _DIGITS)
                rows.append(
                    ("strip along x", at, None, int(count)) if axis == 0 else ("strip along y", None, at, int(count))
                )
    rows.append(("off the map", None, None, density.off_map))
    return Numbers(("what", "x of its middle [m]", "y of its middle [m]", "positions"), rows)


def _sides(reference: Reference, shared: Map) -> Marginals:
    x, y = reference.positions[..., 0], reference.positions[..., 1]
    return marginal(x, shared.edges[0]), marginal(y, shared.edges[1])


def _largest_share(density: Density, sides: Marginals) -> float:
    n_point = int(density.counts.sum()) + density.off_map
    return max(float(density_map.shares(counts, n_point).max(initial=0.0)) for counts in sides)


def _why_no_cloud(result: GroupResult, evaluation: Evaluation) -> str:
    found = result.metrics["w1_parallel"].value
    if not isinstance(found, Missing) and result.group.key.scene not in evaluation.maps:
        return "the groups of this scene lie too far apart for one map"
    return why_missing(found) or "no positions were recorded at the sample time"


def _board(result: GroupResult) -> density_map.Outline | None:
    """The board that the scene names, where its description can be read."""
    board = result.group.recordings[0].board if result.group.recordings else None
    if board is None:
        return None
    (x, y), (length, width) = board.centre[:2], board.size[:2]
    return density_map.Outline(x - length / 2, x + length / 2, y - width / 2, y + width / 2)
