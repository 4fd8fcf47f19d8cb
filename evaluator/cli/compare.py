"""gsb-compare: did head change speed, memory, physics or determinism? Two sets of recordings, for CI."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import (
    add_cache,
    add_json,
    add_sample_time,
    answer,
    check_sample_time,
    check_target,
    complain,
    entry_point,
    local_path,
    new_parser,
    store_of,
)
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.writing import write_file

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from gpusimbench.evaluator.compare.compare import Result
    from gpusimbench.evaluator.compare.finding import Settings
    from gpusimbench.evaluator.compare.history.history import History
    from gpusimbench.evaluator.compute.work import Work
    from gpusimbench.evaluator.inputs.reader import Reader
    from gpusimbench.evaluator.render.document import Document

_GATES = "throughput,memory,physics,validity,determinism,episodes"
_OF_TWO_SETS = {"episodes", "lengths"}

_EPILOG = f"""\
Groups of runs that were asked for the same are compared: scene, environments, step, simulator, options, machine.
Versions and packages may differ. Record base and head in turn (A B B A ...), at least six runs each: with the default
gates, three of each cannot decide throughput and memory, and the exit code is 5.

The 95 % interval of head / base decides. If all of it is worse than --threshold, the gate fails (if p, adjusted for all
comparisons, is at most --alpha). If all of it is on the other side of the threshold, the gate passes. Otherwise the
gate is undecided.

axes, and what fails their gate:
  throughput   head is slower (an improvement never fails a gate)
  memory       head takes more memory of the device, of the engine's allocator, or of the host
  physics      a check of mechanics holds in base and is broken in head; cubes end elsewhere
  validity     runs fail or are invalid in head only; the number of contacts changes
  determinism  environments or runs are bit-identical in base and not in head
  variability  environments or runs of head end further apart (no gate by default)
  bits         the states of head differ from those of base in any bit (no gate by default)
  build        building or compiling takes longer (no gate by default)
  episodes     of a task (gpusimbench.wrap): success or return is lower
  lengths      episodes of a task are shorter or longer (no gate by default)

exit codes:
  0  every gate passed
  1  the results cannot be written
  2  wrong usage
  3  a file is damaged, cut short or not a recording, or a recording lost data; no gate failed in the rest
  4  a gate failed, even if other files are damaged
  5  no gate failed and one is undecided: too few runs, an interval that contains the threshold, a quantity that only
     one side has; or nothing could be compared. What neither side has (GPU memory on a CPU) is left out
  --history exits with 4 only with --gate, for a change at the newest version

see also:
  gsb-eval, for one set
  gsb-diff, for two files
  docs/compare.md
  docs/history.md
  docs/how-to/ci.md

