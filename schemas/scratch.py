"""Temporary folders, such as the one that the process of a run works in; and those that nobody is left to remove.

A run's process removes its folder even if its recorder was killed. Where all who would remove a folder were killed, the
next one that is made removes it: a file in it is locked for as long as any process has the file open. In the folder of
a run, it is the file that the run prints to.

A folder has the name that others look for once its file is locked, so that no clock has to tell how old it is. The name
says which machine it is of, for machines with one folder for temporary files may not see each other's locks.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.writing import create, reopen

OUTPUT = "output"
"""In the folder: the file that is locked, which has what the run's process prints."""

_MACHINE = Path("/etc/machine-id")
_MACHINE_CHARACTERS = 8


@contextmanager
def scratch_folder() -> Iterator[tuple[Path, FileIO]]:
    """A new folder and its open OUTPUT, which processes that work there have to inherit; it is removed afterwards.

    GsbError where there is no room for it.
    """
    with making():
        remove_abandoned()
        folder = Path(tempfile.mkdtemp(prefix="gsb-new-"))
    try:
        with making():
            output = create(folder / OUTPUT)
        with output:
            with suppress(OSError):  # a file system without locks: then nobody finds it abandoned, either
                fcntl.flock(output, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with making():
                folder = folder.rename(folder.with_name(folder.name.replace("gsb-new-", _prefix())))
            yield folder, output
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def empty_folder() -> Iterator[Path]:
    """A new empty folder, for files of any name, within one as of scratch_folder; GsbError as there."""
    with scratch_folder() as (folder, _):
        inside = folder / "files"
        with making():
            inside.mkdir()
        yield inside


@contextmanager
def making() -> Iterator[None]:
    """GsbError where temporary files cannot be made."""
    try:
        yield
    except OSError as error:
        where = f" {error.filename}" if error.filename else ""
        reason = f"cannot make the temporary file{where}: {error.strerror}"
        raise GsbError(f"{reason}; set TMPDIR to a folder that can be written and has room") from None


def remove_abandoned() -> None:
    """Remove the folders of this user on this machine of which no process is left, from before it started, too."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_prefix()}*"):
        with suppress(OSError):  # of another user, or removed meanwhile
            found = folder.lstat()
            if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode):
                continue
            with reopen(folder / OUTPUT) as output:
                fcntl.flock(output, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)


def _prefix() -> str:
    # copies of a machine share the id, and containers of a machine may; they have other names
    machine = os.uname().nodename
    with suppress(OSError):
        machine += _MACHINE.read_text()
    return f"gsb-work-{hashlib.sha256(machine.encode()).hexdigest()[:_MACHINE_CHARACTERS]}-"
