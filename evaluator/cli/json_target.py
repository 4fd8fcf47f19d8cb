"""Where --json writes to."""

from __future__ import annotations

import sys
from pathlib import Path

from evaluator.cli.entry import write
from schemas import PARTIAL
from schemas.errors import UsageError


def check_target(target: str | None) -> None:
    """UsageError where "--json *.mcap" would overwrite a recording with results."""
    if target not in (None, "-") and Path(target).suffix in (".mcap", PARTIAL):
        raise UsageError(f"--json takes the file to write, or -; {target} is named like a recording")


def write_json(target: str, text: str) -> None:
    """Write a document to a file, or to standard output for "-"."""
    if target == "-":
        sys.stdout.write(text)
    else:
        write(Path(target), text)
