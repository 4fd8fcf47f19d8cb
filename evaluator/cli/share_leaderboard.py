"""The verb of gsb-share that ranks simulators: leaderboard."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from gpusimbench.evaluator.cli.arguments import local_path
from gpusimbench.evaluator.cli.entry import complain
from gpusimbench.evaluator.cli.share_set import check_time
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import block, show

if TYPE_CHECKING:
    from gpusimbench.evaluator.compute.work import Work

_LEADERBOARD = (
    "Write a page that ranks simulators within each scene and device, from recordings alone: there is no way to type a "
    "number in."
)


def add_verb(verbs: Any) -> None:
    """Add the verb's arguments."""
    v = verbs.add_parser("leaderboard", help="a page that ranks simulators", description=_LEADERBOARD)
    v.add_argument("sets", nargs="+", type=place, metavar="SET", help="recordings, folders of them, addresses")
    v.add_argument("--out", type=local_path, required=True, metavar="DIR", help="for index.html and its data")
    v.add_argument(
        "--title", default="Leaderboard of robot simulators", metavar="TEXT", help="of the page (default: %(default)s)"
    )
    v.add_argument("--sample-time", type=float, default=5.0, metavar="S", help="simulated time (default: 5.0)")
    v.add_argument("--cache", type=local_path, metavar="DIR", help="where to keep results (default: as gsb-eval)")
    v.add_argument("--no-cache", action="store_true", help="compute everything anew and keep nothing")


def leaderboard(arguments: argparse.Namespace) -> int:
    """Write a leaderboard; returns the exit code."""
    from gpusimbench.evaluator.share.leaderboard.make import make_leaderboard
    from gpusimbench.evaluator.share.leaderboard.words import leaderboard_lines

    check_time(arguments.sample_time)
    if not arguments.title.strip() or not arguments.title.isprintable():
        raise UsageError("--title is a line of text")
    done = make_leaderboard(
        arguments.sets,
        arguments.out,
        title=arguments.title.strip(),
        sample_time=arguments.sample_time,
        work=_work(arguments),
    )
    show(block(leaderboard_lines(done)))
    for path, error in done.unreadable:
        complain("gsb-share", f"{path} is left out: {error}")
    return int(done.exit_code)


def _work(arguments: argparse.Namespace) -> Work:
    from gpusimbench.evaluator.compute.cache.store import Store, default_folder
    from gpusimbench.evaluator.compute.work import Work

    folder = None if arguments.no_cache else arguments.cache or default_folder()
    if arguments.cache and arguments.cache.exists() and not arguments.cache.is_dir():
        raise UsageError(f"--cache must be a folder, and {arguments.cache} is not one")
    return Work(store=Store(folder) if folder else None)
