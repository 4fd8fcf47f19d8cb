"""Results as bytes and back, for the project's own dataclasses alone; reading such bytes runs no code of theirs.

A document is a NumPy archive without pickled objects: its arrays, and a JSON tree that says where they go.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TREE = "tree"


class Codec:
    """Encodes values made of plain values, lists, tuples, mappings, paths, arrays, some dataclasses and enums.

    classes  that may be stored; a document that names another is refused
    """

    def __init__(self, *classes: type) -> None:
        self._classes = {cls.__name__: cls for cls in classes}

    def encode(self, value: Any) -> bytes:
        """The document; TypeError for a value that it cannot hold."""
        arrays: list[NDArray[Any]] = []
        tree = json.dumps(self._tree(value, arrays))
        named: dict[str, Any] = {str(index): array for index, array in enumerate(arrays)}
        named[_TREE] = np.frombuffer(tree.encode(), dtype=np.uint8)
        stream = io.BytesIO()
        np.savez(stream, **named)
        return stream.getvalue()

    def decode(self, document: bytes | memoryview) -> Any:
        """The value, in no more memory than a few times its document; ValueError where the bytes are none."""
        try:
            arrays = dict(_arrays(document))
            return self._value(json.loads(arrays[_TREE].tobytes()), arrays)
        except Exception as error:  # whatever reading an archive of any bytes can raise
            raise ValueError(f"not a stored result: {error}") from None

    def _tree(self, value: Any, arrays: list[NDArray[Any]]) -> Any:
        if isinstance(value, Enum) and self._classes.get(type(value).__name__) is type(value):
            return {"enum": type(value).__name__, "name": value.name}
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            arrays.append(value)
            return {"array": len(arrays) - 1}
        if isinstance(value, list):
            return [self._tree(item, arrays) for item in value]
        if isinstance(value, tuple):
            return {"tuple": [self._tree(item, arrays) for item in value]}
        if isinstance(value, Mapping):
            return {"items": [[self._tree(k, arrays), self._tree(v, arrays)] for k, v in value.items()]}
        if isinstance(value, PurePath):
            return {"path": str(value)}
        if dataclasses.is_dataclass(value) and self._classes.get(type(value).__name__) is type(value):
            found = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
            return {"class": type(value).__name__, "of": {k: self._tree(v, arrays) for k, v in found.items()}}
        raise TypeError(f"a {type(value).__name__} cannot be stored")

    def _value(self, tree: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
        if isinstance(tree, list):
            return [self._value(item, arrays) for item in tree]
        if not isinstance(tree, dict):
            return tree
        match next(iter(tree)):
            case "array":
                return arrays[str(tree["array"])]
            case "tuple":
                return tuple(self._value(item, arrays) for item in tree["tuple"])
            case "items":
                return {self._value(k, arrays): self._value(v, arrays) for k, v in tree["items"]}
            case "path":
                return Path(tree["path"])
            case "enum":
                return self._classes[tree["enum"]][tree["name"]]  # type: ignore[index]
            case "class":
                cls = self._classes[tree["class"]]
                return cls(**{name: self._value(item, arrays) for name, item in tree["of"].items()})
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
