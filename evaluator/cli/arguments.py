"""Arguments that several commands have: files of this machine, where --json writes to, the sample time."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.location import is_address, shown
from gpusimbench.schemas.text import show_document
from gpusimbench.schemas.writing import write_file

if TYPE_CHECKING:
    from gpusimbench.evaluator.compute.cache import Store


def local_name(text: str) -> str:
    """A path as it was given, or - for standard output; an address is wrong usage, and its secrets are kept."""
    if is_address(text):
        raise argparse.ArgumentTypeError(f"{shown(text)} is an address; name a file or folder of this machine")
    return text


def local_path(text: str) -> Path:
    """A file or folder of this machine, as of `local_name`."""
    return Path(local_name(text))


def add_sample_time(parser: argparse.ArgumentParser) -> None:
    """Add --sample-time, which is None where it is not given."""
    parser.add_argument(
        "--sample-time",
        type=float,
        metavar="S",
        help="simulated time at which positions and joints are compared [s] (default: what the scene names, 5.0 for "
        "the built-in ones; where it names none, or all recordings end before, the last time that all of them have)",
    )


def check_sample_time(seconds: float | None) -> None:
    """UsageError where no positions can be compared at a time; None, for the default, is right."""
    if seconds is not None and not 0 < seconds < float("inf"):
        raise UsageError(f"--sample-time is a time in seconds above 0, not {seconds}")


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --json, which writes `what` a command comes to."""
    parser.add_argument(
        "--json", type=local_name, metavar="FILE", help=f"write the {what} as JSON; - for standard output, alone"
    )


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


def add_cache(parser: argparse.ArgumentParser) -> None:
    """Add --cache and --no-cache."""
    parser.add_argument(
        "--cache", type=local_path, metavar="DIR", help="where to keep results (default: the user's cache folder)"
    )
    parser.add_argument("--no-cache", action="store_true", help="compute everything anew and keep nothing")


def store_of(arguments: argparse.Namespace) -> Store | None:
    """Where results are kept between commands; None where they are not."""
    from gpusimbench.evaluator.compute.cache import Store, default_folder

    if arguments.cache and arguments.cache.exists() and not arguments.cache.is_dir():
        raise UsageError(f"--cache must be a folder, and {arguments.cache} is not one")
    folder = None if arguments.no_cache else arguments.cache or default_folder()
    return Store(folder) if folder else None
