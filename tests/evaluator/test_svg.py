"""Figures of the report."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from gpusimbench.evaluator.metrics.density import HexGrid, marginal
from gpusimbench.evaluator.metrics.divergence import GrowthFit
from gpusimbench.evaluator.metrics.identity import Branch, SplitTree
from gpusimbench.evaluator.metrics.radar import SimulatorResult, radar
from gpusimbench.evaluator.render.figures import (
    curves,
    density_map,
    divergence,
    dot_plot,
    matrix,
    palette,
    plot,
    radar_chart,
    scaling,
    scatter,
    style,
    svg,
    tree,
)
from gpusimbench.evaluator.results.result import Map

GRID = HexGrid((-0.1, 0.7, -0.3, 0.3), 0.02)
EDGES = (np.linspace(-0.1, 0.7, 41), np.linspace(-0.3, 0.3, 31))
HOSTILE = "<script>alert(\"1\")</script>\x00\udcff & 'quoted'"


def draw_map(points: np.ndarray, *, max_count: int, name: str = "a", share_max: float = 1.0) -> ET.Element:
    """A density map of points [m], shape [n, 2], parsed."""
    sides = (marginal(points[:, 0], EDGES[0]), marginal(points[:, 1], EDGES[1]))
    board = density_map.Outline(0.0, 0.6, -0.3, 0.3)
    shared = Map(GRID, EDGES, max_count)
    return ET.fromstring(
        density_map.density_map(GRID.bin(points), sides, shared, name=name, share_max=share_max, board=board)
    )


def classes(root: ET.Element) -> list[str]:
    """The class attributes of all elements that have one."""
    return [c for e in root.iter() if (c := e.get("class"))]


def hexagons(root: ET.Element) -> dict[str, int]:
    """Number of hexagons by colour class."""
    paths = [e for e in root.iter("path") if (e.get("class") or "").endswith(" hex")]
    return {str(e.get("class")).split()[0]: str(e.get("d")).count("Z") for e in paths}


def test_density_map_draws_one_hexagon_for_each_occupied_bin() -> None:
    """Draw what was counted and nothing for empty bins."""
    points = np.array([[0.1, 0.0]] * 10 + [[0.3, 0.1]] + [[5.0, 5.0]] * 3)
    assert hexagons(draw_map(points, max_count=10)) == {f"q{palette.LEVELS - 1}": 1, "q0": 1}


def test_density_maps_share_one_scale() -> None:
    """Give a count the colour that the shared maximum makes of it, whatever else is on the map."""
    ten = np.array([[0.1, 0.0]] * 10)
    alone = hexagons(draw_map(ten, max_count=1000))
    with_more = hexagons(draw_map(np.concatenate([ten, [[0.3, 0.1]] * 1000]), max_count=1000))
    expected = f"q{palette.level(np.log10(10) / np.log10(1000))}"
    assert alone == {expected: 1}
    assert with_more[expected] == 1
    assert len(with_more) == 2


def test_density_map_hexagons_lie_where_their_centres_are() -> None:
    """Put x to the right and y upwards, with the frame at the extent's ends."""
    root = draw_map(np.array([[0.1, 0.0], [0.5, 0.2]]), max_count=2)
    frame = next(e for e in root.iter("rect") if e.get("class") == "frame")
    left, top = float(frame.get("x", "")), float(frame.get("y", ""))
    scale = float(frame.get("width", "")) / 0.8
    path = next(e for e in root.iter("path") if (e.get("class") or "").endswith(" hex"))
    drawn = []
    for outline in str(path.get("d")).strip("Z").split("Z"):
        corners = np.array([[float(v) for v in p.split()] for p in outline.strip("M").split("L")])
        middle = corners.mean(axis=0)
        drawn.append([(middle[0] - left) / scale - 0.1, 0.3 - (middle[1] - top) / scale])
    centres = GRID.bin([[0.1, 0.0], [0.5, 0.2]]).centres
    np.testing.assert_allclose(sorted(drawn), sorted(centres.tolist()), atol=1e-4)


