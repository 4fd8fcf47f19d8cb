"""gsb-view of a task's recording: rewards, actions and observations as curves."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.cli.view import main
from gpusimbench.evaluator.player.page import task_document
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.evaluator.render.document import Figure, Section
from gpusimbench.evaluator.render.figures.curves import MAX_BINS, End, curves_chart, shown_ends, shown_rows
from gpusimbench.schemas.errors import ExitCode
from tests.browser import Browser, needs_chromium
from tests.conftest import made_once
from tests.scripts import example

pytest.importorskip("gymnasium")
search = example("search")


@pytest.fixture(scope="module")
def recorded() -> Path:
    """Five environments of the example, in the mode whose calls of step may make no step."""
    folder = made_once("task-page", lambda at: search.record("near", at / "Near.mcap", 5, 2, 1))
    return folder / "Near.mcap"


def test_a_page_has_the_arrays_of_each_environment(recorded: Path) -> None:
    """Draw three figures of each shown environment, and a line at the end of each of its episodes."""
    recording = open_recording(recorded)
    sections = [block for block in task_document([recording], (), "gsb-view").blocks if isinstance(block, Section)]
    assert [one.title for one in sections] == ["Env 0", "Env 1", "Env 2", "Env 3"]
    (chosen,) = [b for b in task_document([recording], (4, 4), "gsb-view").blocks if isinstance(b, Section)]
    for env, section in [*enumerate(sections), (4, chosen)]:
        figures = [block for block in section.blocks if isinstance(block, Figure)]
        assert [one.label for one in figures] == ["reward", "action", "observation"]
        ended = [one for one in episodes(recording) if one.env == env and one.ended]
        assert f"{len(ended)} episodes ended" in section.summary or len(ended) == 1
        for one in figures:
            marks = [line for line in ET.fromstring(str(one.svg)).iter("line") if line.find("title") is not None]
            said = [str(line.findtext("title")).partition(": ")[2] for line in marks]
            assert said == ["terminated" if e.terminated else "truncated" for e in ended]
    reward = next(block for block in sections[0].blocks if isinstance(block, Figure))
    steps = sum(len(one) for one in episodes(recording) if one.env == 0)
    (path,) = [p for p in ET.fromstring(str(reward.svg)).iter("path") if "line" in str(p.get("class"))]
    assert len(re.findall("[ML]", str(path.get("d")))) == steps, "a point for each step that was made, and for no other"


def test_two_recordings_and_environments_that_are_not_there(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Name files by letters as they are spelt; refuse an environment that is not there, and other programs."""
    other = tmp_path / "Other.mcap"
    search.record("sweep", other, 5, 2, 1)
    page = tmp_path / "page.html"
    assert main([str(recorded), str(other), "--env", "1", "--no-open", "--out", str(page)]) == ExitCode.OK
    text = page.read_text(encoding="utf-8")
    assert "a is Near.mcap, b is Other.mcap" in text and text.count('role="img"') >= 6
    assert main([str(recorded), "--env", "5", "--no-open", "--out", str(tmp_path / "no.html")]) == ExitCode.USAGE
    assert "has no environment 5" in capsys.readouterr().err
    assert not (tmp_path / "no.html").exists()


def test_long_curves_keep_their_extremes_and_gaps() -> None:
    """Draw of a long curve a bounded number of points, among them the largest, the smallest and each gap."""
    values = np.sin(np.arange(100_000) / 50.0)
    values[31_234], values[70_001], values[50_000:50_010] = 9.0, -9.0, np.nan
    rows = shown_rows(values)
    assert len(rows) <= 3 * MAX_BINS + 2
    assert {0, 31_234, 70_001, 99_999} <= set(rows.tolist()) and np.isnan(values[rows]).any()
    assert (np.diff(rows) > 0).all()


@pytest.mark.parametrize("value", [0.0, 1e300, -1e-300, 5e-324, np.nan, np.inf])
def test_any_number_can_be_drawn(value: float) -> None:
    """Make a well-formed picture of constants, of extreme and of missing numbers; none where nothing is finite."""
    steps = np.arange(3)
    for values in (np.full(3, value), np.array([1.0, value, -1.0])):
        drawn = curves_chart([("a", values)], steps, [End(1, terminated=True)], name="<a>")
        if np.isfinite(values).any() and (np.abs(values[np.isfinite(values)]) < 1e100).any():
            ET.fromstring(drawn)
        else:
            assert drawn == ""


@needs_chromium
def test_the_page_in_a_browser(recorded: Path, tmp_path: Path) -> None:
    """Show pictures of some size, without an error and without a request."""
    page = tmp_path / "page.html"
    assert main([str(recorded), "--no-open", "--out", str(page)]) == ExitCode.OK
    with Browser() as browser:
        browser.open(page)
        sizes = browser.page.eval_on_selector_all(
            "svg[role=img]", "all => all.map(one => [one.clientWidth, one.clientHeight])"
        )
        assert len(sizes) == 12 and all(width > 300 and height > 100 for width, height in sizes)
        assert browser.errors == [] and browser.requests == []


def test_a_page_does_not_grow_with_the_ends_of_episodes() -> None:
    """Draw few ends of many episodes, both kinds of them, over the whole picture."""
    steps, values = np.arange(100_001), np.zeros(100_001)
    ends = [End(step, step % 1000 != 0) for step in range(1, 100_001)]
    shown = shown_ends(ends, 0, 100_000)
    assert MAX_BINS < len(shown) <= 2 * (MAX_BINS + 1)
    assert {end.terminated for end in shown} == {True, False}
    assert np.diff(sorted(end.step for end in shown)).max() <= 100_000 / MAX_BINS
    assert shown_ends(ends[:MAX_BINS], 0, 100_000) == ends[:MAX_BINS]
    assert len(curves_chart([("a", values)], steps, ends, name="a")) < 200_000


def test_the_legend_shows_what_is_drawn() -> None:
    """Show marks beside the names of curves whose points are marked, and of no others."""
    for n, marked in ((10, True), (200, False)):
        rising = np.arange(n, dtype=np.float64)
        drawn = curves_chart([("a", rising), ("b", -rising)], np.arange(n), [], name="c")
        # of the second curve: a square; the frame is a rectangle as well
        assert ("<circle" in drawn, drawn.count("<rect") > 1) == (marked, marked), n
