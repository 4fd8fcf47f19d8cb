"""Standard output: one line at a time, at once, and one clear error where it takes no more."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from gpusimbench.schemas import text as texts
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.text import Block, Line, line


def show(text: Line | Block) -> None:
    """Print a line, or lines. GsbError where they cannot be written."""
    _write(lambda stream: texts.show(text))


def show_document(text: str) -> None:
    """Print JSON and a line's end. Errors as of show."""
    _write(lambda stream: texts.show_document(f"{text}\n"))


def show_path(path: Path) -> None:
    """Write a path and a line's end: the file's own bytes, whatever the encoding of standard output.

    A path that is more than one line, as programs read lines, is printed as a line.
    """
    if any(character < " " for character in str(path)):
        show(line(str(path)))
        return

    def write(stream: object) -> None:
        sys.stdout.flush()
        sys.stdout.buffer.write(os.fsencode(path) + b"\n")

    _write(write)


def drop() -> None:
    """Let what standard output still holds go nowhere, so that Python's own end does not stumble over it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def flush() -> None:
    """Bring out what was written. Errors as of show."""
    _write(lambda stream: None)


def _write(write: Callable[..., object]) -> None:
    if sys.stdout is None:  # closed by whoever started this process
        return
    try:
        write(sys.stdout)
        sys.stdout.flush()
    except UnicodeEncodeError as error:
        raise GsbError(
            f"standard output is in {error.encoding} and cannot show {ascii(error.object[error.start : error.end])}; "
            "set PYTHONIOENCODING=utf-8"
        ) from None
    except OSError as error:
        drop()
        raise GsbError(f"cannot write to standard output: {error.strerror}") from None
