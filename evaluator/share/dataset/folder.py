"""The files of a folder, as paths relative to it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.schemas.errors import GsbError

MAX_FILES = 20_000
"""Files and folders of a set; more are refused."""


@dataclass(frozen=True)
class Found:
    """What lies in a folder and in those below it, each in order.

    files   regular files, by their paths with /
    others  symbolic links, which are not followed, and whatever else is neither file nor folder
    hidden  names that begin with a dot; what is below them is not looked at
    """

    files: tuple[str, ...]
    others: tuple[str, ...]
    hidden: tuple[str, ...]


def find(folder: Path) -> Found:
    """Look through a folder; GsbError where it cannot be read, or has more than MAX_FILES entries."""
    files: list[str] = []
    others: list[str] = []
    hidden: list[str] = []
    waiting = [""]
    seen = 0
    try:
        while waiting:
            below = waiting.pop()
            with os.scandir(folder / below) as entries:
                for entry in entries:
                    seen += 1
                    if seen > MAX_FILES:
                        raise GsbError(f"{folder} has more than {MAX_FILES} entries; publish it in parts")
                    path = f"{below}/{entry.name}" if below else entry.name
                    if entry.name.startswith("."):
                        hidden.append(path)
                    elif entry.is_dir(follow_symlinks=False):
                        waiting.append(path)
                    else:
                        (files if entry.is_file(follow_symlinks=False) else others).append(path)
    except OSError as error:
        raise GsbError(f"cannot look through {folder}: {error.strerror}") from None
    return Found(tuple(sorted(files)), tuple(sorted(others)), tuple(sorted(hidden)))
