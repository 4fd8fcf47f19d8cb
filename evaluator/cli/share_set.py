"""The verbs of gsb-share that are about sets of recordings: card and verify."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.cli.arguments import check_target, local_name, local_path, write_json
from gpusimbench.evaluator.cli.entry import complain
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import block, show

_CARD = (
    "Describe a folder of recordings for those who find it: README.md (a card for the Hugging Face Hub), tables of all "
    "metrics, CITATION.cff, manifest.json and SHA256SUMS, written into the folder. Needs the package polars."
)
_VERIFY = (
    "Check a set that was described by 'gsb-share card', in a folder or at an address: every file, every content hash, "
    "every rule of integrity-1, and every value of its tables. Needs the package polars."
)
_MOST_ABOUT = 1 << 20


def add_verbs(verbs: Any) -> None:
    """Add the arguments of both verbs."""
    v = verbs.add_parser("card", help="describe a folder of recordings", description=_CARD)
    v.add_argument("folder", type=local_path, metavar="DIR", help="the folder, with those below it")
    v.add_argument("--title", metavar="TEXT", help="of the set")
    v.add_argument("--licence", metavar="SPDX", help="such as CC-BY-4.0; LicenseRef-NAME: terms in the file LICENSE")
    v.add_argument(
        "--author", action="append", default=[], metavar="TEXT", help="Family, Given[; affiliation[; ORCID]]"
    )
    v.add_argument("--doi", metavar="DOI", help="of the set")
    v.add_argument("--url", metavar="URL", help="of its page")
    v.add_argument("--about", type=local_path, metavar="FILE", help="Markdown of yours, put below the title")
    v.add_argument("--sample-time", type=float, default=5.0, metavar="S", help="simulated time (default: 5.0)")
    v.add_argument("--update", action="store_true", help="write anew what was written before")
    v = verbs.add_parser("verify", help="check a set that somebody described", description=_VERIFY)
    v.add_argument("set", type=place, metavar="DIR|URL", help="its folder, or the address of it")
    v.add_argument("--limit", type=float, default=20.0, metavar="GB", help="that may be fetched (default: 20)")
    v.add_argument(
        "--tolerance",
        type=float,
        default=0.0,
        metavar="R",
        help="relative, of values in tables (default: 0, every bit)",
    )
    v.add_argument("--json", type=local_name, metavar="FILE", help="write the findings as JSON; - for standard output")


def card(arguments: argparse.Namespace) -> int:
    """Describe a folder; returns the exit code."""
    from gpusimbench.evaluator.share.dataset.citation import Publication, check_doi, check_url, parse_author
    from gpusimbench.evaluator.share.dataset.contents import BROKEN, DAMAGED
    from gpusimbench.evaluator.share.dataset.licences import check_licence
    from gpusimbench.evaluator.share.dataset.publish import publish
    from gpusimbench.evaluator.share.dataset.text import published_lines, warnings_of

    check_time(arguments.sample_time)
    licence = check_licence(arguments.licence)
    if not arguments.author:
        raise UsageError("who is to be cited? give --author 'Family, Given', once for each, or --author 'Organisation'")
    if not arguments.title or not arguments.title.isprintable():
        raise UsageError("a set needs a name that people can find it by: give --title, on one line")
    publication = Publication(
        title=arguments.title.strip(),
        licence=licence,
        authors=tuple(map(parse_author, arguments.author)),
        doi=check_doi(arguments.doi),
        url=check_url(arguments.url),
        about=_about(arguments.about),
    )
    done = publish(arguments.folder, publication, sample_time=arguments.sample_time, update=arguments.update)
    show(block(published_lines(done)))
    for line in warnings_of(done):
        complain("gsb-share", line)
    outcomes = {one.checkup.outcome for one in done.looked_at}
    if DAMAGED in outcomes:
        return int(ExitCode.DATA_LOST)
    return int(ExitCode.GATE_FAILED if BROKEN in outcomes else ExitCode.OK)


def _about(path: Path | None) -> str:
    if path is None:
        return ""
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_ABOUT + 1)
        text = data.decode("utf-8").strip()
    except OSError as error:
        raise GsbError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path} is not a text in UTF-8") from None
    if len(data) > _MOST_ABOUT:
        raise UsageError(f"{path} is larger than a card's own words can be, {_MOST_ABOUT} bytes")
    return text


def verify(arguments: argparse.Namespace) -> int:
    """Verify a set; returns the exit code."""
    from gpusimbench.evaluator.share.dataset.text import dump_verification, verification_lines
    from gpusimbench.evaluator.share.dataset.verify import verify_set

    check_target(arguments.json)
    if not 0 <= arguments.tolerance < 1:
        raise UsageError(f"--tolerance is from 0 to 1, not {arguments.tolerance}")
    if not 0 < arguments.limit < float("inf"):
        raise UsageError(f"--limit is a number of gigabytes above 0, not {arguments.limit}")
    done = verify_set(
        arguments.set,
        limit_bytes=arguments.limit * 1e9,
        tolerance=arguments.tolerance,
        say=lambda line: complain("gsb-share", line),
    )
    if arguments.json:
        write_json(arguments.json, dump_verification(done))
    if arguments.json != "-":
        show(block(verification_lines(done)))
    return int(done.exit_code)


def check_time(seconds: float) -> None:
    """UsageError where no positions can be compared at a time."""
    if not 0 < seconds < float("inf"):
        raise UsageError(f"--sample-time is a time in seconds above 0, not {seconds}")
