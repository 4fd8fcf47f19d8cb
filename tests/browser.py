"""A real browser that tests drive: Chromium without a window, over a pipe, by its DevTools protocol.

Nothing is installed for it and no port is opened. Tests of pages are skipped by name where no Chromium is.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import signal
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_PATIENCE_S = 60.0  # a slow machine is waited for; nothing is measured here

_ARGUMENTS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",  # containers have no user namespaces; the pages are our own
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL by the processor
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--no-first-run",
    "--hide-scrollbars",
)

_KEYS = {
    # name: code of the key, its number on Windows, the text that it types
    "Tab": ("Tab", 9, ""),
    "Enter": ("Enter", 13, "\r"),
    "Escape": ("Escape", 27, ""),
    "Space": ("Space", 32, " "),
    "PageUp": ("PageUp", 33, ""),
    "PageDown": ("PageDown", 34, ""),
    "End": ("End", 35, ""),
    "Home": ("Home", 36, ""),
    "ArrowLeft": ("ArrowLeft", 37, ""),
    "ArrowUp": ("ArrowUp", 38, ""),
    "ArrowRight": ("ArrowRight", 39, ""),
    "ArrowDown": ("ArrowDown", 40, ""),
}


def chromium() -> str | None:
    """The browser's path; None where none is installed."""
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


needs_chromium = pytest.mark.skipif(chromium() is None, reason=f"no browser: none of {', '.join(_NAMES)} is installed")


