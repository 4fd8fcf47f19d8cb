"""The scatter of speed against divergence, and where its labels stand."""

from __future__ import annotations

import csv
import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.render.document import Figure
from gpusimbench.evaluator.render.figures.plot import tick_label
from gpusimbench.evaluator.render.figures.scatter import Box, Point, place, scatter
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.report.sections.scatter import pictures
from gpusimbench.evaluator.results.evaluate import evaluate_files
from tests.synthetic import grid, write_recording

ROOT = Path(__file__).resolve().parent.parent.parent
FRAME = Box(66, 10, 548, 286)
SIZES = st.one_of(st.just(0.0), st.floats(1e-6, 1e4))


def drawn(points: list[Point]) -> ET.Element:
    """A scatter, parsed."""
    return ET.fromstring(
        scatter(points, across="speed [1/s]", up="W1 [cm]", across_tick=tick_label, up_tick=tick_label)
    )


def texts(figure: ET.Element) -> list[str]:
    """Everything that is written in it."""
    return ["".join(t.itertext()) for t in figure.iter("text")]


@given(
    st.lists(
        st.tuples(st.floats(70, 545), st.floats(14, 282), st.text("abc [=]", min_size=1, max_size=24)),
        min_size=1, max_size=13,
    )
)  # fmt: skip
def test_labels_cover_nothing(found: list[tuple[float, float, str]]) -> None:
    """Place labels within the frame, none over a mark or another label; the same points give the same places."""
    points, names = [(x, y) for x, y, _ in found], [name for *_, name in found]
    marks = [Box(x - 6, y - 6, x + 6, y + 6) for x, y in points]
    placed = place(points, names, marks=marks, whiskers=[], frame=FRAME)
    boxes = [label.box for label in placed if label]
    assert all(box.within(FRAME) for box in boxes)
    assert not any(box.meets(mark) for box in boxes for mark in marks)
    assert not any(a.meets(b) for a, b in combinations(boxes, 2))
    assert placed == place(points, names, marks=marks, whiskers=[], frame=FRAME)


def test_thirteen_engines_find_room() -> None:
    """Name all of thirteen engines inside the figure, seven of them at exactly zero."""
    points = [Point(i, f"engine-{i}", 500 * 1.5**i, 0.0 if i % 2 else 0.1 * i + 0.1) for i in range(13)]
    labels = [t for t in drawn(points).iter("text") if (t.text or "").startswith("engine")]
    assert [label.text for label in labels] == [p.label for p in points]
    assert all(float(label.attrib["y"]) < 286 for label in labels)


@given(st.lists(st.tuples(st.floats(1e-3, 1e12), SIZES, SIZES, st.booleans()), min_size=1, max_size=20))
def test_any_values_are_drawn(found: list[tuple[float, float, float, bool]]) -> None:
    """Draw whatever is measured: every label is written once, and zero has a strip where something is exactly that."""
    points = [
        Point(i, f"e{i}", speed, far, (speed * 0.9, speed * 1.1), (0.0, far + more), broken)
        for i, (speed, far, more, broken) in enumerate(found)
    ]
    figure = drawn(points)
    written = texts(figure)
    assert sorted(t for t in written if t.startswith("e") and t[1:].isdigit()) == sorted(p.label for p in points)
    assert ("exactly 0" in written) == any(p.divergence == 0 for p in points)
    hollow = [e for e in figure.iter() if "nothing" in e.get("class", "").split()]
    assert len(hollow) == sum(p.broken for p in points)


def test_a_strangers_label_stays_text() -> None:
    """Escape names, and say in words what is fastest and what is exactly zero."""
    points = [Point(0, "<b>\x00", 10.0, 0.0), Point(1, "fast", 100.0, 2.0), Point(2, "wrong", 1000.0, 1.0, broken=True)]
    figure = drawn(points)
    assert not list(figure.iter("b"))
    assert "exactly 0: <b>" in figure.attrib["aria-label"]
    assert figure.attrib["aria-label"].endswith("fastest that is valid: fast")
    assert not scatter([], across="", up="", across_tick=tick_label, up_tick=tick_label)


def test_a_figure_has_the_groups_of_its_scene_alone(tmp_path: Path) -> None:
    """Draw a figure a scene, without groups of the other one."""
    for run in range(2):
        for scene, simulator in (("inclined-collision", "a"), ("inclined-collision", "b"), ("free-fall", "c")):
            write_recording(tmp_path, grid(2), scene=scene, simulator=simulator, run=run, elapsed_s=2.0, proven=True)
    found = list(pictures(evaluate_files(sorted(tmp_path.glob("*.mcap")))))
    assert sorted(sorted(str(name) for name, *_ in figure.numbers.rows) for figure in found) == [["a", "b"], ["c"]]


@pytest.fixture(scope="module")
def shipped() -> Iterator[Figure]:
    """The scatter of the recordings of MuJoCo and of Brax, whose environments fall through the board."""
    files = [
        *(ROOT / "recordings").glob("mujoco-*.mcap"),
        *(ROOT / "recordings/protocol-h200").glob("brax-positional-*.mcap"),
    ]
    [found] = pictures(evaluate_files(sorted(files)))
    yield found


@pytest.mark.slow
def test_shipped_recordings(shipped: Figure) -> None:
    """Show MuJoCo at exactly zero, all hollow, with the numbers and what speaks against Brax.

    Cubes of MuJoCo go deeper into each other than physics-2 allows, and Brax's through the board.
    """
    rows = list(csv.DictReader(io.StringIO(to_csv(shipped.numbers.titles, shipped.numbers.rows), newline="")))
    assert [float(r["W1 between runs [cm]"]) for r in rows if r["group"].startswith("mujoco")] == [0.0, 0.0, 0.0]
    [brax] = [r for r in rows if r["group"] == "brax"]
    assert "bodies per env sank" in brax["what speaks against it"]
    figure = ET.fromstring(str(shipped.svg))
    assert sum("nothing" in e.get("class", "").split() for e in figure.iter()) == 4
    assert {"mujoco", "brax †", "exactly 0"} <= set(texts(figure))
    assert "exactly 0 (3)" in shipped.caption
