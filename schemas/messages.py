"""Message classes of the format, and of the types that viewers know, from the descriptor sets beside this module.

The classes are built at run time rather than generated as code, so that any protobuf runtime from 5 on reads and
writes the same recordings. ``make proto`` rebuilds the descriptor sets from ``proto/*/``.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

DESCRIPTOR_SETS = {"gsb": "gsb_v1.binpb", "foxglove": "foxglove.binpb"}
"""By the first part of a message's full name."""

_LARGEST_SCHEMA = 1 << 20  # bytes of a stranger's schema that are looked at


@cache
def _files(package: str) -> dict[str, Any]:
    # by name, each behind those that it refers to
    data = (files("gpusimbench.schemas") / DESCRIPTOR_SETS[package]).read_bytes()
    return {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(data).file}


@cache
def _pool(package: str) -> descriptor_pool.DescriptorPool:
    pool = descriptor_pool.DescriptorPool()
    for file in _files(package).values():
        pool.Add(file)
    return pool


def _pool_of(name: str) -> descriptor_pool.DescriptorPool:
    return _pool(name.partition(".")[0])


@cache
def message_class(name: str) -> Any:
    """The class of a message by its full name, for example ``gsb.v1.StateBlock`` or ``foxglove.SceneUpdate``."""
    return message_factory.GetMessageClass(_pool_of(name).FindMessageTypeByName(name))


@cache
def enum_values(name: str) -> dict[str, int]:
    """Numbers of an enum by value name, for example of ``gsb.v1.RunStatus``."""
    return {v.name: v.number for v in _pool_of(name).FindEnumTypeByName(name).values}


@cache
def embedded_schema(name: str) -> bytes:
    """The FileDescriptorSet that a file carries for a message: its definition and all that it refers to.

    KeyError where there is no such message.
    """
    wanted = {_pool_of(name).FindMessageTypeByName(name).file.name}
    known = _files(name.partition(".")[0])
    for file in reversed(known.values()):
        wanted.update(file.dependency if file.name in wanted else ())
    chosen = [file for file in known.values() if file.name in wanted]
    return bytes(descriptor_pb2.FileDescriptorSet(file=chosen).SerializeToString())


def widened_schema(name: str, stored: bytes) -> bytes:
    """The schema of a copy of a file: today's where it has every field of the one that the file stores, else that one.

    Messages that are written anew may use fields that are younger than the file, and a schema describes every byte.
    """
    if len(stored) > _LARGEST_SCHEMA:
        return stored
    ours = embedded_schema(name)
    try:
        theirs = descriptor_pb2.FileDescriptorSet.FromString(stored)
    except Exception:  # protobuf's DecodeError differs between its backends
        return stored
    return ours if _members(theirs) <= _members(descriptor_pb2.FileDescriptorSet.FromString(ours)) else stored


def _members(found: descriptor_pb2.FileDescriptorSet) -> set[tuple[Any, ...]]:
    fields = {
        (file.package, message.name, f.name, f.number, f.type, f.label, f.type_name)
        for file in found.file
        for message in file.message_type
        for f in message.field
    }
    values = {
        (file.package, enum.name, value.name, value.number)
        for file in found.file
        for enum in file.enum_type
        for value in enum.value
    }
    return fields | values
