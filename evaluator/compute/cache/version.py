"""The code that results follow from, as one digest."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("numpy", "scipy", "numba", "POT", "lz4", "zstandard", "protobuf")
_FOLDERS = ("evaluator", "schemas")
_KINDS = ("*.py", "*.binpb")


@cache
def code_version() -> str:
    """SHA-256 [hex] of this project's own evaluating code, of the versions of what it computes with, and of the kind of
    machine.
    """
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[3]
    for folder in _FOLDERS:
        for path in sorted(p for kind in _KINDS for p in (root / folder).rglob(kind)):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(f"{sys.version} {platform.machine()}\0".encode())
    for package in _PACKAGES:
        digest.update(f"{package}={_version(package)}\0".encode())
    return digest.hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
