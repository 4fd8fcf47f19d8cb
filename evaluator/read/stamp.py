"""Whether a file is still the one that was read, by the word of the file system."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.location import Location, Place

_SETTLED_NS = 2_000_000_000
"""A file that was written so recently may change once more without its times telling."""


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
