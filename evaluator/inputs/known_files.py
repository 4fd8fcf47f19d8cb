"""Files that were read before: found by the identity of their content, once that was verified."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.compute.cache import Store
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable
from gpusimbench.evaluator.read.stamp import Stamp, stamp_of
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.commands.progress import received, sizes
from gpusimbench.schemas.location import Place


@dataclass(frozen=True)
class KnownFiles:
    """What was read of files before, under the content hashes of their recordings.

    That a file has the content hash that it claims is found by verifying it, which takes far longer than all else. It
    is done once, and again whenever the file system says that the file is another one.
    """

    store: Store
    reader: Reader

    def find(self, path: Place) -> Run | None:
        """What was read of a file; None where it is not known, or may have changed."""
        stamp = stamp_of(path)
        if not stamp:
            return None
        content_hash = self.store.get(self.store.key(Stamp, stamp), str)
        run = self.store.get(self._key(content_hash, stamp), Run) if content_hash is not None else None
        return replace(run, path=path) if run is not None else None

    def keep(self, stamp: Stamp, run: Run) -> None:
        """Keep what was read and verified of a file: it had the stamp before, where it was read, and has it now."""
        if run.content_hash and run.stamp == stamp == stamp_of(run.path):
            self.store.put(self.store.key(Stamp, stamp), run.content_hash)
            self.store.put(self._key(run.content_hash, stamp), run)

    def _key(self, content_hash: str, stamp: Stamp) -> str:
        # of this very file: what the content hash does not cover, such as the cause of a failure, may be another's
        return self.store.key(Reader, [content_hash, stamp, self.reader.time])


def read_all(paths: Sequence[Place], reader: Reader, work: Work) -> Iterator[Run | Unreadable]:
    """Read files wherever the work is done, those that are not known, in order."""
    known = KnownFiles(work.store, reader) if work.store else None
    stamps = {path: stamp_of(path) for path in paths} if known else {}
    found: dict[Place, Run | Unreadable] = {path: old for path in paths if known and (old := known.find(path))}
    missing = [path for path in paths if path not in found]
    fresh = received(work.mapper(reader, missing), "reading recordings", len(missing), sizes(missing))
    for path in paths:
        if path in found:
            yield found[path]
            continue
        read = next(fresh)
        stamp = stamps.get(path)
        if known and stamp and reader.verify and isinstance(read, Run):
            known.keep(stamp, read)
        yield read
