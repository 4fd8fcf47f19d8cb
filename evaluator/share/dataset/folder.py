"""The files of a set's folder, as paths relative to it, and what such a path may be."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.schemas.errors import GsbError

MAX_FILES = 20_000
"""Files and folders of a set; more are refused."""

MAX_PATH = 512
MAX_PARTS = 16
_SEPARATORS_ELSEWHERE = "\\:"


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


def why_not(path: str) -> str:
    """Why a text cannot be the path of a file of a set; empty where it can.

    Parts are separated by /. Names that begin with a dot are left to version control and downloaders.
    """
    if not path or len(path) > MAX_PATH:
        return f"it has {len(path)} characters; a path has 1 to {MAX_PATH}"
    if not path.isprintable() or any(0xD800 <= ord(c) < 0xE000 for c in path):
        return "it has characters that cannot be shown"
    if found := [c for c in _SEPARATORS_ELSEWHERE if c in path]:
        return f"it has a {found[0]}, which other systems take for more than a character"
    parts = path.split("/")
    if len(parts) > MAX_PARTS:
        return f"it leads through {len(parts)} folders, more than {MAX_PARTS}"
    if "" in parts:
        return "it begins or ends with /, or has two of them in a row"
    if any(part.startswith(".") for part in parts):
        return "a part of it begins with a dot"
    return ""


def collisions(paths: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of paths that some file systems take for one: they differ in case or in how an accent is written."""
    seen: dict[str, str] = {}
    pairs = []
    for path in paths:
        first = seen.setdefault(unicodedata.normalize("NFC", path).casefold(), path)
        if first != path:
            pairs.append((first, path))
    return pairs