examples:
  gsb-compare base/ head/
  gsb-compare base/ head/ --all
  gsb-compare base/ head/ --gate {_GATES},bits --json result.json
  gsb-compare --base main-*.mcap --head branch-*.mcap --markdown summary.md --junit report.xml
  gsb-compare first/ again/ --expect-same
  gsb-compare elliptic/ pyramidal/ --across cone
  gsb-compare --history versions/ --html history.html
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-compare",
        "Compare two sets of recordings, base and head: is head slower, does it take more memory, is its physics "
        "different, does it fail, did it lose determinism? Tests keep false alarms rare (--alpha).",
        _EPILOG,
        reads=("GSB_CACHE", "OMP_NUM_THREADS"),
    )
    p.add_argument("sets", nargs="*", type=place, metavar="SET", help="base and head: folders of recordings, or files")
    p.add_argument(
        "--base", nargs="+", type=place, default=[], metavar="FILE", help="recordings of base, instead of the first SET"
    )
    p.add_argument(
        "--head",
        nargs="+",
        type=place,
        default=[],
        metavar="FILE",
        help="recordings of head, instead of the second SET",
    )
    p.add_argument(
        "--across", action="append", default=[], metavar="KEY",
        help="what may differ: an option, or simulator, scene, determinism, n_env, dt, warmup, timed_steps; repeatable",
    )  # fmt: skip
    p.add_argument(
        "--history", type=local_path, metavar="DIR",
        help="instead of SETs: a folder with one folder of recordings for each version or commit",
    )  # fmt: skip
    p.add_argument(
        "--gate", metavar="LIST",
        help=f"axes that must pass (default: {_GATES}; with --history: none)",
    )  # fmt: skip
    p.add_argument(
        "--alpha",
        type=float,
        default=0.05,
        help="largest chance of any false alarm in an invocation (default: %(default)s)",
    )
    p.add_argument(
        "--threshold",
        type=_share,
        default=0.05,
        metavar="5%",
        help="smallest change of an amount that counts (default: 0.05, which is 5%%)",
    )
    p.add_argument(
        "--outcome", type=float, default=0.01, metavar="CM",
        help="smallest change of where bodies end that counts; of joint angles, in hundredths of a radian "
        "(default: %(default)s)",
    )  # fmt: skip
    p.add_argument(
        "--expect-same",
        action="store_true",
        help="base and head are the same engine: a difference on any axis fails; axes of --gate must be decided",
    )
    add_sample_time(p)
    add_json(p, "results")
    p.add_argument("--markdown", type=local_path, metavar="FILE", help="write a comment for a pull request")
    p.add_argument(
        "--junit", type=local_path, metavar="FILE", help="write a JUnit report: a case for each configuration and axis"
    )
    p.add_argument("--html", type=local_path, metavar="FILE", help="with --history: write a page with all curves")
    p.add_argument(
        "--all",
        action="store_true",
        help="print every quantity that was compared; with --history, every curve and change",
    )
    p.add_argument("--no-verify", action="store_true", help="skip the digests; CRCs of what is read are still checked")
    add_cache(p)
    p.show_first(
        "--base",
        "--head",
        "--history",
        "--across",
        "--gate",
        "--threshold",
        "--expect-same",
        "--json",
        "--html",
        "--markdown",
        "--junit",
    )
    return p


def run(arguments: argparse.Namespace) -> int:
    """Compare and print; returns the exit code."""
    settings = _settings(arguments)
    for target in (arguments.json, arguments.markdown, arguments.junit, arguments.html):
        check_target(str(target) if target else None)
    if arguments.history:
        return _run_history(arguments, settings)
    return _run_sets(arguments, settings)


def _run_sets(arguments: argparse.Namespace, settings: Settings) -> int:
    """Compare two sets; returns the exit code."""
    if arguments.html:
        raise UsageError("--html needs --history; for two sets, use --markdown or --json")
    base, head = _base_and_head(arguments)

    from gpusimbench.evaluator.compare.compare import compare, read_sides
    from gpusimbench.evaluator.compare.document import comment, dump_json, full, short
    from gpusimbench.evaluator.compare.junit import junit
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.render.markdown import render_markdown

    work, reader = _reading(arguments)
    across = arguments.across
    result = compare(*read_sides(expand(base), expand(head), reader, work, across), settings, work, across)
    files = [
        (arguments.markdown, lambda: render_markdown(comment(result, arguments.command_line))),
        (arguments.junit, lambda: junit(result)),
    ]
    shown = full if arguments.all else short
    return _present(arguments, work, result, lambda: shown(result), lambda: dump_json(result), files)


