"""Reading files that were read before: by the identity of their content, once that was verified."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from evaluator.cache.store import Store
from evaluator.reading import Read, Reader, Unreadable
from evaluator.run_data import RunData

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
class StoredReader:
    """Reads files as `reader` does, and keeps what it read under the content hash of the recording.

    That a file has the content hash that it claims is found by verifying it, which takes far longer than all else. It
    is done once, and again whenever the file system says that the file is another one.
    """

    reader: Reader
    store: Store

    def __call__(self, path: Path) -> Read | Unreadable:
        """Read one file, or find it."""
        stamp = stamp_of(path)
        if stamp is None:
            return self.reader(path)
        content_hash = self.store.get(self.store.key(Stamp, stamp))
        if isinstance(content_hash, str) and (known := self._known(path, content_hash)):
            return known
        found = self.reader(path)
        if isinstance(found, Read) and self.reader.verify and found.summary.content_hash and stamp_of(path) == stamp:
            self.store.put(self.store.key(Stamp, stamp), found.summary.content_hash)
            self.store.put(self._key(found.summary.content_hash), found.run or found.summary)
        return found

    def _known(self, path: Path, content_hash: str) -> Read | None:
        found = self.store.get(self._key(content_hash))
        if found is None:
            return None
        run = found if isinstance(found, RunData) else None
        summary = replace(run.recording if run else found, path=path)
        return Read(summary, replace(run, recording=summary) if run else None)

    def _key(self, content_hash: str) -> str:
        return self.store.key(Reader, content_hash, self.reader.sample_time)


def stamp_of(path: Path) -> Stamp | None:
    """The stamp of a file; None where there is none that can be relied on."""
    with suppress(OSError, ValueError):
        status = path.stat()
        if time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS:
            return Stamp(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    return None
