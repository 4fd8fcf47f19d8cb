"""Files that were read before: found by the identity of their content, once that was verified."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.compute.cache.store import Store
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.read.stamp import Stamp, stamp_of
from gpusimbench.evaluator.runs.reading import Read, Reader, Unreadable
from gpusimbench.evaluator.runs.run_data import RunData
from gpusimbench.evaluator.runs.summary import Summary
from gpusimbench.schemas.location import Place


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
        if not stamp or not isinstance(content_hash, str):
            return None
        found = self.store.get(self._key(content_hash, stamp))
        run = found if isinstance(found, RunData) else None
        known = run.recording if run else found
        if not isinstance(known, Summary):
            return None
        summary = replace(known, path=path)
        return Read(summary, replace(run, recording=summary) if run else None)

    def keep(self, stamp: Stamp, read: Read) -> None:
        """Keep what was read and verified of a file: it had the stamp before, where it was read, and has it now."""
        if read.summary.content_hash and read.stamp == stamp == stamp_of(read.summary.path):
            self.store.put(self.store.key(Stamp, stamp), read.summary.content_hash)
            self.store.put(self._key(read.summary.content_hash, stamp), read.run or read.summary)

    def _key(self, content_hash: str, stamp: Stamp) -> str:
        # of this very file: what the content hash does not cover, such as the cause of a failure, may be another's
        return self.store.key(Reader, [content_hash, stamp, self.sample_time])


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
