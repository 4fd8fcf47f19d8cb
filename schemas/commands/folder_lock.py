"""A command's lock on a folder: one command at a time makes the recordings of one plan there.

The lock is one of the operating system (flock), so that it ends with the process that holds it, however that ends. Its
file has the holder's process id and host, and is removed with the lock.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.text import line, show
from gpusimbench.schemas.writing import open_lock

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
"""What flock fails with on a file system without locks."""

_MOST_BYTES = 4096  # of the holder's word


@contextmanager
def folder_lock(folder: Path, name: str, doing: str) -> Iterator[None]:
    """Hold a lock of this name on a folder, which is made where it is missing, while the block runs.

    doing  what its holder does, in words that end a sentence's subject: "makes this sweep"

    GsbError where another process holds it, which the message names.
    """
    path = folder / f".{name}.lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GsbError(f"cannot make {folder}: {error.strerror}; choose another folder with --out") from None
    descriptor = _take(path, folder, doing)
    try:
        yield
    finally:
        if descriptor is not None:
            with suppress(OSError):  # a folder that is there no more has no lock either
                path.unlink()
            os.close(descriptor)


def _take(path: Path, folder: Path, doing: str) -> int | None:
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
                f"{holder} {doing} in {folder} already: wait for its end, or choose another folder with --out"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise GsbError(f"cannot lock {folder}: {error.strerror}; choose another folder with --out") from None
            os.close(descriptor)
            with suppress(OSError):
                path.unlink()
            show(
                line(f"{folder} is on a file system without locks: see that no other command {doing} there"), error=True
            )
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
