"""Arrays of a file in HDF5 that someone else wrote: read as numbers, no link followed, no other file opened."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording, NotARecording, UsageError
from gpusimbench.schemas.provenance import MAX_FIELDS

SUFFIXES = (".hdf5", ".h5")

_MOST_BYTES = 16 << 30  # of an array, which a small file can claim to have
_SPARSE_BYTES, _PACKED = 16 << 20, 1 << 12  # a larger array takes a byte of its file for so many of its own at least
_DEEPEST = 8
_HEAP, _HEADER = b"GCOL\x01\0\0\0", 16  # of a heap; bytes before its objects, and before each of them


@contextmanager
def opened_file(path: Path) -> Iterator[Any]:
    """The file, as h5py has it.

    UsageError where h5py is not installed; NotARecording where the file is not HDF5, or a pipe or a device, which h5py
    may wait for for ever; DamagedRecording where h5py cannot read what is asked of it.
    """
    try:
        import h5py
    except ImportError:
        raise UsageError("data sets in HDF5 need h5py: pip install h5py") from None
    if path.exists() and not path.is_file():
        raise NotARecording(f"{path} is not a file")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if error.errno:
            raise NotARecording(f"cannot read {path}: {os.strerror(error.errno)}") from None
        raise NotARecording(f"{path} is no HDF5 file: {error}") from None
    with file:
        try:
            yield file
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            # h5py has no kind of error for damaged bytes: which one it raises depends on what they were
            raise DamagedRecording(f"{path} is damaged, get it again: {error}") from error


def check_texts(path: Path) -> None:
    """DamagedRecording where a heap of texts is damaged in a way in which HDF5's library reads it for ever.

    The layout is the "global heap" of the HDF5 File Format Specification, version 3, III.E: a signature, the size of
    the heap, and objects, each with its number and its size. An object of number 0 is the free space.
    """
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as whole:
        at = whole.find(_HEAP)
        while at >= 0:
            end, there = at + int.from_bytes(whole[at + 8 : at + 16], "little"), at + _HEADER
            while there + _HEADER <= end:
                number, size = (int.from_bytes(whole[there + i : there + j], "little") for i, j in ((0, 2), (8, 16)))
                there += (size + 7) // 8 * 8 + (_HEADER if number else 0)
                if there > min(end, len(whole)) or (not number and size < _HEADER):
                    raise DamagedRecording(f"{path} is damaged, get it again: a heap of texts has other sizes")
            at = whole.find(_HEAP, at + 1)


def member(path: Path, group: Any, name: str) -> Any:
    """A member of a group; DamagedRecording where there is none, or where it is a link or lies in another file."""
    import h5py

    for part in name.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is not None and not isinstance(link, h5py.HardLink):
            raise DamagedRecording(f"{path}: {name} is a link, and none is followed")
        if link is None:
            raise DamagedRecording(f"{path} has no {name}")
        group = group[part]
    if isinstance(group, h5py.Dataset):
        if group.external or group.is_virtual or group.nbytes > _MOST_BYTES:
            raise DamagedRecording(f"{path}: {name} lies in another file, or is too large")
        if group.nbytes > max(_SPARSE_BYTES, _PACKED * group.id.get_storage_size()):
            raise DamagedRecording(f"{path}: {name} has {group.nbytes} bytes, most of which were never written")
    return group


def has(group: Any, name: str) -> bool:
    """Whether a group has a member of this name, or a link, also on the way to it: `member` refuses that.

    No link is followed, and no other file opened.
    """
    import h5py

    *folders, last = name.split("/")
    for folder in folders:
        if isinstance(group.get(folder, getlink=True), (h5py.ExternalLink, h5py.SoftLink)):
            return True
        if not is_group(group, folder):
            return False
        group = group[folder]
    return group.get(last, getlink=True) is not None


def is_group(file: Any, name: str) -> bool:
    """Whether a member is a group; no link is followed."""
    import h5py

    return isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group)


def read_array(path: Path, group: Any, name: str) -> NDArray[Any]:
    """The numbers of a member, of one axis or more; DamagedRecording where it has none."""
    item = member(path, group, name)
    if hasattr(item, "keys"):
        raise DamagedRecording(f"{path}: {name} is a group, and no array of numbers")
    found = np.asarray(item[()])
    if found.dtype.kind not in "fiub" or not found.ndim:
        raise DamagedRecording(f"{path}: {name} is no array of numbers")
    return found


def read_tree(path: Path, group: Any, name: str, called: str) -> dict[str, NDArray[Any]]:
    """The arrays of a member, named as gpusimbench.wrap names those of nested observations.

    DamagedRecording where a member has several names, so that a small file cannot have members without end; where there
    are more arrays than a recording may have; where groups are nested deeply.
    """
    found: dict[str, NDArray[Any]] = {}
    seen: set[int] = set()  # addresses in the file

    def add(group: Any, name: str, called: str, depth: int) -> None:
        item = member(path, group, name)
        before = len(seen)
        seen.add(_address(item))
        if len(seen) == before:
            raise DamagedRecording(f"{path}: {name} is there under another name, too")
        if not hasattr(item, "keys"):
            found[called] = read_array(path, group, name)
            if len(found) > MAX_FIELDS:
                raise DamagedRecording(f"{path}: {called.partition('/')[0]} has more than {MAX_FIELDS} arrays")
            return
        if depth > _DEEPEST:
            raise DamagedRecording(f"{path}: {name} is nested too deeply")
        for key in item:
            add(item, key, f"{called}/{key.removeprefix('_index_')}", depth + 1)

    add(group, name, called, 0)
    return found


def _address(item: Any) -> int:
    import h5py

    return int(h5py.h5o.get_info(item.id).addr)
