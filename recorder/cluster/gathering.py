"""Files of a run on a node, copied into the command's folder: piece by piece, checked, and only then named."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.recorder.plan import partial_of, publish, reserve
from gpusimbench.recorder.process.planned_run import PlannedRun
from gpusimbench.recorder.sets.finished import run_end
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import GsbError, RecordingError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import PROVENANCE, Provenance
from gpusimbench.schemas.writing import reopen

Read = Callable[[str, int, int], bytes]
"""Bytes of a file on the node: its path, an offset, a number of bytes."""

PIECE_BYTES = 4 << 20
"""Of a file that are on their way at a time: a store of objects need hold no recording."""


class Spoiled(GsbError):
    """What came is not what the node has, or not the run that was asked for."""


class Stopped(GsbError):
    """The copying was given up, and leaves nothing behind."""


@dataclass(frozen=True)
class Remote:
    """A file on a node, as the node describes it: bytes and SHA-256."""

    name: str
    size: int
    sha256: str

    @property
    def whole(self) -> bool:
        """Whether it has its final name."""
        return not self.name.endswith(PARTIAL)


def gather(
    planned: PlannedRun,
    files: Iterable[Mapping[str, Any]],
    source: str,
    folder: Path,
    read: Read,
    stop: Callable[[], bool],
) -> dict[str, Path]:
    """Copy the files of a run; returns where each is, by the name that it has on the node.

    source  folder on the node
    folder  here; names are chosen in it as for a run that is made here
    stop    whether to give it up; asked between pieces

    Spoiled, Stopped; GsbError or OSError where the folder does not take the files; and what `read` raises. Nothing is
    left behind then, but for a whole recording whose name was taken meanwhile.
    """
    found = [Remote(str(file["name"]), int(file["size"]), str(file["sha256"])) for file in files]
    here: dict[str, Path] = {}
    try:
        # what a killed run left had its name before the recording that says so
        for file in sorted(found, key=lambda file: (file.whole, file.name)):
            here[file.name] = _copy(planned, file, f"{source}/{file.name}", folder, read, stop)
    except BaseException:
        for path in here.values():
            path.unlink(missing_ok=True)
        raise
    return here


def _copy(planned: PlannedRun, file: Remote, source: str, folder: Path, read: Read, stop: Callable[[], bool]) -> Path:
    path = reserve(folder, planned.configuration, planned.provenance.created_utc)
    partial = partial_of(path)
    try:
        digest = hashlib.sha256()
        with reopen(partial) as stream:
            offset = 0
            while offset < file.size:
                if stop():
                    raise Stopped(f"{path.name} was on its way and is given up")
                piece = read(source, offset, min(PIECE_BYTES, file.size - offset))
                if not piece:
                    break
                digest.update(piece)
                view = memoryview(piece)
                while view:
                    view = view[stream.write(view) :]
                offset += len(piece)
            os.fsync(stream.fileno())
        if (offset, digest.hexdigest()) != (file.size, file.sha256):
            raise Spoiled(
                f"{offset} bytes came of {file.size}, and their SHA-256 is not the one that the node computed"
            )
        if not file.whole:
            return partial
        _check(partial, planned)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    publish(path)  # where that fails, the run is in the .partial file, and the error says so
    return path


def _check(path: Path, planned: PlannedRun) -> None:
    try:
        container = Container(path)
        said = container.attachment(PROVENANCE)
        if run_end(container) is None or said is None:
            raise Spoiled("the recording that came has no end")
        if Provenance.from_json(said).run_id != planned.provenance.run_id:
            raise Spoiled("the recording that came is that of another run")
    except RecordingError as error:
        raise Spoiled(f"the recording that came cannot be read: {error}") from None
