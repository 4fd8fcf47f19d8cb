"""Programs that show recordings, where they are installed, and how a page or one of them is opened."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import webbrowser
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

from gpusimbench.schemas.errors import GsbError, UsageError

_GRACE_S = 1.0  # in which a program that cannot start says so


class Program(Enum):
    """What a recording can be opened in, in the order in which they are looked for; the page needs nothing."""

    RERUN = "rerun"
    FOXGLOVE = "foxglove"
    LICHTBLICK = "lichtblick"
    PAGE = "page"

    @property
    def commands(self) -> tuple[str, ...]:
        """Names that it is installed under."""
        return _COMMANDS[self]


_COMMANDS = {
    Program.RERUN: ("rerun",),
    Program.FOXGLOVE: ("foxglove-studio", "foxglove"),
    Program.LICHTBLICK: ("lichtblick", "lichtblick-desktop"),
    Program.PAGE: (),
}


def command_of(program: Program) -> str | None:
    """The program's path; None where it is not installed."""
    return next((path for name in program.commands if (path := shutil.which(name))), None)


def found(asked: str) -> Program:
    """What is meant: a program by name, or with "auto" the first that is installed and has a display to draw on.

    Never rerun unless it is named: without a blueprint it draws nothing of a recording.

    UsageError where the program that is asked for is not installed.
    """
    if asked == "auto":
        installed = (p for p in Program if p is not Program.RERUN and (p is Program.PAGE or command_of(p)))
        return next(installed) if has_display() else Program.PAGE
    program = Program(asked)
    if program is not Program.PAGE and command_of(program) is None:
        names = " or ".join(program.commands)
        raise UsageError(f"{asked} is not installed: there is no {names} on the PATH; --with page needs nothing")
    return program


def has_display() -> bool:
    """Whether a window can be opened here, as far as the environment tells."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_page(path: Path) -> bool:
    """Open a page in the user's browser; False where there is none, or no display for it."""
    if not has_display() and "BROWSER" not in os.environ:
        return False  # a browser of the terminal would take it over
    return webbrowser.open(path.resolve().as_uri())


def start(program: Program, files: Sequence[Path]) -> None:
    """Start a program with some files, and leave it running; GsbError where it cannot start or ends at once."""
    path = command_of(program)
    if path is None:
        raise GsbError(f"{program.value} is not installed any more")
    try:
        running = subprocess.Popen(
            [path, *map(str, files)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise GsbError(f"cannot start {path}: {error.strerror}") from None
    try:
        code = running.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        running.returncode = 0  # it runs on without us
        return
    if code:
        raise GsbError(f"{path} ended with exit code {code} as soon as it was started; --with page needs no program")
