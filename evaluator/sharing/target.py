"""A file that is written beside its name and gets it only when it is whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from schemas import PARTIAL
from schemas.errors import GsbError, UsageError


class Target(NamedTuple):
    """A file that is being written.

    stream  without a buffer
    path    of the file as long as it has not its final name
    """

    stream: FileIO
    path: Path


def check_free(path: Path) -> None:
    """UsageError where the name is taken."""
    if path.exists():
        raise UsageError(f"{path} exists already; nothing is overwritten: name another")


@contextmanager
def new_file(path: Path) -> Iterator[Target]:
    """A new file, which gets its name when the block ends, and is removed where an error ends it.

    UsageError where the name is taken, GsbError where it cannot be written.
    """
    # of this process alone: NAME.partial may be the very file that is recovered to NAME
    partial = path.with_name(f"{path.name}.{os.getpid()}{PARTIAL}")
    check_free(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = FileIO(partial, "xb")
    except OSError as error:
        raise GsbError(f"cannot write to {path.parent}: {error.strerror}") from None
    try:
        with stream:
            yield Target(stream, partial)
            os.fsync(stream.fileno())
        _rename(partial, path)
    except OSError as error:
        raise GsbError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        partial.unlink(missing_ok=True)


def _rename(partial: Path, path: Path) -> None:
    try:
        os.link(partial, path)  # unlike rename, never replaces a file
    except FileExistsError:
        raise GsbError(f"{path} appeared meanwhile; it is left as it is") from None
    except OSError:  # a file system without hard links
        if path.exists():
            raise GsbError(f"{path} appeared meanwhile; it is left as it is") from None
        partial.rename(path)
