"""A sweep's lock on its folder: one command at a time makes the runs of a sweep there.

The lock is one of the operating system (flock), so that it ends with the process that holds it, however that ends. Its
file has the holder's process id and host, and is removed with the lock. Two sweeps have one lock where recordings of
one would count for the other (recorder.sets.finished.matching); other sweeps, and sets of runs, may share the folder.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gpusimbench.recorder.sets.finished import in_common
from gpusimbench.recorder.sets.progress import say
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.writing import open_lock

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
"""What flock fails with on a file system without locks."""

_MOST_BYTES = 4096  # of the holder's word


@contextmanager
def locked(folder: Path, wanted: RunConfiguration, where: str) -> Iterator[None]:
    """Hold the lock of a sweep of `wanted`, made `where` (recorder.sets.finished.where_am_i), while the block runs.

    GsbError where another process holds it, which the message names.
    """
    path = folder / f".gsb-sweep-{_key(wanted, where)}.lock"
    descriptor = _take(path, folder)
    try:
        yield
    finally:
        if descriptor is not None:
            with suppress(OSError):  # a folder that is there no more has no lock either
                path.unlink()
            os.close(descriptor)


def _key(wanted: RunConfiguration, where: str) -> str:
    text = json.dumps([in_common(wanted).to_json(), where], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _take(path: Path, folder: Path) -> int | None:
    while True:
        try:
            descriptor = open_lock(path)
        except OSError as error:
            raise GsbError(f"cannot lock {folder}: {error.strerror}; choose another folder with --out") from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _is(path, descriptor):  # the holder removed it between our opening and our locking it
                os.close(descriptor)
                continue
        except BlockingIOError:
            holder = _holder(descriptor)
            os.close(descriptor)
            raise GsbError(
                f"{holder} makes this sweep in {folder} already: wait for its end, or choose another folder with --out"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise GsbError(f"cannot lock {folder}: {error.strerror}; choose another folder with --out") from None
            os.close(descriptor)
            with suppress(OSError):
                path.unlink()
            say(f"{folder} is on a file system without locks: see that no other command makes this sweep there")
            return None
        with suppress(OSError):  # a full disk has room for the lock, and not for the holder's name
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode(), 0)
        return descriptor


def _is(path: Path, descriptor: int) -> bool:
    mine = os.fstat(descriptor)
    try:
        there = os.stat(path, follow_symlinks=False)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (mine.st_dev, mine.st_ino)


def _holder(descriptor: int) -> str:
    try:
        said: Any = json.loads(os.pread(descriptor, _MOST_BYTES, 0))
        return f"process {int(said['pid'])} on {str(said['host'])!a}"
    except (OSError, ValueError, LookupError, TypeError):
        return "another process"
