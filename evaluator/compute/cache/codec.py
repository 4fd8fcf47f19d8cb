"""Results as bytes and back, for the project's own dataclasses alone; reading such bytes runs no code of theirs.

A document is a NumPy archive without pickled objects: its arrays, and a JSON tree that says where they go. It may name
the classes that the kind of result is made of: those in its type hint, and in the type hints of their fields.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cache
from pathlib import Path, PurePath
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

_TREE = "tree"


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