def test_density_caption_counts_what_is_off_the_map() -> None:
    """Say how many positions the map does not show."""
    density = GRID.bin([[0.1, 0.0]] * 4 + [[9.0, 0.0]] * 1234 + [[np.nan, 0.0]])
    assert "1,235 are off the map" in density_map.caption(density)
    assert "all are on the map" in density_map.caption(GRID.bin([[0.1, 0.0]]))


def test_density_map_without_positions_is_empty() -> None:
    """Draw a frame around nothing, with no hexagon and no bar."""
    root = draw_map(np.empty((0, 2)), max_count=1, share_max=0.0)
    assert not hexagons(root)
    assert "bar" not in classes(root)


def test_marginals_are_shares_of_all_positions() -> None:
    """Give a strip that holds a quarter of the positions a quarter of the full height."""
    root = draw_map(np.array([[0.11, 0.01]] * 1 + [[5.0, 5.0]] * 3), max_count=1)
    bar = next(e for e in root.iter("path") if e.get("class") == "bar")
    assert re.search(r"v-11h", str(bar.get("d")))  # 44 units high at 100 %


def test_board_is_drawn_only_where_the_map_is() -> None:
    """Leave out the edges of the board that lie on or beyond the map's own edges."""
    root = draw_map(np.array([[0.1, 0.0]]), max_count=1)
    assert str(next(e for e in root.iter("path") if e.get("class") == "edge").get("d")).count("M") == 2
    shared = Map(GRID, EDGES, 1)
    nothing = (np.zeros(40, dtype=np.int64), np.zeros(30, dtype=np.int64))
    far = density_map.density_map(
        GRID.bin([[0.1, 0.0]]), nothing, shared, name="a", share_max=1.0, board=density_map.Outline(3, 4, 3, 4)
    )
    assert 'class="board"' not in far


@pytest.mark.parametrize("largest", [1, 2, 9, 10, 4320, 10_000_000])
def test_count_scale_names_both_ends(largest: int) -> None:
    """Label the largest count, and 1 where they differ."""
    labels = [e.text for e in ET.fromstring(density_map.count_scale(largest)).iter("text")]
    assert f"{largest:,}" in labels
    assert "1" in labels


def test_exact_zero_differs_from_the_smallest_nonzero() -> None:
    """Hatch exact zeros and colour everything above, however small."""
    values = np.array([[0.0, 0.0, 1e-12], [0.0, 0.0, 3.0], [1e-12, 3.0, 0.0]])
    root = ET.fromstring(matrix.matrix_map(values, of="env", name="a"))
    cells = [c for c in classes(root) if c.startswith("cell ")]
    assert sorted(cells) == sorted(["cell zero"] * 2 + ["cell q0 flat"] * 2 + [f"cell q{palette.LEVELS - 1} flat"] * 2)
    assert "1.0e-12 cm" in "".join(root.itertext())


def test_matrices_share_a_logarithmic_scale() -> None:
    """Give a distance the same colour in every matrix of a scale, and each decade as many colours."""
    small, large = (np.array([[0.0, v], [v, 0.0]]) for v in (0.1, 10.0))
    middle = np.array([[0.0, 1.0, np.nan], [1.0, 0.0, 0.1], [np.nan, 0.1, 0.0]])
    scale = matrix.scale_of([small, middle, large, np.zeros((3, 3))])
    assert scale == matrix.Scale(0.1, 10.0)
    drawn = [
        {c for c in classes(ET.fromstring(matrix.matrix_map(m, of="env", name="a", scale=scale))) if "cell q" in c}
        for m in (small, middle, large)
    ]
    top = palette.LEVELS - 1
    assert drawn == [{"cell q0 flat"}, {"cell q0 flat", f"cell q{(top + 1) // 2} flat"}, {f"cell q{top} flat"}]
    assert matrix.scale_of([np.zeros((2, 2))]) is None


