"""A folder of results, each under the digest of everything that it follows from, the code among it.

A result is stored as bytes, for the project's own dataclasses alone; reading such bytes runs no code of theirs. A
document is a NumPy archive without pickled objects: its arrays, and a JSON tree that says where they go. It may name
the classes that the kind of result is made of: those in its type hint, and in the type hints of their fields.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import os
import platform
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePath
from stat import S_ISREG
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.writing import write_file

_TREE = "tree"

MAX_BYTES = 1 << 30
"""What a store may take; beyond it, what was used longest ago is deleted."""

_SUFFIX = ".result"
_DIGEST = 32  # bytes of SHA-256 before each document: what a disk or a hand changed or moved is no result
_MOST = 256 << 20  # bytes of an entry
_ABANDONED_S = 3600
_PACKAGES = ("numpy", "scipy", "numba", "POT", "lz4", "zstandard", "protobuf")
_FOLDERS = ("evaluator", "schemas")
_KINDS = ("*.py", "*.binpb")


def encode(value: Any) -> bytes:
    """A document of plain values, lists, tuples, mappings, paths, arrays, dataclasses and enums.

    TypeError for a value that it cannot hold.
    """
    arrays: list[NDArray[Any]] = []
    tree = json.dumps(_tree(value, arrays))
    named: dict[str, Any] = {str(index): array for index, array in enumerate(arrays)}
    named[_TREE] = np.frombuffer(tree.encode(), dtype=np.uint8)
    stream = io.BytesIO()
    np.savez(stream, **named)
    return stream.getvalue()


def decode(document: bytes | memoryview, kind: Any) -> Any:
    """The value, in no more memory than a few times its document; ValueError where the bytes are none of that kind.

    kind  a class or another type hint; the document may name the classes that `classes_of` finds in it
    """
    classes = classes_of(kind)
    try:
        arrays = dict(_arrays(document))
        return _value(json.loads(arrays[_TREE].tobytes()), arrays, classes)
    except Exception as error:  # whatever reading an archive of any bytes can raise
        raise ValueError(f"not a stored result: {error}") from None


@cache
def classes_of(kind: Any) -> Mapping[str, type]:
    """The dataclasses and enums that values of a kind are made of, by the names that documents give them."""
    found: dict[str, type] = {}
    asked = [kind]
    while asked:
        hint = asked.pop()
        asked += get_args(hint)
        if not isinstance(hint, type) or not (dataclasses.is_dataclass(hint) or issubclass(hint, Enum)):
            continue
        if _name(hint) not in found:
            found[_name(hint)] = hint
            asked += get_type_hints(hint).values()
    return found


@cache
def _name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


@cache
def _fields(cls: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(cls))


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, Enum):
        return {"enum": _name(type(value)), "name": value.name}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, list):
        return [_tree(item, arrays) for item in value]
    if isinstance(value, tuple):
        return {"tuple": [_tree(item, arrays) for item in value]}
    if isinstance(value, Mapping):
        return {"items": [[_tree(k, arrays), _tree(v, arrays)] for k, v in value.items()]}
    if isinstance(value, PurePath):
        return {"path": str(value)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        found = {name: _tree(getattr(value, name), arrays) for name in _fields(type(value))}
        return {"class": _name(type(value)), "of": found}
    raise TypeError(f"a {type(value).__name__} cannot be stored")


def _value(tree: Any, arrays: Mapping[str, NDArray[Any]], classes: Mapping[str, type]) -> Any:
    if isinstance(tree, list):
        return [_value(item, arrays, classes) for item in tree]
    if not isinstance(tree, dict):
        return tree
    match next(iter(tree)):
        case "array":
            return arrays[str(tree["array"])]
        case "tuple":
            return tuple(_value(item, arrays, classes) for item in tree["tuple"])
        case "items":
            return {_value(k, arrays, classes): _value(v, arrays, classes) for k, v in tree["items"]}
        case "path":
            return Path(tree["path"])
        case "enum":
            return classes[tree["enum"]][tree["name"]]  # type: ignore[index]
        case "class":
            cls = classes[tree["class"]]
            return cls(**{name: _value(item, arrays, classes) for name, item in tree["of"].items()})
        case other:
            raise ValueError(f"not a stored result: {other!r}")


def _arrays(document: bytes | memoryview) -> Iterator[tuple[str, NDArray[Any]]]:
    # as NumPy writes them, not compressed: what an entry announces is in it, or it is not read
    with zipfile.ZipFile(io.BytesIO(document)) as archive:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > len(document):
            raise ValueError("it announces more than it holds")
        for entry in entries:
            if entry.compress_type != zipfile.ZIP_STORED:
                raise ValueError("it is compressed")
            stream = io.BytesIO(archive.read(entry))
            read_header = _HEADERS[np.lib.format.read_magic(stream)]
            shape, by_column, dtype = read_header(stream)
            if dtype.hasobject or math.prod(shape) * dtype.itemsize != entry.file_size - stream.tell():
                raise ValueError("an array has another size than it announces")
            flat = np.frombuffer(bytearray(stream.read()), dtype, math.prod(shape))
            yield entry.filename.removesuffix(".npy"), flat.reshape(shape, order="F" if by_column else "C")


_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


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
        """Names of a function's results by item: digests of function, item and the versions of all code that computes.

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
        """The name under which a function's result for an item is kept."""
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


def sources() -> Iterator[tuple[str, Path]]:
    """The files of this project that decide what is computed, each with its name in the package."""
    root = Path(__file__).resolve().parents[2]
    for folder in _FOLDERS:
        for path in sorted(p for kind in _KINDS for p in (root / folder).rglob(kind)):
            yield path.relative_to(root).as_posix(), path


@cache
def code_version() -> str:
    """SHA-256 [hex] of this project's own evaluating code, of the versions of what it computes with, and of the kind of
    machine.
    """
    digest = hashlib.sha256()
    for name, path in sources():
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(f"{sys.version} {platform.machine()}\0".encode())
    for package in _PACKAGES:
        digest.update(f"{package}={version_of(package)}\0".encode())
    return digest.hexdigest()


def version_of(package: str) -> str:
    """The version of an installed package; empty where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
