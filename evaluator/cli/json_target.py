"""Where --json writes to."""

from __future__ import annotations

from pathlib import Path

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import show_document
from gpusimbench.schemas.writing import write_file


def check_target(target: str | None) -> None:
    """UsageError where "--json *.mcap" would overwrite a recording, or where no file can be; before any work."""
    if target is None or target == "-":
        return
    path = Path(target)
    if path.suffix in (".mcap", PARTIAL):
        raise UsageError(f"--json takes the file to write, or -; {target} is named like a recording")
    if path.is_dir() or not path.parent.is_dir():
        what = "a folder" if path.is_dir() else f"in no folder that exists ({path.parent})"
        raise UsageError(f"--json takes the file to write, or -; {target} is {what}")


def write_json(target: str, text: str) -> None:
    """Write a document to a file, or to standard output for "-"."""
    if target == "-":
        show_document(text)
    else:
        write_file(Path(target), text)
