"""A command's output: a line at a time and one clear error where it takes no more; its reader may leave, and neither
libraries nor the processes that they start write to it."""

from __future__ import annotations

import io
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

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


class OfMainThread:
    """Standard output, to which no other thread's words come: libraries tell there what a command did not ask for."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """As of a text stream."""
        if threading.current_thread() is threading.main_thread():
            self._stream.write(text)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Leavable(io.FileIO):
    """A file descriptor to write to. If it is a pipe whose reader has gone, output is discarded without an error."""

    def write(self, data: Any) -> int:
        """See io.FileIO."""
        try:
            return super().write(data)
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())  # libraries that write below Python's streams do not fail either
            os.close(nowhere)
            return len(data)


def leavable(stream: Any, descriptor: int) -> io.TextIOWrapper:
    """A text stream like `stream`, to an open file descriptor, whose reader may leave (see let_readers_leave)."""
    raw = _Leavable(descriptor, "w", closefd=False)
    return io.TextIOWrapper(
        raw if stream.write_through else io.BufferedWriter(raw),  # as of Python's own streams
        stream.encoding, stream.errors, line_buffering=stream.line_buffering, write_through=stream.write_through,
    )  # fmt: skip


def let_readers_leave() -> None:
    """Allow the reader of standard output or standard error to stop reading, as `head` does after some lines.

    The command goes on, and its exit code is the same as with a reader that stays. A stream by which a caller has
    replaced sys.stdout or sys.stderr is left alone.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if type(stream) is io.TextIOWrapper and stream is getattr(sys, f"__{name}__"):
            setattr(sys, name, leavable(stream, stream.fileno()))


@contextmanager
def unheard() -> Iterator[None]:
    """What is printed meanwhile goes nowhere, and so does what processes print that are started meanwhile.

    A process that outlived the command, holding the command's output, would keep whoever reads that waiting.
    """
    kept: dict[int, int] = {}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            with suppress(OSError):  # the command was started without it
                kept[number] = os.dup(number)
                os.dup2(nowhere, number)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):  # not to be mixed with what waits in ours
            yield
    finally:
        for number, copy in kept.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
