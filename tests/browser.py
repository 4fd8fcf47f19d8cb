"""A real browser that tests drive: the Chromium of this machine without a window, by Playwright.

Playwright brings no browser here. Tests of pages are skipped by name where no Chromium is.
"""

from __future__ import annotations

import json
import shutil
import time
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import ConsoleMessage, Page, Request

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_PATIENCE_S = 300.0  # a slow machine is waited for; nothing is measured here

_ARGUMENTS = (
    "--no-sandbox",  # containers have no user namespaces; the pages are our own
    "--enable-unsafe-swiftshader",  # WebGL by the processor
)


def chromium() -> str | None:
    """The browser's path; None where none is installed."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


needs_chromium = pytest.mark.skipif(
    chromium() is None or find_spec("playwright") is None,
    reason=f"no browser: playwright and one of {', '.join(_NAMES)} are needed",
)


class Browser:
    """One tab of a browser of its own, gone with the `with` block.

    errors    what the page's console says of errors: exceptions, console.error, what its policy refused
    requests  addresses that the page asked for, itself left out
    page      what is open
    """

    def __init__(self) -> None:
        from playwright.sync_api import sync_playwright

        path = chromium()
        if path is None:
            raise FileNotFoundError("no Chromium is installed")
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._driver = sync_playwright().start()
        self._browser = self._driver.chromium.launch(executable_path=path, args=_ARGUMENTS)
        self._pages: dict[tuple[float, bool], Page] = {}  # by what a page has for good: zoom, and whether scripts run
        self.page = self._page(1.0, True)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._browser.close()
        self._driver.stop()

    def open(
        self,
        page: str | Path,
        *,
        width: int = 1280,
        height: int = 800,
        zoom: float = 1.0,
        dark: bool = False,
        still: bool = False,
        printed: bool = False,
        scripts: bool = True,
    ) -> None:
        """Load a file or address and wait until it is there; errors and requests begin anew.

        width, height  of the window [CSS pixel at a zoom of 1]
        zoom           the reader's: at 4, a window of 1280 pixels is laid out as one of 320
        dark           the reader prefers dark pages; `still`, reduced motion
        printed        as on paper
        scripts        False: the reader's browser runs none
        """
        self.page = self._page(zoom, scripts)
        self.page.set_viewport_size({"width": round(width / zoom), "height": round(height / zoom)})
        self.page.emulate_media(
            media="print" if printed else "screen",
            color_scheme="dark" if dark else "light",
            reduced_motion="reduce" if still else "no-preference",
        )
        url = page.resolve().as_uri() if isinstance(page, Path) else page
        if self.page.url.partition("#")[0] == url.partition("#")[0]:
            self.page.goto("about:blank")  # another fragment of a page would not load it anew
        self.errors.clear()
        self.requests.clear()
        self.page.goto(url)
        self.requests[:] = [asked for asked in self.requests if asked != url.partition("#")[0]]

    def _page(self, zoom: float, scripts: bool) -> Page:
        if (zoom, scripts) not in self._pages:
            context = self._browser.new_context(device_scale_factor=zoom, java_script_enabled=scripts)
            context.set_default_timeout(1000 * _PATIENCE_S)
            page = self._pages[zoom, scripts] = context.new_page()
            page.on("console", self._hear)
            page.on("pageerror", lambda error: self.errors.append(str(error)))
            page.on("request", self._note)
        return self._pages[zoom, scripts]

    def _hear(self, said: ConsoleMessage) -> None:
        if said.type in ("error", "assert"):
            self.errors.append(said.text)

    def _note(self, request: Request) -> None:
        if not request.url.startswith(("data:", "blob:")):  # these are part of the page
            self.requests.append(request.url)

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression, awaited where it is a promise; Playwright's Error where it throws."""
        return self.page.evaluate(script)

    def wait(self, script: str) -> Any:
        """The expression's value as soon as it is true; AssertionError after five minutes."""
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            if found := self.evaluate(script):
                return found
            self.page.wait_for_timeout(50)
        raise AssertionError(f"never true: {script}")

    def key(self, name: str, *, shift: bool = False) -> None:
        """Press and release a key: a name such as "ArrowLeft" or "Tab", or one letter or digit."""
        self.page.keyboard.press(f"Shift+{name}" if shift else name)

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        self.drag(selector, 0, 0)

    def drag(self, selector: str, right: float, down: float) -> None:
        """Press the mouse in the middle of an element, move it so many pixels, and release it."""
        x, y = self._middle(selector)
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        if right or down:
            self.page.mouse.move(x + right, y + down)
        self.page.mouse.up()

    def point(self, x: float, y: float) -> None:
        """Move the mouse to a place of the window [CSS pixel]."""
        self.page.mouse.move(x, y)

    def wheel(self, selector: str, down: float) -> None:
        """Turn the wheel over the middle of an element."""
        self.page.mouse.move(*self._middle(selector))
        self.page.mouse.wheel(0, down)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what the window shows, or the whole page, as PNG."""
        self.page.screenshot(path=path, full_page=whole)

    def saved(self, selector: str, folder: Path) -> Path:
        """Press Enter on an element that saves a file, and put the file into a folder."""
        self.evaluate(f"document.querySelector({json.dumps(selector)}).focus()")
        with self.page.expect_download() as download:
            self.key("Enter")
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def pdf(self, path: Path) -> None:
        """Write the page as it is printed."""
        self.page.pdf(path=path, print_background=True)

    def _middle(self, selector: str) -> tuple[float, float]:
        quoted = json.dumps(selector)
        found = self.evaluate(
            f"(() => {{ const e = document.querySelector({quoted}); if (!e) return null;"
            "e.scrollIntoView({block: 'nearest', behavior: 'instant'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        return found[0], found[1]