def test_matrix_of_zeros_says_so() -> None:
    """Say that every distance is exactly zero, and draw no scale."""
    said = matrix.caption(np.zeros((4, 4)), of="run")
    assert said == "6 pairs of runs. Every distance is exactly 0 (hatched)."
    drawn = matrix.matrix_map(np.zeros((4, 4)), of="run", name="a")
    assert "flat" not in drawn


@pytest.mark.parametrize("n", [1, 2, 20, 21, 128, 129, 300])
def test_matrix_of_any_size_is_well_formed(n: int) -> None:
    """Draw every size, larger ones in blocks that the caption states."""
    rng = np.random.default_rng(n)
    half = np.triu(rng.random((n, n)), k=1)
    values = half + half.T
    root = ET.fromstring(matrix.matrix_map(values, of="env", name="a"))
    assert root.tag == "svg"
    blocks, block = matrix.in_blocks(values)
    assert len(blocks) <= matrix.LARGEST
    assert ("blocks" in matrix.caption(values, of="env")) == (block > 1) == (n > matrix.LARGEST)


def test_blocks_hold_their_largest_value() -> None:
    """Keep a single outlier visible when a matrix is drawn in blocks."""
    values = np.zeros((300, 300))
    values[17, 299] = values[299, 17] = 5.0
    blocks, block = matrix.in_blocks(values)
    assert block == 3
    assert blocks[17 // 3, 299 // 3] == 5.0
    assert (blocks != 0).sum() == 2


def test_matrix_marks_what_is_not_finite() -> None:
    """Show a distance that is not finite as lost, neither as zero nor as large."""
    values = np.array([[0.0, np.nan], [np.nan, 0.0]])
    assert "cell lost" in matrix.matrix_map(values, of="env", name="a")
    assert "Not finite (red edge): 1." in matrix.caption(values, of="env")


def test_radar_leaves_gaps_open() -> None:
    """Give no mark to an axis without a value, and say that nobody has one."""
    compared = [
        SimulatorResult("a", fps=1.0, w1_real=1.0, parallel=0.0, run_to_run=0.0),
        SimulatorResult("b", fps=2.0, w1_real=2.0, parallel=0.0, run_to_run=1.0),
    ]
    root = ET.fromstring(radar_chart.radar_chart(radar(compared)))
    assert len(list(root.iter("circle"))) == 4 + 1  # and one in the legend
    words = [e.text for e in root.iter("text")]
    assert words.count("not measured") == 2
    assert words.count("no difference") == 1
    outline = next(e for e in root.iter("path") if e.get("class") == "g0 line")
    assert "Z" not in str(outline.get("d"))


def test_lines_and_marks_tell_many_groups_apart() -> None:
    """Repeat neither colour with dash nor colour with mark among more groups than there are colours."""
    count = 2 * len(palette.GROUPS_LIGHT)
    assert len({plot.path(i, "M1 8H33") for i in range(count)}) == count
    assert len({plot.mark(i, 17, 8) for i in range(count)}) == count


@pytest.mark.parametrize("dark", [False, True])
def test_palette_is_ordered(dark: bool) -> None:
    """Let lightness go one way from the lowest to the highest value, so that grey print keeps the order."""
    luminance = [_luminance(c) for c in palette.scale(dark=dark)]
    steps = np.diff(luminance)
    assert (steps > 0).all() if dark else (steps < 0).all()
    page = _luminance("#14171b" if dark else "#ffffff")
    contrasts = [(max(c, page) + 0.05) / (min(c, page) + 0.05) for c in luminance]
    assert min(contrasts) > 1.4
    assert max(contrasts) > 10


def _luminance(colour: str) -> float:
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (red, green, blue)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.7), (0.0, 1.0), (-1e-6, 1e-6), (3.0, 1e5)])
def test_ticks_are_few_round_and_inside(low: float, high: float) -> None:
    """Place ticks within the axis only."""
    found = plot.ticks(low, high)
    assert 2 <= len(found) <= 8
    assert min(found) >= low - 1e-9 * abs(low)
    assert max(found) <= high + 1e-9 * abs(high)


