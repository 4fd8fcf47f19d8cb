"""Named arrays as the bytes of a NumPy archive (.npz): states that a run begins with, and snapshots of engines.

An archive that this module writes is not compressed and has no dates, so that the same arrays are the same bytes, and
their SHA-256 is their identity. One that comes from elsewhere is read within bounds, and nothing of it is executed.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording

MEDIA_TYPE = "application/x-npz"
"""Of an attachment that is an archive."""

MAX_ARRAYS = 4096
"""Arrays of an archive that is read."""

MAX_BYTES = 1 << 30
"""Of an archive's arrays together, before they are read."""

_HEAD_BYTES = 4096  # of a .npy file, besides its numbers
_KINDS = "biufU"  # of numbers and texts: none that has to be unpickled


def encode(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The archive; ValueError for an array of objects."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getbuffer())
    return stream.getvalue()


def decode(name: str, data: bytes, *, most: int = MAX_BYTES) -> dict[str, NDArray[Any]]:
    """The arrays of an archive.

    name  of the archive, for messages
    most  bytes that its arrays may have together

    DamagedRecording where the bytes are no archive of arrays of numbers or texts, or of more than that.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > MAX_ARRAYS:
                raise DamagedRecording(f"{name} has {len(members)} arrays, more than the {MAX_ARRAYS} that are read")
            if (size := sum(member.file_size for member in members)) > most + _HEAD_BYTES * len(members):
                raise DamagedRecording(f"{name} has {size} bytes of arrays, more than the {most} that are read")
            return {member.filename.removesuffix(".npy"): _array(archive, member) for member in members}
    except DamagedRecording:
        raise
    except Exception as error:  # zipfile and NumPy raise what they like for bytes that are none of theirs
        raise DamagedRecording(f"{name} is no archive of arrays: {' '.join(str(error).split())}") from None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as stream:
        content = stream.read(member.file_size)  # no more is decompressed, even where the archive's directory lies
    head = io.BytesIO(content)
    version = np.lib.format.read_magic(head)
    parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_columns, dtype = parse(head)
    if dtype.kind not in _KINDS:
        raise ValueError(f"{member.filename} is of type {dtype}")
    values = np.frombuffer(content, dtype, offset=head.tell())  # a shape is a stranger's: no memory is given by it
    array: NDArray[Any] = values.reshape(shape, order="F" if by_columns else "C").copy()
    return array
