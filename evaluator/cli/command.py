"""What every command of the evaluator has: common arguments, output that may end early, errors, exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.commands.output import let_readers_leave
from gpusimbench.schemas.commands.parser import Parser, add_common
from gpusimbench.schemas.commands.progress import Progress
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.location import is_address, redacted, shown, shown_argument
from gpusimbench.schemas.text import line, show, show_document, write_every_sign
from gpusimbench.schemas.writing import write_file

if TYPE_CHECKING:
    from gpusimbench.evaluator.compute.cache import Store
    from gpusimbench.evaluator.render.document import Document


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


_NO_THREAD = "can't start new thread"
"""What Python says of a thread whose stack finds no memory."""


def new_parser(command: str, description: str, epilog: str, reads: Iterable[str] = ()) -> Parser:
    """A parser of a command's arguments, with what all commands have.

    reads  variables of the environment, as of add_common, beside that of the Progress of every command
    """
    p = Parser(
        prog=command, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_common(p, reads=sorted({*reads, "GSB_PROGRESS"}))
    return p


def _enter(
    parser: argparse.ArgumentParser, run: Callable[[argparse.Namespace], int], argv: list[str] | None = None
) -> int:
    """Parse the arguments, do the work and return the exit code; every error is one line on standard error.

    run  takes the arguments; their `command_line` is the whole command as a shell would take it, without what gives
         access to addresses
    """
    let_readers_leave()
    given = sys.argv[1:] if argv is None else argv
    arguments = parser.parse_args(given)
    arguments.command_line = shlex.join([parser.prog, *map(shown_argument, given)])
    write_every_sign()
    try:
        with warnings.catch_warnings():
            # states may be of any size, or not finite: the results say so, and no library beside them
            warnings.simplefilter("ignore", RuntimeWarning)
            with Progress(parser.prog):
                code = run(arguments)
        sys.stdout.flush()
    except GsbError as error:
        complain(parser.prog, error.advised)
        return int(error.exit_code)
    except KeyboardInterrupt:
        complain(parser.prog, "interrupted")
        return int(ExitCode.FAILURE)
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and str(error) != _NO_THREAD:
            raise
        complain(parser.prog, "not enough memory: free some, or give fewer files at a time")
        return int(ExitCode.FAILURE)
    except OSError as error:
        # the disk of our output is full; what is left in the buffer must not complain again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        complain(parser.prog, f"cannot write the results: {error.strerror}")
        return int(ExitCode.FAILURE)
    return code


def entry_point(
    parser: Callable[[], argparse.ArgumentParser], run: Callable[[argparse.Namespace], int]
) -> Callable[..., int]:
    """The function that a command is installed as: it takes the arguments and returns the exit code (see `_enter`)."""

    def main(argv: list[str] | None = None) -> int:
        return _enter(parser(), run, argv)

    return main


def answer(target: str | None, dumped: Callable[[], str], shown: Callable[[], Document]) -> None:
    """Print what a command found, and write it as JSON where --json names a target; to "-" only the JSON is printed."""
    from gpusimbench.evaluator.render.terminal import print_document

    if target:
        write_json(target, dumped())
    if target != "-":
        print_document(shown(), sys.stdout)


def say(said: str) -> None:
    """How far a command is: one line on standard error."""
    show(line(said), error=True)


def complain(command: str, message: str) -> None:
    """One line on standard error; what a terminal would obey in it is shown, not done.

    Of addresses, what gives access is left out.
    """
    show(line(f"{command}: {redacted(message)}"), error=True)