def test_hostile_text_stays_text() -> None:
    """Escape what a recording says, in text and in attributes, and show what XML cannot hold."""
    for drawn in (
        svg.text(HOSTILE, 0, 0),
        svg.figure(1, 1, HOSTILE, svg.title(HOSTILE)),
        matrix.matrix_map(np.zeros((2, 2)), of="env", name=HOSTILE),
    ):
        root = ET.fromstring(drawn)
        assert "script" not in {e.tag for e in root.iter()}
        assert "\x00" not in drawn
        drawn.encode("utf-8")


def test_coordinates_must_be_finite() -> None:
    """Refuse a coordinate that no picture can hold."""
    with pytest.raises(ValueError, match="finite"):
        svg.number(float("nan"))
    assert svg.number(-0.001) == "0"


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.9, 120.0, [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]),
        (90.0, 2e5, [100.0, 1000.0, 10000.0, 100000.0]),
        (3.0, 4.0, [3.0, 3.5, 4.0]),
    ],
)
def test_logarithmic_ticks(low: float, high: float, expected: list[float]) -> None:
    """Put round values on a logarithmic axis, finer where it is short."""
    assert plot.log_ticks(low, high) == pytest.approx(expected)


def test_ticks_at_powers_of_two() -> None:
    """Thin powers of two out evenly, and never leave the axis."""
    assert plot.power_ticks(0.9, 40) == [1, 2, 4, 8, 16, 32]
    many = plot.power_ticks(1, 2**20)
    assert len(many) <= 8
    assert many[0] == 1
    assert plot.power_ticks(5, 7) == []
    with pytest.raises(ValueError, match="positive"):
        plot.log_ticks(0, 1)


def draw_scaling(curves: list[scaling.Curve], **keywords: object) -> ET.Element:
    """A scaling chart, parsed."""
    return ET.fromstring(scaling.scaling_chart(curves, value=HOSTILE, tick=str, **keywords))  # type: ignore[arg-type]


def test_scaling_curves() -> None:
    """Draw a mark a point, ring N_env^max, cross the next N, and say why the curve ends."""
    points = ((1.0, 10.0), (2.0, 20.0), (4.0, 40.0), (8.0, 50.0))
    curve = scaling.Curve(0, HOSTILE, points, model=lambda n: 10 * n, ideal=True, n_max=8, failed=16, ends="no memory")
    root = draw_scaling([curve, scaling.Curve(1, "other", ((1.0, 5.0),)), scaling.Curve(2, "empty", ())])
    marks = [e for e in root.iter("circle") if e.get("class") == "g0"]
    assert len(marks) == 4 + 1  # and one in the legend
    across = [float(e.get("cx", "")) for e in marks[:3]]
    assert across[1] - across[0] == pytest.approx(across[2] - across[1], abs=0.05)
    assert classes(root).count("g0 end-ring") == 1
    assert classes(root).count("cross") == 1
    assert classes(root).count("g0 model") == 1
    assert any((e.text or "").endswith(", max 8 envs") for e in root.iter("text"))
    (ideal,) = (e.get("d", "") for e in root.iter("path") if e.get("class") == "ideal")
    (x1, y1), (x2, y2) = ([float(v) for v in part.split()] for part in ideal[1:].split("L"))
    middle = [float(e.get("cy", "")) for e in marks[:3]]
    assert (y1 - middle[1]) / (across[1] - across[0]) == pytest.approx((y1 - y2) / (x2 - x1), abs=0.01)
    assert y2 >= 14  # not above the frame
    said = [e.text or "" for e in root.iter("title")]
    assert any("no memory" in text and "alert" in text for text in said)


def test_dots_have_whole_names_and_whole_counts() -> None:
    """Write long names above their rows, and no half between counts; ring exact zeros."""
    name = "mjx [determinism=exclude-nondeterministic, impl=jax]"
    dots = [dot_plot.Dot(0, name, 0.0), dot_plot.Dot(1, "b", 2.0)]
    root = ET.fromstring(dot_plot.dot_plot(dots, value="checks", tick=plot.tick_label, best_first=False))
    assert [t.text for t in root.iter("text")] == ["0", "1", "2", "checks", name, "b"]
    assert classes(root).count("g0 nothing") == 1


