"""The driver of the browser, on a page of its own, so that tests which rely on it can fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.browser import Browser, needs_chromium

pytestmark = needs_chromium

PAGE = """<!DOCTYPE html><meta charset="utf-8"><title>page</title>
<style>body { background: #fff; } @media (prefers-color-scheme: dark) { body { background: #000; } }</style>
<button id="b">press</button><input id="i">
<script>
let said = [];
b.onclick = () => said.push("clicked");
addEventListener("keydown", e => said.push(e.key));
console.error("wrong", 7);
setTimeout(() => { throw new Error("thrown"); });
const image = new Image();
let missing = false;
image.onerror = () => missing = true;
image.src = "missing.png";
</script>"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """The page as a file."""
    (tmp_path / "page.html").write_text(PAGE)
    return tmp_path / "page.html"


def test_errors_and_requests_are_seen(browser: Browser, page: Path) -> None:
    """Note what the console says and what the page asks for, itself left out."""
    browser.open(page)
    browser.wait("missing")
    assert any("wrong 7" in error for error in browser.errors)
    assert any("thrown" in error for error in browser.errors)
    assert browser.requests == [page.with_name("missing.png").as_uri()]


def test_mouse_and_keys_arrive(browser: Browser, page: Path) -> None:
    """Click, press keys with and without the mouse, and type."""
    browser.open(page)
    browser.click("#b")
    browser.key("Enter")
    browser.key("Tab")
    browser.key("x")
    browser.key("ArrowLeft")
    assert browser.evaluate("said") == ["clicked", "Enter", "clicked", "Tab", "x", "ArrowLeft"]
    assert browser.evaluate("i.value") == "x"
    assert browser.evaluate("Promise.resolve(6 * 7)") == 42
    with pytest.raises(Exception, match="nothing is not defined"):
        browser.evaluate("nothing")


def test_windows_and_preferences(browser: Browser, page: Path, tmp_path: Path) -> None:
    """Lay out by width and zoom, in light and dark, without scripts, on paper."""
    browser.open(page, width=1280, zoom=4)
    assert browser.evaluate("[innerWidth, devicePixelRatio]") == [320, 4]
    light = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    browser.open(page, dark=True, still=True)
    assert browser.evaluate("getComputedStyle(document.body).backgroundColor") != light
    assert browser.evaluate("matchMedia('(prefers-reduced-motion: reduce)').matches")
    browser.open(page, printed=True)
    assert browser.evaluate("matchMedia('print').matches")
    browser.screenshot(tmp_path / "page.png", whole=True)
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
    browser.pdf(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    browser.open(page, scripts=False)
    assert browser.errors == []
