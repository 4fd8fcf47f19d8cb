"""Files as commands are given them: folders, patterns and addresses that stand for several files; copies that do not
last of files elsewhere; and whether a file is still the one that was read."""

from __future__ import annotations

import glob
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import GsbError, Unreachable, UsageError
from gpusimbench.schemas.location import Location, Place
from gpusimbench.schemas.scratch import empty_folder
from gpusimbench.schemas.writing import write_pieces

_NAMED = 6

MAX_FILES = 10_000
"""An address that stands for more files is refused."""

_SETTLED_NS = 2_000_000_000
"""A file that was written so recently may change once more without its times telling."""


def expand(places: Sequence[Place], *, copies: bool = False) -> list[Place]:
    """Each folder, and each path and address with wildcards, as the files that it stands for; each file once.

    A folder stands for the recordings directly in it, not for those of the folders below it. A path with wildcards that
    stands for nothing stays as it is, and whoever opens it says that there is no such file.

    copies  what is named twice is there twice

    UsageError for a folder without recordings; Unreachable where a file system does not tell.
    """
    found: list[Place] = []
    for given in places:
        if isinstance(given, Location):
            from gpusimbench.schemas.remote.file import matching

            found += matching(given, MAX_FILES)
        else:
            found += _expanded(given)
    return found if copies else list(dict.fromkeys(found))


def left_below(places: Sequence[Place]) -> list[str]:
    """A sentence for each folder among these with recordings in folders below it that are not given themselves."""
    folders = [place for place in places if isinstance(place, Path) and place.is_dir()]
    given = {folder.resolve() for folder in folders}
    said = []
    for folder in folders:
        below = [path for path in folder.glob("*/*.mcap") if path.parent.resolve() not in given]
        if names := sorted({path.parent.name for path in below}):
            more = ", ..." if len(names) > _NAMED else ""
            said.append(
                f"{folder} stands for the recordings directly in it; {len(below)} more are in folders below it, to be "
                f"named as well: {', '.join(names[:_NAMED])}{more}"
            )
    return said


def expand_paths(paths: Sequence[Path]) -> list[Path]:
    """Files of this machine, as of `expand`, each once."""
    return list(dict.fromkeys(path for given in paths for path in _expanded(given)))


def _expanded(given: Path) -> list[Path]:
    if glob.has_magic(str(given)) and not given.exists():
        return sorted(map(Path, glob.glob(str(given)))) or [given]
    return recordings_in(given) if given.is_dir() else [given]


def recordings_in(folder: Path) -> list[Path]:
    """The recordings of a folder, sorted, also what a crash left of one; none of the folders below it.

    UsageError where it has none.
    """
    found = sorted(folder.glob("*.mcap")) + sorted(filter(_has_bytes, folder.glob(f"*.mcap{PARTIAL}")))
    if not found:
        below = sorted({path.parent for path in folder.glob("*/*.mcap")})
        hint = f"; there are some in {below[0]}: name that folder" if below else ""
        if len(below) > 1:
            hint = f"; there are some in {len(below)} folders below it: give {folder}/*/*.mcap"
        raise UsageError(f"{folder} is a folder without recordings (*.mcap){hint}")
    return found


def _has_bytes(path: Path) -> bool:
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:  # its run has ended meanwhile
        return False


@contextmanager
def fetched(location: Location, *, size: int | None = None) -> Iterator[Path]:
    """A copy of a file on this machine's disk, gone afterwards; what is mapped of it stays readable.

    size  that it must have, or nothing of it is fetched; None for any

    Unreachable where it cannot be had, or there is no room for it; GsbError where the copy cannot be written.
    """
    from gpusimbench.schemas.remote.file import RemoteFile

    source = RemoteFile(location)
    if size is not None and source.size != size:
        raise Unreachable(f"{location} has {source.size} bytes, not {size}")
    with empty_folder() as folder:
        free = shutil.disk_usage(folder).free
        if source.size > free:
            raise Unreachable(
                f"{location} has {source.size} bytes, and {tempfile.gettempdir()}, where it would be checked, has room "
                f"for {free}: set TMPDIR to a folder with more"
            )
        copy = folder / "copy.mcap"
        try:
            write_pieces(copy, source.pieces())
        except OSError as error:
            raise GsbError(f"cannot copy {location} to {folder}: {error.strerror}") from None
        yield copy


@dataclass(frozen=True)
class Stamp:
    """What a file system says of a file; a changed file has another, whatever is done to its modification time."""

    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int


def stamp_of(path: Place) -> Stamp | Missing:
    """The stamp of a file of this machine; Missing where there is none that can be relied on."""
    if isinstance(path, Location):
        return Missing("the file is elsewhere")
    with suppress(OSError, ValueError):
        status = path.stat()
        if time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS:
            return Stamp(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    return Missing("the file was changed a moment ago, or cannot be asked for its times")