def _run_history(arguments: argparse.Namespace, settings: Settings) -> int:
    """Follow quantities over the points of a history; returns the exit code."""
    if arguments.sets or arguments.base or arguments.head:
        raise UsageError("--history cannot be combined with base and head: give one or the other")
    if arguments.expect_same or arguments.across or arguments.junit:
        raise UsageError("--expect-same, --across and --junit compare two sets and cannot be used with --history")
    if arguments.gate and (unfit := _OF_TWO_SETS & {axis.value for axis in settings.gates}):
        raise UsageError(f"--history has no curves of {' and '.join(sorted(unfit))}: compare two sets by them")

    from gpusimbench.evaluator.compare.history.document import full, short
    from gpusimbench.evaluator.compare.history.history import trace
    from gpusimbench.evaluator.compare.history.json import dump_json
    from gpusimbench.evaluator.compare.history.series import read_points
    from gpusimbench.evaluator.render.html import render_page
    from gpusimbench.evaluator.render.markdown import render_markdown

    work, reader = _reading(arguments)
    history = trace(read_points(arguments.history, reader, work), settings, work, gated=arguments.gate is not None)
    files = [
        (arguments.html, lambda: render_page(full(history, arguments.command_line))),
        (arguments.markdown, lambda: render_markdown(full(history, arguments.command_line))),
    ]
    shown = full if arguments.all else short
    return _present(arguments, work, history, lambda: shown(history), lambda: dump_json(history), files)


def _reading(arguments: argparse.Namespace) -> tuple[Work, Reader]:
    from gpusimbench.evaluator.compute.work import Work
    from gpusimbench.evaluator.inputs.reader import Reader

    return Work(store=store_of(arguments)), Reader(arguments.sample_time, verify=not arguments.no_verify)


def _present(
    arguments: argparse.Namespace, work: Work, found: Result | History, shown: Callable[[], Document],
    dumped: Callable[[], str], files: Sequence[tuple[Path | None, Callable[[], str]]],
) -> int:  # fmt: skip
    """Print and write what was found, each made when it is asked for; returns the exit code."""
    if work.store:
        work.store.prune()
    for _, failure in found.unreadable:
        complain("gsb-compare", failure.error.advised)
    answer(arguments.json, dumped, shown)
    for path, text in files:
        if path:
            write_file(path, text())
    return int(found.exit_code)


def _base_and_head(arguments: argparse.Namespace) -> tuple[list[Place], list[Place]]:
    sets: list[Place] = list(arguments.sets)
    base = arguments.base or sets[:1]
    head = arguments.head or (sets[1:2] if not arguments.base else sets[:1])
    if not base or not head or len(sets) + bool(arguments.base) + bool(arguments.head) != 2:
        raise UsageError("give base and head: two folders or files, or --base FILE... and --head FILE...")
    return base, head


def _settings(arguments: argparse.Namespace) -> Settings:
    from gpusimbench.evaluator.compare.finding import Settings
    from gpusimbench.evaluator.results.metric import Axis

    if not 0 < arguments.alpha < 1:
        raise UsageError(f"--alpha must be a probability between 0 and 1, not {arguments.alpha:g}")
    if not 0 <= arguments.outcome < float("inf"):
        raise UsageError(f"--outcome must be a distance in cm, at least 0, not {arguments.outcome:g}")
    check_sample_time(arguments.sample_time)
    axes = {axis.value: axis for axis in Axis}
    given = _GATES if arguments.gate is None else arguments.gate
    named = [name.strip() for name in given.split(",") if name.strip()]
    unknown = [name for name in named if name not in axes]
    if unknown or not named:
        hint = did_you_mean(unknown[0], axes) if unknown else ""
        raise UsageError(f"--gate takes some of {', '.join(axes)}, comma separated, not '{arguments.gate}'{hint}")
    return Settings(
        alpha=arguments.alpha,
        threshold=arguments.threshold,
        outcome_cm=arguments.outcome,
        gates=frozenset(axes[name] for name in named),
        expect_same=arguments.expect_same,
    )


def _share(text: str) -> float:
    number, percent, rest = text.partition("%")
    try:
        share = float(number) / (100.0 if percent else 1.0)
    except ValueError:
        share = -1.0
    if rest.strip() or not 0 <= share < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a share such as 5% or 0.05")
    return share


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