def test_no_line_through_three_points() -> None:
    """Draw marks alone of a sweep or a run with so few points, whatever model or fit there is."""
    three = ((1.0, 10.0), (2.0, 20.0), (4.0, 30.0))
    few = draw_scaling([scaling.Curve(0, "a", three, model=lambda n: 10 * n, ideal=True, n_max=4)])
    assert not {"g0 line", "g0 model", "ideal"} & set(classes(few))
    times = np.array([0.0, 2.5, 5.0])
    curve = divergence.Curve(0, "run 0", times, times * 0.1, times * 0.05, None)
    root = ET.fromstring(divergence.divergence_chart([curve], onset=None, name="a"))
    assert not [e for e in root.iter("path") if {"line", "model"} & set(e.get("class", "").split())]
    assert classes(root).count("g0") == classes(root).count("g0 nothing") == 3


def test_zeros_keep_the_room_of_their_label() -> None:
    """Leave out a tick whose label would meet that of the strip of zeros."""
    times = np.arange(4.0)
    curve = divergence.Curve(0, "a", times, np.array([0.0, 0.0199, 0.1, 0.2]), times * 0.0, None)
    root = ET.fromstring(divergence.divergence_chart([curve], onset=None, name="a"))
    heights = sorted(float(e.get("y", "")) for e in root.iter("text") if e.get("class") == "end")
    assert min(b - a for a, b in zip(heights, heights[1:], strict=False)) >= 12


def test_scaling_of_strange_values() -> None:
    """Draw one point, equal values and models below zero; draw nothing where there is nothing."""
    alone = draw_scaling([scaling.Curve(0, "a", ((1.0, 3.0),), model=lambda n: -1.0, n_max=1)])
    assert "g0 model" not in classes(alone)
    flat = draw_scaling(
        [scaling.Curve(0, "a", ((1.0, 3.0), (4.0, 3.0), (64.0, 3.0), (1024.0, 3.0)), model=lambda n: n - 500)]
    )
    assert "g0 model" in classes(flat)
    assert scaling.scaling_chart([], value="v", tick=str) == ""
    assert scaling.scaling_chart([scaling.Curve(0, "a", ())], value="v", tick=str) == ""


def test_published_points_are_marked_as_foreign() -> None:
    """Draw somebody else's points as hollow diamonds with their names, apart from each other."""
    points = [scaling.Foreign(f"engine {i}", 2.0**10, 5.0 + i / 100) for i in range(4)]
    root = draw_scaling([scaling.Curve(0, "a", ((1.0, 3.0),))], foreign=points)
    assert classes(root).count("foreign") == 4
    heights = sorted(float(e.get("y", "")) for e in root.iter("text") if (e.text or "").startswith("engine"))
    assert min(np.diff(heights)) >= 12


FIGURES = ["matrix", "map", "scale", "radar", "scaling", "classes", "dots", "divergence", "tree", "scatter", "curves"]


