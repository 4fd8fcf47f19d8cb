"""gsb-share: recordings made smaller, whole again, ready for a viewer, and sets of them described and checked."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusimbench.evaluator.cli.command import (
    add_cache,
    add_json,
    check_sample_time,
    check_target,
    complain,
    entry_point,
    local_path,
    new_parser,
    store_of,
    write_json,
)
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.commands.progress import each, sizes, stage
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import block, line, plural, show

if TYPE_CHECKING:
    from gpusimbench.evaluator.share.copies import Copied, Recovered

_EPILOG = """\
exit codes:
  0  every file was written; verify: the set is what its manifest says
  1  a file could not be written
  2  wrong usage
  3  a file is damaged or no recording, or cut short (which recover is for, and ends with 0); what could be written was;
     verify: a file is missing, changed or damaged
  4  verify: the parts of the set do not agree; card, verify: a recording breaks a rule
  5  card, verify: there is no recording; leaderboard: nothing has a place

see also:
  gsb-check, for what recover made
  docs/share.md
  docs/dataset.md
  docs/strangers.md

examples:
  gsb-share pack recordings/*.mcap --out packed
  gsb-share unpack packed/*.mcap --out unpacked
  gsb-share recover runs/mujoco-r3.mcap.partial
  gsb-share viewer recordings/mujoco-amd-r0.mcap --env 0 --env 3 --spread 1 --out view.mcap
  gsb-share card dataset --title 'Cube stacks' --licence CC-BY-4.0 --author 'Doe, Jane; Some University'
  gsb-share verify hf://datasets/someone/cube-stacks
  gsb-share leaderboard recordings recordings/h200 --out board
"""

_CARD = (
    "Describe a folder of recordings for those who find it: README.md (a card for the Hugging Face Hub), tables of all "
    "metrics, CITATION.cff, manifest.json and SHA256SUMS, written into the folder. Needs the package polars."
)
_VERIFY = (
    "Check a set that was described by 'gsb-share card', in a folder or at an address: every file, every content hash, "
    "every rule of integrity-1, and every value of its tables. Needs the package polars."
)
_MOST_ABOUT = 1 << 20
_LEADERBOARD = (
    "Write a page that ranks simulators within each scene and device, from recordings alone: there is no way to type a "
    "number in."
)


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-share",
        "Make recordings smaller without changing what they hold, make whole files of what a crash left, and files for "
        "Foxglove and other viewers; describe, check and rank sets of recordings. No recording is changed "
        "or overwritten.",
        _EPILOG,
        reads=("GSB_CACHE",),
    )
    verbs = p.add_subparsers(dest="verb", required=True, metavar="VERB")
    for verb, what in (("pack", "copies with packed states"), ("unpack", "copies with states and actions as they are")):
        v = verbs.add_parser(verb, help=what, description=f"Write {what}; every copy is checked against its source.")
        v.add_argument("files", nargs="+", type=local_path, metavar="FILE", help="recordings, or folders of them")
        v.add_argument(
            "--out",
            type=local_path,
            default=Path(f"{verb}ed"),
            metavar="DIR",
            help=f"folder of the copies (default: {verb}ed)",
        )
        if verb == "pack":
            v.add_argument("--level", type=int, default=1, metavar="N", help="level of Zstandard, 1 to 22 (default: 1)")
    v = verbs.add_parser("recover", help="a whole file of one that was cut short", description=_RECOVER)
    v.add_argument("file", type=local_path, metavar="FILE", help="what a crash left, NAME.mcap.partial or another")
    v.add_argument(
        "--out", type=local_path, metavar="FILE", help="the file to write (default: NAME.recovered.mcap, beside it)"
    )
    v = verbs.add_parser("viewer", help="a file for viewers", description=_VIEWER)
    v.add_argument("file", type=local_path, metavar="FILE", help="a recording")
    v.add_argument("--env", type=int, action="append", metavar="E", help="environment to show; repeatable (default: 0)")
    v.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="most poses a simulated second (default: 30)")
    v.add_argument(
        "--spread",
        type=float,
        default=0.0,
        metavar="M",
        help="move environments at one place this far apart [m] (default: 0)",
    )
    v.add_argument("--out", type=local_path, required=True, metavar="FILE", help="the file to write")
    v.add_argument(
        "--layout", type=local_path, metavar="FILE", help="write the attached Foxglove layout to a file, too"
    )
    _add_sets(verbs)
    _add_leaderboard(verbs)
    return p


_RECOVER = (
    "Write everything up to the last whole record as a finished MCAP file. A recording without its end record stays "
    "incomplete."
)

_VIEWER = (
    "Write some environments as messages that Foxglove and rerun draw: shapes once, poses over simulated time, events. "
    "Recordings have them of environment 0 already, unless they are older or were made with --no-view."
)


def run(arguments: argparse.Namespace) -> int:
    """Do what the verb says; returns the exit code."""
    verbs: dict[str, Callable[[argparse.Namespace], int]] = {
        "pack": _pack,
        "unpack": _pack,
        "recover": _recover,
        "viewer": _viewer,
        "card": _card,
        "verify": _verify,
        "leaderboard": _leaderboard,
    }
    return verbs[arguments.verb](arguments)


def _pack(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.read.addresses import expand_paths
    from gpusimbench.evaluator.share.copies import pack, unpack
    from gpusimbench.schemas.packing import LEVELS

    packing = arguments.verb == "pack"
    if packing and arguments.level not in LEVELS:
        raise UsageError(f"--level is a whole number from {LEVELS[0]} to {LEVELS[-1]}, not {arguments.level}")
    code = ExitCode.OK
    files = expand_paths(arguments.files)
    for file in each(files, f"{arguments.verb}ing recordings", sizes(files)):
        path = arguments.out / file.name
        try:
            copied = pack(file, path, level=arguments.level) if packing else unpack(file, path)
        except GsbError as error:
            complain("gsb-share", error.advised)
            code = max(code, error.exit_code)
        else:
            show(line(_line(copied)))
    return int(code)


def _line(copied: Copied) -> str:
    before, after = copied.bytes_before, copied.bytes_after
    return (
        f"{copied.path}  {before / 1e6:.2f} MB to {after / 1e6:.2f} MB, {after / before:.3f} of it; "
        f"content hash {copied.content_hash[:12]} kept"
    )


def _recover(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.share.copies import recover

    source: Path = arguments.file
    name = source.name.removesuffix(PARTIAL).removesuffix(".mcap")
    with stage("recovering"):
        done = recover(source, arguments.out or source.with_name(f"{name}.recovered.mcap"))
    show(block(_recovered_lines(done)))
    return int(ExitCode.DATA_LOST if done.damage else ExitCode.OK)


def _recovered_lines(done: Recovered) -> Iterator[str]:
    yield f"{done.path}  {done.status}{': ' if done.reason else ''}{done.reason}"
    for stream in done.streams:
        steps = "" if stream.last_step is None else f"  whole up to step {stream.last_step}"
        yield f"  {stream.messages:>8} messages  {stream.name}{steps}"
    yield f"  {len(done.attachments):>8} attachments  {', '.join(done.attachments)}"
    if done.damage:
        yield f"  {plural(done.lost_bytes, 'byte')} behind damage are left out: {done.damage}"
    elif done.lost_bytes:
        yield f"  {done.lost_bytes} bytes at the end are left out: they are no whole record"
    else:
        yield "  nothing is left out"


def _viewer(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.player.viewer import write_view
    from gpusimbench.schemas.writing import check_free, write_new

    if arguments.layout:
        if arguments.layout.resolve() == arguments.out.resolve():
            raise UsageError("--out and --layout are two files; they have the same name")
        check_free(arguments.layout)
    envs = tuple(arguments.env or (0,))
    with stage("writing the view"):
        done = write_view(arguments.file, arguments.out, envs=envs, rate=arguments.rate, spread=arguments.spread)
    if arguments.layout:
        write_new(arguments.layout, done.layout.encode())
    for note in done.notes:
        complain("gsb-share", note)
    shown = f"{done.shapes} shapes, {done.frames} moving frames at {done.times} times in {done.seconds:g} s"
    show(line(f"{done.path}  {shown}"))
    if done.incomplete:
        complain("gsb-share", f"{arguments.file} is cut short: its view ends where its states do")
    return int(ExitCode.DATA_LOST if done.incomplete else ExitCode.OK)


def _add_sets(verbs: Any) -> None:
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
    add_json(v, "findings")


def _card(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.share.dataset.citation import (
        Publication,
        check_doi,
        check_licence,
        check_url,
        parse_author,
    )
    from gpusimbench.evaluator.share.dataset.contents import BROKEN, DAMAGED
    from gpusimbench.evaluator.share.dataset.publish import publish, published_lines, warnings_of

    check_sample_time(arguments.sample_time)
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
    for warning in warnings_of(done):
        complain("gsb-share", warning)
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


def _verify(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.share.dataset.verify import dump_verification, verification_lines, verify_set

    check_target(arguments.json)
    if not 0 <= arguments.tolerance < 1:
        raise UsageError(f"--tolerance is from 0 to 1, not {arguments.tolerance}")
    if not 0 < arguments.limit < float("inf"):
        raise UsageError(f"--limit is a number of gigabytes above 0, not {arguments.limit}")
    done = verify_set(
        arguments.set,
        limit_bytes=arguments.limit * 1e9,
        tolerance=arguments.tolerance,
        say=partial(complain, "gsb-share"),
    )
    if arguments.json:
        write_json(arguments.json, dump_verification(done))
    if arguments.json != "-":
        show(block(verification_lines(done)))
    return int(done.exit_code)


def _add_leaderboard(verbs: Any) -> None:
    v = verbs.add_parser("leaderboard", help="a page that ranks simulators", description=_LEADERBOARD)
    v.add_argument("sets", nargs="+", type=place, metavar="SET", help="recordings, folders of them, addresses")
    v.add_argument("--out", type=local_path, required=True, metavar="DIR", help="for index.html and its data")
    v.add_argument(
        "--title", default="Leaderboard of robot simulators", metavar="TEXT", help="of the page (default: %(default)s)"
    )
    v.add_argument("--sample-time", type=float, default=5.0, metavar="S", help="simulated time (default: 5.0)")
    add_cache(v)


def _leaderboard(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.compute.work import Work
    from gpusimbench.evaluator.share.leaderboard.formats import leaderboard_lines
    from gpusimbench.evaluator.share.leaderboard.make import make_leaderboard

    check_sample_time(arguments.sample_time)
    if not arguments.title.strip() or not arguments.title.isprintable():
        raise UsageError("--title is a line of text")
    done = make_leaderboard(
        arguments.sets,
        arguments.out,
        title=arguments.title.strip(),
        sample_time=arguments.sample_time,
        work=Work(store=store_of(arguments)),
    )
    show(block(leaderboard_lines(done)))
    for path, error in done.unreadable:
        complain("gsb-share", f"{path} is left out: {error}")
    return int(done.exit_code)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
