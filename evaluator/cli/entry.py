"""What every command of the evaluator does around its work: output that may end early, errors, exit codes."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.arguments import write_json
from gpusimbench.schemas.commands.command_line import add_common
from gpusimbench.schemas.commands.output import let_readers_leave
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.commands.progress import Progress
from gpusimbench.schemas.errors import ExitCode, GsbError
from gpusimbench.schemas.location import redacted, shown_argument
from gpusimbench.schemas.text import line, show, write_every_sign

if TYPE_CHECKING:
    from gpusimbench.evaluator.render.document import Document

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
