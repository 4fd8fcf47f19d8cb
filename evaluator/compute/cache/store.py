"""A folder of results, each under the digest of everything that it follows from, the code among it."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from stat import S_ISREG
from typing import Any

from gpusimbench.evaluator.compute.cache.codec import decode, encode
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.writing import write_file

MAX_BYTES = 1 << 30
"""What a store may take; beyond it, what was used longest ago is deleted."""

_SUFFIX = ".result"
_DIGEST = 32  # bytes of SHA-256 before each document: what a disk or a hand changed or moved is no result
_MOST = 256 << 20  # bytes of an entry
_ABANDONED_S = 3600
_PACKAGES = ("numpy", "scipy", "numba", "POT", "lz4", "zstandard", "protobuf")
_FOLDERS = ("evaluator", "schemas")
_KINDS = ("*.py", "*.binpb")


def default_folder() -> Path | None:
    """GSB_CACHE, or gpusimbench in the user's folder of caches (XDG Base Directory Specification); None without one."""
    if given := os.environ.get("GSB_CACHE"):
        return Path(given)
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(home) if home else Path.home() / ".cache") / "gpusimbench"
    except RuntimeError:  # of a user that nobody knows, as in many a container
        return None


class Store:
    """Results by key. Several processes may use one folder; whatever goes wrong with a file, its result is missing.

    folder  made when first written to
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keys(self, function: Callable[..., Any], items: Sequence[Any]) -> list[str]:
        """Of a function's result for each item: the function, the item, the versions of all code that computes.

        A function is told by its name or, where it is a value that can be called, by its class and its fields.
        """
        named = getattr(function, "__qualname__", None)
        digest = hashlib.sha256(code_version().encode())
        digest.update(encode(f"{function.__module__}.{named}" if named else function))
        found = []
        for item in items:
            one = digest.copy()
            one.update(encode(item))
            found.append(one.hexdigest())
        return found

    def key(self, function: Callable[..., Any], item: Any) -> str:
        """Of a function's result for one item."""
        return self.keys(function, [item])[0]

    def get(self, key: str, kind: Any) -> Any:
        """The result, None where there is none of that kind: a class or another type hint."""
        path = self._path(key)
        try:
            status = path.stat()
            if not S_ISREG(status.st_mode) or status.st_size > _MOST:
                return None
            with path.open("rb") as stream:
                stored = stream.read(_MOST)
            document = memoryview(stored)[_DIGEST:]
            if _sealed(key, document) != stored[:_DIGEST]:
                return None
            result = decode(document, kind)
        except (OSError, ValueError):
            return None
        if isinstance(kind, type) and not isinstance(result, kind):
            return None
        with suppress(OSError):
            os.utime(path)
        return result

    def put(self, key: str, result: Any) -> None:
        """Keep a result. One that cannot be written is not kept: the next evaluation computes it again."""
        path = self._path(key)
        document = encode(result)
        if _DIGEST + len(document) > _MOST:
            return
        with suppress(OSError, GsbError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, _sealed(key, document) + document, durable=False)

    def prune(self, limit: int = MAX_BYTES) -> None:
        """Delete what others left undone, and what was used longest ago, until the folder holds `limit` bytes."""
        for path in self._folder.glob(f"*/.*{PARTIAL}"):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > _ABANDONED_S:
                    path.unlink()
        found = sorted(self._files(), reverse=True)
        held = 0
        for _, size, path in found:
            held += size
            if held > limit:
                with suppress(OSError):
                    path.unlink()

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        for path in self._folder.glob(f"*/*{_SUFFIX}"):
            with suppress(OSError):
                status = path.stat()
                yield status.st_mtime_ns, status.st_size, path

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key[2:]}{_SUFFIX}"


def _sealed(key: str, document: bytes | memoryview) -> bytes:
    """The digest of an entry: it is of its key as well, so that an entry under another name is none."""
    digest = hashlib.sha256(key.encode())
    digest.update(document)
    return digest.digest()


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
        digest.update(f"{package}={version_of(package)}\0".encode())
    return digest.hexdigest()


def version_of(package: str) -> str:
    """Of an installed package; empty where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
