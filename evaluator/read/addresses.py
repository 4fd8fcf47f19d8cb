"""Files elsewhere, as commands are given them: addresses that stand for several files, and copies that do not last."""

from __future__ import annotations

import glob
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from gpusimbench.schemas.errors import GsbError, Unreachable
from gpusimbench.schemas.location import Location, Place
from gpusimbench.schemas.writing import write_pieces

MAX_FILES = 10_000
"""An address that stands for more files is refused."""


def expand(places: Sequence[Place], *, copies: bool = False) -> list[Place]:
    """Each path and address with wildcards as the files that it stands for, the others as they are; each file once.

    A path with wildcards that stands for nothing stays as it is, and whoever opens it says that there is no such file.

    copies  what is named twice is there twice

    Unreachable where a file system does not tell.
    """
    found: list[Place] = []
    for given in places:
        if isinstance(given, Location):
            from gpusimbench.schemas.remote import matching

            found += matching(given, MAX_FILES)
        elif glob.has_magic(str(given)) and not given.exists():
            found += sorted(map(Path, glob.glob(str(given)))) or [given]
        else:
            found.append(given)
    return found if copies else list(dict.fromkeys(found))


@contextmanager
def fetched(location: Location, *, size: int | None = None) -> Iterator[Path]:
    """A copy of a file on this machine's disk, gone afterwards; what is mapped of it stays readable.

    size  that it must have, or nothing of it is fetched; None for any

    Unreachable where it cannot be had, or there is no room for it; GsbError where the copy cannot be written.
    """
    from gpusimbench.schemas.remote import RemoteFile

    source = RemoteFile(location)
    if size is not None and source.size != size:
        raise Unreachable(f"{location} has {source.size} bytes, not {size}")
    with tempfile.TemporaryDirectory(prefix="gpusimbench-", ignore_cleanup_errors=True) as folder:
        free = shutil.disk_usage(folder).free
        if source.size > free:
            raise Unreachable(
                f"{location} has {source.size} bytes, and {Path(folder).parent}, where it would be checked, has room "
                f"for {free}: set TMPDIR to a folder with more"
            )
        copy = Path(folder, "copy.mcap")
        try:
            write_pieces(copy, source.pieces())
        except OSError as error:
            raise GsbError(f"cannot copy {location} to {folder}: {error.strerror}") from None
        yield copy
