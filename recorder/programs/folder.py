"""The folder of a program's run: how the program finds it, and what describes the program there."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import PROGRAM
from gpusimbench.schemas.writing import write_file

VARIABLE = "GSB_RUN"
"""The environment variable that names the folder of a run to the program that gsb-run runs."""

_LARGEST = 64 << 20  # of a file of the command line that is hashed


def placed(path: str | Path) -> Path:
    """Where a program's recording is written: within a run of gsb-run, a relative path lies in the folder of the run.

    The folders of such a path are made. Everywhere else, and for absolute paths, the path itself. UsageError where a
    relative path leads out of the folder, or its folders cannot be made.
    """
    given, folder = Path(path), os.environ.get(VARIABLE)
    if not folder or given.is_absolute():
        return given
    if ".." in given.parts:
        raise UsageError(f"{path} leads out of the folder of the run ({VARIABLE}={folder})")
    found = Path(folder) / given
    try:
        found.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make {found.parent}: {error.strerror}") from None
    return found


def description() -> bytes | None:
    """What gsb-run wrote of the program that this process runs; None outside of a run."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        return None
    try:
        return (Path(folder) / PROGRAM).read_bytes()
    except OSError:
        return None


def describe(folder: Path, command: Sequence[str]) -> None:
    """Write the command, and the SHA-256 of the files that it names. The same for all runs of one command.

    GsbError where it cannot be written.
    """
    files = {word: digest for word in command if (digest := _digest(Path(word)))}
    text = json.dumps({"command": list(command), "files": files}, indent=1, sort_keys=True)
    write_file(folder / PROGRAM, text + "\n", durable=False)


def _digest(path: Path) -> str:
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            return ""
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError):  # a word that is no path at all
        return ""
