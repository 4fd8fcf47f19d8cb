"""The code that results follow from, as one digest."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("numpy", "scipy", "numba", "POT", "lz4", "zstandard", "protobuf")
_FOLDERS = ("evaluator", "schemas")


@cache
def code_version() -> str:
    """SHA-256 [hex] of this project's own evaluating code and of the versions of what it computes with."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[2]
    for folder in _FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for package in _PACKAGES:
        digest.update(f"{package}={_version(package)}\0".encode())
    return digest.hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
