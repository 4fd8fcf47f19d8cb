"""The player in the report: which groups it plays, within what a page can hold, and what the page's policy allows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gpusimbench.evaluator.player.encode import encode
from gpusimbench.evaluator.player.page import script
from gpusimbench.evaluator.render.templating import script as download
from gpusimbench.evaluator.report.document import write_html
from gpusimbench.evaluator.report.source import BUDGET_BYTES, playback_of
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from tests.browser import Browser, needs_chromium
from tests.evaluator.test_html import Page
from tests.evaluator.test_player_clip import diverging
from tests.synthetic import grid, write_recording

HOSTILE = "</script><script>window.hacked = 1</script><img src=x onerror=hacked=1>"
SAID = "document.querySelector('.gsb-player .distinct').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs that part, two that do not, one of a hostile name, one without states."""
    made = tmp_path_factory.mktemp("groups")
    for run in range(2):
        write_recording(made, grid(2), run=run, simulator="alike", name=f"alike-{run}.mcap")
        diverging(made, run=run, simulator="parting", name=f"parting-{run}.mcap")
    write_recording(made, grid(2), simulator=HOSTILE, name="hostile.mcap")
    write_recording(made, None, simulator="blind", name="blind.mcap")
    return made


@pytest.fixture(scope="module")
def evaluation(folder: Path) -> Evaluation:
    """Of all of them."""
    return evaluate_files(sorted(folder.glob("*.mcap")), sample_time=1.0)


def test_groups_that_part_first_come_first(evaluation: Evaluation) -> None:
    """Play every group that captured states, those that part ahead of those that do not, and name the rest."""
    found = playback_of(evaluation.results)
    assert found.clips[0].title == "parting"
    assert {clip.title for clip in found.clips} >= {"parting", "alike"}
    assert len(found.clips) == 3
    (missing,) = found.not_shown
    assert missing.labels == ("blind",)
    assert missing.reason == "no complete run captured states"
    assert sum(len(encode(clip)) for clip in found.clips) < BUDGET_BYTES


def test_a_page_without_room_names_what_is_missing(evaluation: Evaluation) -> None:
    """Leave out what does not fit, last those that part first, and say so."""
    whole = playback_of(evaluation.results)
    found = playback_of(evaluation.results, budget=len(encode(whole.clips[0])))
    assert [clip.title for clip in found.clips] == ["parting"]
    assert any("no more room" in one.reason and "alike" in one.labels for one in found.not_shown)


def test_files_that_went_away_are_named(tmp_path: Path) -> None:
    """Write the report all the same where a recording is gone when the page is made."""
    path = write_recording(tmp_path, grid(2), simulator="gone")
    evaluation = evaluate_files([path], sample_time=1.0)
    path.unlink()
    found = playback_of(evaluation.results)
    assert found.clips == ()
    assert str(path) in found.not_shown[0].reason
    text = write_html(evaluation, tmp_path / "report", published=False, command="gsb-eval").read_text()
    assert "gsb-player" not in text
    assert "<li>Playback: gone: cannot read" in text[text.index('id="left-out"') :]


def test_the_page_has_two_scripts_and_no_other_file(evaluation: Evaluation, tmp_path: Path) -> None:
    """Hold nothing that runs but our own scripts, which the policy names by their hashes."""
    text = write_html(evaluation, tmp_path, published=False, command="gsb-eval").read_text(encoding="utf-8")
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", text, re.DOTALL)
    assert [s for kind, s in scripts if not kind] == [download("page.js"), download("download.js"), script()]
    assert {kind for kind, _ in scripts if kind} == {' type="application/json" class="clip"'}
    for tag, attributes in Page(text).tags:
        assert tag not in {"link", "iframe", "object", "embed", "img", "base", "form"}
        assert not any(name.startswith("on") or name == "src" for name in attributes)
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text.replace("&#39;", "'"))
    assert re.fullmatch(
        r"default-src 'none'; script-src( 'sha256-[A-Za-z0-9+/]{43}='){3}; style-src 'unsafe-inline'; "
        r"base-uri 'none'; form-action 'none'",
        policy,
    )


@needs_chromium
def test_the_report_plays_its_groups(evaluation: Evaluation, tmp_path: Path) -> None:
    """Play a group in the report, then another, with no error, no request, and no script of a stranger."""
    page = write_html(evaluation, tmp_path, published=False, command="gsb-eval")
    with Browser() as browser:
        browser.open(page)
        browser.evaluate("document.querySelector('#playback').closest('details').open = true")
        titles = browser.evaluate("[...document.querySelectorAll('.clips option')].map(option => option.textContent)")
        assert titles[0] == "parting: 3 of 8 environments of 2 runs"
        browser.click("button.first")
        assert browser.evaluate(SAID).startswith("2 distinct of 8")
        for index in range(len(titles)):
            browser.evaluate(
                "(() => { const choice = document.querySelector('.clips');"
                f"choice.value = {index}; choice.dispatchEvent(new Event('change')); }})()"
            )
            assert browser.evaluate(SAID).startswith("all ")
        assert browser.evaluate("[window.hacked ?? 0, document.querySelectorAll('img').length]") == [0, 0]
        assert browser.errors == []
        assert browser.requests == []
        browser.open(page, width=1280, height=1024, zoom=4)
        assert browser.evaluate("document.querySelector('.gsb-player').scrollWidth <= innerWidth")
        browser.open(page, scripts=False)
        assert browser.errors == []
    text = page.read_text(encoding="utf-8")
    assert "The 8 environments of 2 runs first differ at step 40 (0.4 s)" in text
