"""Files that were read before: found by the identity of their content, once that was verified."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from evaluator.cache.store import Store
from evaluator.reading import Read, Reader, Unreadable
from evaluator.run_data import RunData
from evaluator.work import Work
from schemas.location import Location, Place

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


@dataclass(frozen=True)
class KnownFiles:
    """What was read of files before, under the content hashes of their recordings.

    That a file has the content hash that it claims is found by verifying it, which takes far longer than all else. It
    is done once, and again whenever the file system says that the file is another one.
    """

    store: Store
    sample_time: float

    def find(self, path: Place) -> Read | None:
        """What was read of a file; None where it is not known, or may have changed."""
        stamp = stamp_of(path)
        content_hash = stamp and self.store.get(self.store.key(Stamp, stamp))
        found = self.store.get(self._key(content_hash)) if isinstance(content_hash, str) else None
        if found is None:
            return None
        run = found if isinstance(found, RunData) else None
        summary = replace(run.recording if run else found, path=path)
        return Read(summary, replace(run, recording=summary) if run else None)

    def keep(self, stamp: Stamp, read: Read) -> None:
        """Keep what was read and verified of a file that has the stamp before and after."""
        if read.summary.content_hash and stamp_of(read.summary.path) == stamp:
            self.store.put(self.store.key(Stamp, stamp), read.summary.content_hash)
            self.store.put(self._key(read.summary.content_hash), read.run or read.summary)

    def _key(self, content_hash: str) -> str:
        return self.store.key(Reader, [content_hash, self.sample_time])


def read_all(paths: Sequence[Place], reader: Reader, work: Work) -> Iterator[Read | Unreadable]:
    """Read files wherever the work is done, those that are not known, in order."""
    known = KnownFiles(work.store, reader.sample_time) if work.store else None
    stamps = {path: stamp_of(path) for path in paths} if known else {}
    found: dict[Place, Read | Unreadable] = {path: old for path in paths if known and (old := known.find(path))}
    fresh = iter(work.mapper(reader, [path for path in paths if path not in found]))
    for path in paths:
        if path in found:
            yield found[path]
            continue
        read = next(fresh)
        stamp = stamps.get(path)
        if known and stamp and reader.verify and isinstance(read, Read):
            known.keep(stamp, read)
        yield read


def stamp_of(path: Place) -> Stamp | None:
    """The stamp of a file of this machine; None where there is none that can be relied on."""
    if isinstance(path, Location):
        return None
    with suppress(OSError, ValueError):
        status = path.stat()
        if time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS:
            return Stamp(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    return None
