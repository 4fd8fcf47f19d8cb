"""The one writer of every file that a command leaves: a reader meets the earlier file or the new one, whole.

A file is written under a random name in its own folder, which no link can wait under, flushed to the disk, and only
then given its name. A full disk, a kill or an error leaves what was there before as it was.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import GsbError, UsageError

_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EXDEV}
"""What os.link fails with on a file system without hard links."""

_NEW = os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_TRIES = 100


class Target(NamedTuple):
    """A file that is being written.

    stream  without a buffer
    path    of the file as long as it has not its final name
    """

    stream: FileIO
    path: Path


class Taken(GsbError):
    """A file of the final name appeared while the new one was written."""


# -- results, which replace those of an earlier time


def write_file(path: Path, content: bytes | str, *, durable: bool = True) -> None:
    """Write a result, whole or not at all, in place of an earlier one; a link of that name is replaced, not followed.

    A pipe, a device and /dev/stdout are written to as they are. Text is UTF-8, with escapes for what is no text.

    durable  flush it to the disk first; False for what can be made again at any time

    GsbError where it cannot be written.
    """
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    with _clear_error(path):
        if _is_stream(path):
            with FileIO(os.open(path, os.O_WRONLY | os.O_CLOEXEC), "wb") as stream:
                _write_all(stream, data)
            return
        with _temporary(path.parent) as target:
            _fill(target, data, durable)
            os.replace(target.path, path)
        if durable:
            flush_folder(path.parent)


def write_files(files: Mapping[Path, bytes | str]) -> None:
    """Write the files of one result: all of them, or none, and then those of an earlier time are there as they were.

    Folders are made where they are missing. GsbError where a file cannot be written.
    """
    with ExitStack() as stack:
        written: dict[Path, Path] = {}
        for path, content in files.items():
            data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
            with _clear_error(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                target = stack.enter_context(_temporary(path.parent))
                _fill(target, data, durable=True)
                written[path] = target.path
        _rename_all(written)
        for folder in dict.fromkeys(path.parent for path in written):
            with _clear_error(folder):
                flush_folder(folder)


def _rename_all(written: Mapping[Path, Path]) -> None:
    with ExitStack() as kept, ExitStack() as undone:
        for path, temporary in written.items():
            with _clear_error(path):
                if (earlier := _second_name(path)) is not None:
                    kept.callback(_remove, earlier)
                    undone.callback(_take_back, temporary, earlier, path)
                elif not os.path.lexists(path):
                    undone.callback(_take_back, temporary, None, path)
                os.replace(temporary, path)
        undone.pop_all()


def _take_back(temporary: Path, earlier: Path | None, path: Path) -> None:
    if temporary.exists():
        return  # it has not got its name
    with suppress(OSError):
        if earlier is None:
            path.unlink()
        else:
            os.replace(earlier, path)


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _second_name(path: Path) -> Path | None:
    """Of the file that has the name now; None where there is none, or the file system makes no link to it."""
    name = _random(path.parent)
    try:
        os.link(path, name, follow_symlinks=False)
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        return None
    return name


# -- files that must not replace any


def check_free(path: Path) -> None:
    """UsageError where the name is taken."""
    if os.path.lexists(path):
        raise UsageError(f"{path} exists already; nothing is overwritten: name another")


@contextmanager
def new_file(path: Path) -> Iterator[Target]:
    """A new file, which gets its name when the block ends, and is removed where an error ends it.

    UsageError where the name is taken, GsbError where it cannot be written.
    """
    check_free(path)
    with _clear_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _temporary(path.parent) as target:
            yield target
            os.fsync(target.stream.fileno())
            target.stream.close()
            give_name(target.path, path)


def write_new(path: Path, content: bytes) -> None:
    """Write a file that must not be there yet; errors as of `new_file`."""
    with new_file(path) as target:
        _write_all(target.stream, content)


def give_name(temporary: Path, path: Path) -> None:
    """Give a whole file its final name, which replaces no file, and flush the folder.

    Taken where a file of that name appeared meanwhile, and then it has both names no more than before; OSError where
    the disk says so.
    """
    try:
        os.link(temporary, path)  # unlike rename, never replaces a file
    except FileExistsError:
        raise Taken(f"{path} appeared meanwhile; it is left as it is") from None
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if os.path.lexists(path):
            raise Taken(f"{path} appeared meanwhile; it is left as it is") from None
        os.rename(temporary, path)
    else:
        os.unlink(temporary)
    flush_folder(path.parent)


def create(path: Path) -> FileIO:
    """A new file under this very name, for writing; OSError where the name is taken, by a link as well."""
    return FileIO(os.open(path, os.O_RDWR | _NEW, 0o666), "r+b")


def reopen(path: Path) -> FileIO:
    """A file that is there, for writing at its beginning; OSError where there is none, or a link in its place."""
    return FileIO(os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC), "r+b")


def open_lock(path: Path) -> int:
    """The descriptor of a file to be locked, made where it is missing; OSError where a link is in its place."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a new file of a temporary folder, piece by piece; OSError where it cannot be written."""
    with create(path) as stream:
        for piece in pieces:
            _write_all(stream, piece)


def flush_folder(folder: Path) -> None:
    """Make the names in a folder durable; OSError where the disk says that it cannot."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that has nothing to flush
            raise
    finally:
        os.close(descriptor)


# -- what they share


@contextmanager
def _temporary(folder: Path) -> Iterator[Target]:
    """An empty file of a random name, with the rights of any new file; what still has that name is removed."""
    for _ in range(_TRIES):
        path = _random(folder)
        with suppress(FileExistsError):
            stream = create(path)
            break
    else:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
    try:
        with stream:
            yield Target(stream, path)
    finally:
        _remove(path)


def _random(folder: Path) -> Path:
    return folder / f".gsb-{secrets.token_hex(8)}{PARTIAL}"


def _fill(target: Target, data: bytes, durable: bool) -> None:
    _write_all(target.stream, data)
    if durable:
        os.fsync(target.stream.fileno())
    target.stream.close()  # some file systems say only now that they are full


def _write_all(stream: FileIO, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[stream.write(left) :]


def _is_stream(path: Path) -> bool:
    """Whether it is a pipe or a device, or a name that the system has for one, which no file can take the place of."""
    try:
        mode = path.lstat().st_mode
    except OSError:
        return False
    if stat.S_ISLNK(mode):  # /dev/stdout, /dev/fd/3
        return Path(os.path.realpath(path.parent)).parts[:2] in (("/", "dev"), ("/", "proc"))
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


@contextmanager
def _clear_error(path: Path) -> Iterator[None]:
    """One clear message where the disk takes no more."""
    try:
        yield
    except OSError as error:
        raise GsbError(f"cannot write {path}: {error.strerror or error}") from None
