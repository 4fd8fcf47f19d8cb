"""Arguments that name a file of this machine, and nothing else."""

from __future__ import annotations

import argparse
from pathlib import Path

from gpusimbench.schemas.location import is_address, shown


def local_name(text: str) -> str:
    """A path as it was given, or - for standard output; an address is wrong usage, and its secrets are kept."""
    if is_address(text):
        raise argparse.ArgumentTypeError(f"{shown(text)} is an address; name a file or folder of this machine")
    return text


def local_path(text: str) -> Path:
    """The same, as a path."""
    return Path(local_name(text))
