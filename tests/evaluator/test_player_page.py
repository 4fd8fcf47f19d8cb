"""The player in a real browser: what it says and draws is what the recordings have, by mouse and by keys alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.metrics.identity import distinct_over_time
from gpusimbench.evaluator.player.clip import make_clip
from gpusimbench.evaluator.player.page import markup, render_page, script
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.figures.palette import GROUPS_DARK, GROUPS_LIGHT
from tests.browser import Browser, needs_chromium
from tests.evaluator.test_player_clip import diverging
from tests.synthetic import grid, write_recording

pytestmark = needs_chromium

SHIPPED = Path(__file__).resolve().parents[2] / "recordings"
PAINTED = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three classes in the end: split at steps 40 and 60."""
    return Recording(diverging(tmp_path_factory.mktemp("diverging")))


@pytest.fixture(scope="module")
def page(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of that recording."""
    return written(tmp_path_factory.mktemp("page"), [recording])


def written(folder: Path, recordings: list[Recording]) -> Path:
    """A page as gsb-view writes it."""
    path = folder / "view.html"
    path.write_text(render_page(make_clip(recordings), recordings, command="gsb-view"), encoding="utf-8")
    return path


def text(browser: Browser, selector: str) -> str:
    """What an element says."""
    return str(browser.evaluate(f"document.querySelector('{selector}').textContent"))


def step(browser: Browser) -> int:
    """Where the slider stands."""
    return int(browser.evaluate("Number(document.querySelector('.at').value)"))


def go(browser: Browser, to: int) -> None:
    """Move the slider, as a reader's browser does, and wait until it is drawn."""
    choose(browser, ".at", str(to), "input")
    browser.evaluate(PAINTED)


def choose(browser: Browser, selector: str, value: str, event: str = "change") -> None:
    """Set a control and say so, as a browser does for its reader."""
    browser.evaluate(
        f"(() => {{ const control = document.querySelector('{selector}'); control.value = '{value}';"
        f"control.dispatchEvent(new Event('{event}')); }})()"
    )


def pixels(browser: Browser, colour: str) -> int:
    """How many pixels of the picture have nearly the hue of a colour, bright or dark."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return int(
        browser.evaluate(
            "(() => { const c = document.querySelector('.view');"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
            f"const w = [{red}, {green}, {blue}], m = Math.max(...w);"
            "for (let i = 0; i < d.length; i += 4) { const p = [d[i], d[i + 1], d[i + 2]], k = Math.max(...p);"
            "if (d[i + 3] === 255 && k > 40 && p.every((v, j) => Math.abs(v / k - w[j] / m) < 0.04)) n++; }"
            "return n; })()"
        )
    )


def test_counts_are_those_of_the_recording(browser: Browser, recording: Recording, page: Path) -> None:
    """Say at every step as many distinct environments as the recording's hashes give."""
    browser.open(page)
    prints = recording.fingerprints("capture")
    counts = distinct_over_time(prints.hashes).histories
    for at in (0, 1, 39, 40, 41, 59, 60, 99, 100):
        go(browser, at)
        expected = f"{counts[at]} distinct of 4" if counts[at] > 1 else "all 4 environments bit-identical so far"
        assert text(browser, ".distinct").startswith(expected), at
        assert f"step {at} of 100" in text(browser, ".moment")
    assert browser.errors == []
    assert browser.requests == []


def test_the_first_divergence_is_one_click_away(browser: Browser, page: Path) -> None:
    """Jump to the step at which bits part, and from split to split."""
    browser.open(page)
    assert text(browser, ".distinct") == "all 4 environments bit-identical so far"
    browser.click("button.first")
    assert step(browser) == 40
    assert text(browser, ".distinct") == "2 distinct of 4 environments so far"
    assert "drawn" not in text(browser, ".moment"), "every step around the divergence has its state"
    browser.click("button.back")
    assert text(browser, ".distinct") == "all 4 environments bit-identical so far"
    browser.click("button.next")
    browser.click("button.next")
    assert step(browser) == 60
    assert browser.evaluate("document.querySelector('button.next').disabled")
    browser.click("button.before")
    assert step(browser) == 40
    assert text(browser, ".loud").startswith("2 distinct of 4 environments so far, step 40 of 100")
    assert browser.evaluate("document.querySelectorAll('.marks line').length") == 2
    assert browser.errors == []


@pytest.mark.parametrize("dark", [False, True])
def test_colours_split_where_bits_split(browser: Browser, page: Path, dark: bool) -> None:
    """Draw one colour while all are the same, and one more for each class that parts and moves away."""
    colours = GROUPS_DARK if dark else GROUPS_LIGHT
    browser.open(page, dark=dark)
    go(browser, 39)
    assert pixels(browser, colours[0]) > 200
    assert pixels(browser, colours[2]) < 20
    go(browser, 40)
    assert min(pixels(browser, colours[0]), pixels(browser, colours[1])) > 60, "both, though in the same place"
    go(browser, 100)
    assert pixels(browser, colours[2]) > 200
    chipes = "[...document.querySelectorAll('.chip')].map(s => s.className + ' ' + s.textContent)"
    assert browser.evaluate(chipes) == ["chip k0 0", "chip k1 2", "chip k2 3"]
    go(browser, 0)
    assert browser.evaluate(chipes) == ["chip k0 0", "chip k0 0", "chip k0 0"]


def test_the_keyboard_suffices(browser: Browser, page: Path) -> None:
    """Reach every control by Tab, and do with keys what the mouse does."""
    browser.open(page)
    reached = []
    for _ in range(20):
        browser.key("Tab")
        reached.append(browser.evaluate("document.activeElement.className || document.activeElement.tagName"))
    assert {"view", "at", "play", "back", "on", "first", "next", "speed", "layout", "reset", "INPUT"} <= {
        *reached,
        "back",
    }
    browser.evaluate("document.querySelector('.view').focus()")
    picture = "document.querySelector('.view').toDataURL()"
    before = browser.evaluate(picture)
    browser.key("ArrowLeft")
    browser.evaluate(PAINTED)
    turned = browser.evaluate(picture)
    assert turned != before
    browser.key("+")
    browser.evaluate(PAINTED)
    assert browser.evaluate(picture) != turned
    browser.key("0")
    browser.evaluate(PAINTED)
    assert browser.evaluate(picture) == before
    browser.key("f")
    assert step(browser) == 40
    browser.key(".")
    assert step(browser) == 41
    browser.key(",")
    browser.key("n")
    assert step(browser) == 60
    browser.key("End")
    assert step(browser) == 100
    browser.evaluate("document.querySelector('.at').focus()")
    browser.key("ArrowLeft")
    assert step(browser) == 99
    assert "step 99 of 100" in str(browser.evaluate("document.querySelector('.at').getAttribute('aria-valuetext')"))
    assert browser.errors == []


def test_keys_work_before_anything_is_clicked(browser: Browser, page: Path) -> None:
    """Take the keys of the list on a page of the player's own, where a reader has clicked nothing yet."""
    browser.open(page)
    assert browser.evaluate("document.activeElement.tagName") == "BODY"
    for key, expected in (("f", 40), (".", 41), ("End", 100), ("Home", 0)):
        browser.key(key)
        assert step(browser) == expected


def test_a_phone_shows_picture_and_controls_together(browser: Browser, page: Path) -> None:
    """Leave room for the button that plays on a screen that is higher than wide."""
    browser.open(page, width=420, height=900)
    assert browser.evaluate("document.querySelector('.play').getBoundingClientRect().bottom") <= 900


def test_the_mouse_turns_and_points(browser: Browser, page: Path) -> None:
    """Turn by dragging; zoom by the wheel only once the picture is in use; name what is under the pointer."""
    browser.open(page)
    go(browser, 0)
    picture = "document.querySelector('.view').toDataURL()"
    before = browser.evaluate(picture)
    browser.wheel(".view", 300)
    browser.evaluate(PAINTED)
    assert browser.evaluate(picture) == before
    browser.drag(".view", 60, 20)
    browser.evaluate(PAINTED)
    turned = browser.evaluate(picture)
    assert turned != before
    browser.wheel(".view", 300)
    browser.evaluate(PAINTED)
    assert browser.evaluate(picture) != turned
    browser.click("button.reset")
    browser.evaluate(PAINTED)
    assert browser.evaluate(picture) == before
    where = browser.evaluate(
        "(() => { const c = document.querySelector('.view'), r = c.getBoundingClientRect();"
        "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "for (let i = 0; i < d.length; i += 4) if (d[i + 2] > 90 && d[i] < 30 && d[i + 3] === 255)"
        "return [r.x + (i / 4) % c.width + 2, r.y + Math.floor(i / 4 / c.width) + 4]; })()"
    )
    browser.point(*where)
    assert "env 0: cube_" in text(browser, ".pointed")


def test_it_plays_and_stops(browser: Browser, page: Path) -> None:
    """Play to the end at the chosen speed, pause by the same key, and begin again behind the end."""
    browser.open(page)
    choose(browser, ".speed", "4")
    browser.click("button.play")
    assert text(browser, "button.play") == "Pause"
    browser.wait("document.querySelector('button.play').textContent === 'Play'")
    assert step(browser) == 100
    choose(browser, ".speed", "0.05")
    browser.evaluate("document.querySelector('.view').focus()")
    browser.key("Space")
    browser.wait("Number(document.querySelector('.at').value) < 100")
    browser.key("Space")
    stopped = step(browser)
    browser.evaluate(PAINTED)
    assert step(browser) == stopped < 100


def test_readers_who_want_no_motion_get_pictures_far_apart(browser: Browser, page: Path) -> None:
    """Show a picture each half second of simulated time instead of a film."""
    browser.open(page, still=True)
    browser.evaluate(
        "window.seen = []; new MutationObserver(() => seen.push(Number(document.querySelector('.at').value)))"
        ".observe(document.querySelector('.moment'), { childList: true })"
    )
    browser.click("button.play")
    browser.wait("document.querySelector('button.play').textContent === 'Play'")
    assert set(browser.evaluate("seen")) == {50, 100}


def test_a_small_window_has_everything(browser: Browser, page: Path) -> None:
    """Fit into 320 pixels, as at 400 % zoom, without scrolling sideways."""
    browser.open(page, width=1280, height=1024, zoom=4)
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    browser.click("button.first")
    assert step(browser) == 40
    browser.evaluate(PAINTED)
    assert pixels(browser, GROUPS_LIGHT[0]) > 60


def test_hidden_environments_are_not_drawn(browser: Browser, page: Path) -> None:
    """Leave out what is unchecked, and put the rest side by side."""
    browser.open(page)
    go(browser, 100)
    browser.click(".legend li:nth-child(3) input")
    browser.evaluate(PAINTED)
    assert pixels(browser, GROUPS_LIGHT[2]) < 20
    browser.click(".legend li:nth-child(3) input")
    choose(browser, ".layout", "beside")
    go(browser, 39)
    shown = pixels(browser, GROUPS_LIGHT[0])
    browser.click(".legend li:nth-child(1) input")
    browser.evaluate(PAINTED)
    assert 0 < pixels(browser, GROUPS_LIGHT[0]) < shown


def test_strangers_run_nothing(browser: Browser, tmp_path: Path) -> None:
    """Show hostile names as text, run the page's own script alone, and ask the network for nothing."""
    evil = "</script><script>window.hacked = 1</script><img src=x onerror=hacked=1>"
    path = write_recording(tmp_path, grid(2), simulator=evil, name="evil.mcap")
    browser.open(written(tmp_path, [Recording(path)]))
    assert evil in text(browser, "h1")
    assert browser.evaluate("document.querySelectorAll('h1 *:not(bdi), img').length") == 0
    browser.evaluate(
        "document.body.append(Object.assign(document.createElement('script'), { textContent: 'window.hacked = 1' }))"
    )
    assert browser.evaluate("window.hacked") is None
    assert browser.requests == []
    assert any("Content Security Policy" in error for error in browser.errors), "what was injected just now"


def test_it_is_useful_without_scripts(browser: Browser, page: Path, tmp_path: Path) -> None:
    """Say in words what would be shown."""
    browser.open(page, scripts=False)
    browser.screenshot(tmp_path / "still.png")
    html = page.read_text(encoding="utf-8")
    assert "first differ at step 40 (0.4 s); distinct: 2 from step 40, 3 from step 60." in html
    assert '<div class="stage" hidden>' in html


def test_real_recordings_that_part(browser: Browser, tmp_path: Path) -> None:
    """Show two friction cones of MuJoCo parting at the step that gsb-diff names, and what lies outside the picture."""
    recordings = [Recording(SHIPPED / f"mujoco-{name}-r0.mcap") for name in ("xeon", "pyramidal")]
    browser.open(written(tmp_path, recordings))
    browser.click("button.first")
    assert step(browser) == 1
    assert text(browser, ".distinct") == "2 distinct of 32 environments of 2 recordings so far"
    go(browser, 500)
    assert "ball of env 0 of a" in text(browser, ".outside")
    assert "a is mujoco-xeon-r0.mcap, b is mujoco-pyramidal-r0.mcap" in text(browser, ".notes")
    assert browser.errors == []


def test_states_that_were_not_recorded_are_not_made_up(browser: Browser, tmp_path: Path) -> None:
    """Say which state is drawn where bits part between two recorded states."""
    path = SHIPPED / "h200" / "physx-spacing-0-inclined-collision-n16-r0.mcap"
    browser.open(written(tmp_path, [Recording(path)]))
    browser.click("button.first")
    assert text(browser, ".distinct") == "2 distinct of 16 environments so far"
    assert text(browser, ".moment") == "step 72 of 500, 0.72 s; drawn: the state of step 0"
    go(browser, 250)
    assert text(browser, ".moment") == "step 250 of 500, 2.5 s"
    apart = np.linalg.norm(
        np.diff(Recording(path).state("cubes", "position").at_step(250)[[0, 3]].astype(float), axis=0), axis=-1
    ).max()
    assert f"{apart * 100:.3g} cm from env 0 at most" in text(browser, ".legend li:nth-child(2)")


@pytest.mark.slow
def test_several_groups_share_one_player(browser: Browser, recording: Recording, tmp_path: Path) -> None:
    """Choose among clips, as a report embeds them; each begins at its begin with its own controls."""
    still = Recording(write_recording(tmp_path, grid(3), simulator="other"))
    both = [make_clip([recording]), make_clip([still])]
    path = tmp_path / "two.html"
    path.write_text(f"<!DOCTYPE html><meta charset=utf-8>{markup(both)}<script>{script()}</script>", encoding="utf-8")
    browser.open(path)
    browser.click("button.first")
    assert step(browser) == 40
    choose(browser, ".clips", "1")
    assert step(browser) == 0
    assert text(browser, ".distinct") == "all 3 environments bit-identical so far"
    assert browser.evaluate("document.querySelector('button.first').disabled")
    assert browser.errors == []