def every_figure() -> list[str]:
    """One of each kind, with all that it can show."""
    values = np.array([[0.0, 0.0, np.nan], [0.0, 0.0, 3.0], [np.nan, 3.0, 0.0]])
    points = np.array([[0.1, 0.0]] * 10 + [[0.3, 0.1]])
    sides = (marginal(points[:, 0], EDGES[0]), marginal(points[:, 1], EDGES[1]))
    board = density_map.Outline(0.0, 0.6, -0.3, 0.3)
    compared = [SimulatorResult("a", fps=1.0, parallel=0.0), SimulatorResult("b", fps=2.0, parallel=0.0)]
    curve = scaling.Curve(0, "a", ((1.0, 10.0), (2.0, 20.0)), model=lambda n: 10 * n, n_max=2, failed=4)
    times = np.arange(1.0, 9.0) / 10
    grown = 1e-6 * np.exp(8 * times)
    apart = divergence.Curve(0, "a", times, grown, grown / 2, GrowthFit(8.0, 1.0, 8, 0.1, 0.8, 0.9, ""))
    split = SplitTree((Branch(0, None, 0, 4, 2, (0, 1)), Branch(2, 0, 5, 2, 2, (2, 3))), 0, 0, 10)
    return [
        matrix.matrix_map(values, of="env", name=HOSTILE),
        density_map.density_map(GRID.bin(points), sides, Map(GRID, EDGES, 10), name="a", share_max=1.0, board=board),
        density_map.count_scale(10),
        radar_chart.radar_chart(radar(compared)),
        scaling.scaling_chart([curve], value=HOSTILE, tick=str, foreign=[scaling.Foreign("x", 2.0, 5.0)]),
        matrix.matrix_map(values, of="env", name="a", classes=[0, 0, 1]),
        dot_plot.dot_plot(
            [dot_plot.Dot(0, HOSTILE, 0.0), dot_plot.Dot(1, "b", 2.0, 1.0, 3.0, open=True)], value="v", tick=str
        ),
        divergence.divergence_chart([apart], onset=0.2, name=HOSTILE),
        tree.tree_chart(split, dt=0.01, of="env", names=range(4), label=HOSTILE),
        scatter.scatter(
            [
                scatter.Point(i, f"{HOSTILE}{i}", 9.0 + i, 0.1 * (i % 2), (8.0, 11.0), (0.0, 0.2), i == 0)
                for i in range(9)
            ],
            across="x",
            up="y",
            across_tick=str,
            up_tick=str,
        ),
        curves.curves_chart(
            [(HOSTILE, times), ("b", grown)], np.arange(8), [curves.End(3, terminated=False)], name=HOSTILE
        ),
    ]


@pytest.mark.parametrize("drawn", every_figure(), ids=FIGURES)
def test_figures_stand_alone(drawn: str) -> None:
    """Leave a page with colours in every element: no style sheet, no variable, nothing from outside."""
    text = style.standalone(drawn, matrix.hatch())
    root = ET.fromstring(text.encode())
    name = "{http://www.w3.org/2000/svg}"
    assert root.tag == f"{name}svg"
    assert {"width", "height", "viewBox"} <= set(root.attrib)
    assert "style" not in {key for e in root.iter() for key in e.attrib}
    assert "var(" not in text
    ruled = {selector[1:] for selector, _ in style.resolved() if selector.startswith(".")}
    assert {c for e in root.iter() for c in (e.get("class") or "").split()} <= ruled | {"cell", "ring"}
    for one in root.iter():
        if one.tag in {f"{name}{tag}" for tag in ("rect", "path", "circle", "line", "text")}:
            assert one.get("fill") or one.get("stroke"), one.attrib
        for value in one.attrib.values():
            assert "url(" not in value or value == "url(#hatch)"
    if "url(#hatch)" in text:
        assert [e.get("id") for e in root.iter(f"{name}pattern")] == ["hatch"]


def test_rules_are_css() -> None:
    """Give pages the rules that files are resolved from, with the later one winning."""
    assert "svg .edge { stroke: var(--edge); stroke-width: 1.2; stroke-dasharray: 5 3; fill: none; }" in style.css()
    drawn = svg.figure(
        10, 10, "a", svg.text("x", 1, 2, class_="small end"), svg.element("path", d="M0 0", class_="g1 line")
    )
    root = ET.fromstring(style.standalone(drawn, matrix.hatch()))
    shown = root.find("{*}text")
    line = root.find("{*}path")
    assert shown is not None
    assert [shown.get(k) for k in ("font-size", "text-anchor", "fill")] == [
        "10.5",
        "end",
        palette.theme(dark=False)["quiet"],
    ]
    assert (line.get("fill"), line.get("stroke")) == ("none", palette.GROUPS_LIGHT[1])