class Browser:
    """One tab of a browser of its own, gone with the `with` block.

    errors    what the page's console says of errors: exceptions, console.error, what its policy refused
    requests  addresses that the page asked for, itself left out
    """

    def __init__(self) -> None:
        path = chromium()
        if path is None:
            raise FileNotFoundError("no Chromium is installed")
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._number = 0
        self._session = ""
        self._loaded = False
        self._unread = b""
        self._profile = tempfile.mkdtemp(prefix="gsb-browser-")
        theirs_in, self._out = _pipe()
        self._in, theirs_out = _pipe()
        # spawned, not forked: engines that tests load into this process mind a fork
        self._pid = os.posix_spawn(
            path,
            [path, *_ARGUMENTS, f"--user-data-dir={self._profile}", "about:blank"],
            os.environ,
            file_actions=[
                (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
                (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0),
                (os.POSIX_SPAWN_DUP2, theirs_in, 3),
                (os.POSIX_SPAWN_DUP2, theirs_out, 4),
            ],
            setpgroup=0,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        try:
            targets = self._send("Target.getTargets")["targetInfos"]
            tab = next(t["targetId"] for t in targets if t["type"] == "page")
            self._session = self._send("Target.attachToTarget", targetId=tab, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Network", "Log"):
                self._send(f"{domain}.enable")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

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
        self._send(
            "Emulation.setDeviceMetricsOverride",
            width=round(width / zoom), height=round(height / zoom), deviceScaleFactor=zoom, mobile=False,
        )  # fmt: skip
        self._send(
            "Emulation.setEmulatedMedia",
            media="print" if printed else "",
            features=[
                {"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
                {"name": "prefers-reduced-motion", "value": "reduce" if still else "no-preference"},
            ],
        )
        self._send("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.errors.clear()
        self.requests.clear()
        self._loaded = False
        url = page.resolve().as_uri() if isinstance(page, Path) else page
        answer = self._send("Page.navigate", url=url)
        if "errorText" in answer:
            raise AssertionError(f"{url}: {answer['errorText']}")
        deadline = time.monotonic() + _PATIENCE_S
        while not self._loaded:
            self._receive(deadline)
        self.requests[:] = [asked for asked in self.requests if asked != url.partition("#")[0]]

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression, awaited where it is a promise; AssertionError where it throws."""
        answer = self._send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise AssertionError(_thrown(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def wait(self, script: str) -> Any:
        """The expression's value as soon as it is true; AssertionError after a minute."""
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            found = self.evaluate(script)
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"never true: {script}")

    def key(self, name: str, *, shift: bool = False) -> None:
        """Press and release a key: a name such as "ArrowLeft" or "Tab", or one letter or digit."""
        code, number, text = _KEYS.get(name) or (name, ord(name.upper()), name)
        key = " " if name == "Space" else name
        about = {"key": key, "code": code, "windowsVirtualKeyCode": number, "modifiers": 8 if shift else 0}
        self._send("Input.dispatchKeyEvent", type="keyDown", **about, **({"text": text} if text else {}))
        self._send("Input.dispatchKeyEvent", type="keyUp", **about)

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        self.drag(selector, 0, 0)

    def drag(self, selector: str, right: float, down: float) -> None:
        """Press the mouse in the middle of an element, move it so many pixels, and release it."""
        x, y = self._middle(selector)
        self._mouse("mouseMoved", x, y, buttons=0)
        self._mouse("mousePressed", x, y, buttons=1)
        if right or down:
            self._mouse("mouseMoved", x + right, y + down, buttons=1)
        self._mouse("mouseReleased", x + right, y + down, buttons=0)

    def point(self, x: float, y: float) -> None:
        """Move the mouse to a place of the window [CSS pixel]."""
        self._mouse("mouseMoved", x, y, buttons=0)

    def wheel(self, selector: str, down: float) -> None:
        """Turn the wheel over the middle of an element."""
        x, y = self._middle(selector)
        self._send("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=down)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what the window shows, or the whole page, as PNG."""
        clip = {}
        if whole:
            size = self._send("Page.getLayoutMetrics")["cssContentSize"]
            clip = {"clip": {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}}
        answer = self._send("Page.captureScreenshot", format="png", captureBeyondViewport=whole, **clip)
        path.write_bytes(base64.b64decode(answer["data"]))

    def save_to(self, folder: Path) -> None:
        """Put what pages save as files into a folder, without asking."""
        self._send("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    def pdf(self, path: Path) -> None:
        """Write the page as it is printed."""
        path.write_bytes(base64.b64decode(self._send("Page.printToPDF", printBackground=True)["data"]))

    def close(self) -> None:
        """End the browser and remove its profile."""
        os.close(self._out)  # a browser whose pipe is closed ends itself
        os.close(self._in)
        deadline = time.monotonic() + 5
        while os.waitpid(self._pid, os.WNOHANG)[0] == 0:
            if time.monotonic() > deadline:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._pid, signal.SIGKILL)
                os.waitpid(self._pid, 0)
                break
            time.sleep(0.02)
        shutil.rmtree(self._profile, ignore_errors=True)

    def _middle(self, selector: str) -> tuple[float, float]:
        quoted = json.dumps(selector)
        found = self.evaluate(
            f"(() => {{ const e = document.querySelector({quoted}); if (!e) return null;"
            "e.scrollIntoView({block: 'nearest', behavior: 'instant'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        assert found is not None, f"the page has no {selector}"
        return found[0], found[1]

    def _mouse(self, kind: str, x: float, y: float, *, buttons: int) -> None:
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        self._send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1)

    def _send(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        view = memoryview(json.dumps(message).encode() + b"\0")
        while view:
            view = view[os.write(self._out, view) :]
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            answer = self._receive(deadline)
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                found: dict[str, Any] = answer["result"]
                return found

    def _receive(self, deadline: float) -> dict[str, Any]:
        # one message, an answer or an event; events are noted
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self._in], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, f"the browser said nothing for {_PATIENCE_S:g} s"
            more = os.read(self._in, 1 << 20)
            assert more, "the browser ended"
            self._unread += more
        text, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method", ""), message.get("params", {}))
        return message

    def _note(self, event: str, about: dict[str, Any]) -> None:
        match event:
            case "Page.loadEventFired":
                self._loaded = True
            case "Network.requestWillBeSent":
                if not about["request"]["url"].startswith(("data:", "blob:")):  # these are part of the page
                    self.requests.append(about["request"]["url"])
            case "Runtime.exceptionThrown":
                self.errors.append(_thrown(about["exceptionDetails"]))
            case "Runtime.consoleAPICalled" if about["type"] in ("error", "assert"):
                self.errors.append(" ".join(str(a.get("value", a.get("description", ""))) for a in about["args"]))
            case "Log.entryAdded" if about["entry"]["level"] == "error":
                self.errors.append(about["entry"]["text"])


def _pipe() -> tuple[int, int]:
    # far from 3 and 4, which are the browser's
    ends = os.pipe()
    far = tuple(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 16) for end in ends)
    for end in ends:
        os.close(end)
    return far[0], far[1]


def _thrown(details: dict[str, Any]) -> str:
    return str(details.get("exception", {}).get("description") or details["text"])
