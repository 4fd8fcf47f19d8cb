"""What a file of a set may be called: a relative path that means the same on every system, and leads nowhere else."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

MAX_PATH = 512
MAX_PARTS = 16

_SEPARATORS_ELSEWHERE = "\\:"


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
