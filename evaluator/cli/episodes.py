"""gsb-episodes: success and return of a policy, over the same number of episodes of every environment."""

from __future__ import annotations

import argparse
import sys

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, new_parser
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.location import place

_EPILOG = """\
An evaluation that stops at the first n finished episodes counts short episodes too often, and more so with more
environments. gsb-episodes takes the first K episodes of every environment, however long they are, and shows
what the first finished episodes would have given. Recordings are those of gpusimbench.wrap.

Choose K before you record, and record K times the time limit of an episode (K steps more if the autoreset mode is
NextStep): then every environment has K episodes.

Several recordings count together. Choose seeds that are at least the number of environments apart: environments that
begin with the same seed and start are averaged, and count once.

exit codes:
  0  the episodes were evaluated, whichever policy is better
  1  the results cannot be written
  2  wrong usage
  3  a recording is damaged
  5  nothing was evaluated: an environment has fewer than K episodes, there are none, or no flag was recorded

see also:
  gsb-info, which counts episodes
  gsb-diff, which shows where two recordings part
  docs/how-to/evaluate-a-policy.md
  docs/how-to/record-your-task.md

examples:
  gsb-episodes policy.mcap --success success --per-env 4
  gsb-episodes policy.mcap --success success --per-env 1 --against baseline.mcap
  gsb-episodes policy-*.mcap --success success --per-env 4 --across n_env
  gsb-episodes seed0.mcap seed64.mcap --json - | jq .policy.quantities
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-episodes",
        "Evaluate a policy from recorded episodes: success and return with intervals, from the same number of episodes "
        "of every environment, alone or against another policy.",
        _EPILOG,
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE", help="recordings (.mcap) of one policy, folders, or addresses"
    )
    p.add_argument(
        "--against", nargs="+", type=place, default=[], metavar="FILE",
        help="recordings of another policy; episodes of the same environment and episode number are paired if they "
        "began alike",
    )  # fmt: skip
    p.add_argument(
        "--across", choices=("n_env", "device", "version"), metavar="KEY",
        help="group the recordings by n_env (the number of environments), device or version of the simulator, and test "
        "whether success and return depend on it",
    )  # fmt: skip
    p.add_argument(
        "--per-env", type=int, metavar="K",
        help="episodes of each environment, its first ones (default: the most that every environment has)",
    )  # fmt: skip
    p.add_argument(
        "--success", metavar="NAME",
        help='info that says whether an episode succeeded, such as success, recorded by wrap(..., infos=("success",)); '
        "or terminated, or truncated",
    )  # fmt: skip
    p.add_argument(
        "--success-at", choices=("last", "any"), default="last",
        help="step of an episode at which the info of --success counts (default: %(default)s)",
    )  # fmt: skip
    add_json(p, "result")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Evaluate and print; returns the exit code."""
    from gpusimbench.evaluator.episodes.comparison import compare
    from gpusimbench.evaluator.episodes.document import dump_json, episodes_document
    from gpusimbench.evaluator.episodes.outcome import outcomes, profiles
    from gpusimbench.evaluator.episodes.side import check_distinct
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.read.episodes import At
    from gpusimbench.evaluator.runs.validation import verified

    check_target(arguments.json)
    if arguments.per_env is not None and arguments.per_env < 1:
        raise UsageError(f"--per-env is at least 1, not {arguments.per_env}")
    if arguments.across:
        if arguments.against:
            raise UsageError("--across groups the recordings of one policy: leave --against out")
        return _across(arguments)
    given = [verified(list(expand(files))) for files in (arguments.files, arguments.against) if files]
    check_distinct([recording for side in given for recording in side])
    with stage("evaluating episodes"):
        episodes, (policy, *against) = outcomes(given, arguments.per_env, arguments.success, At(arguments.success_at))
        other = against[0] if against else None
        compared = compare(*episodes) if other else None
    answer(
        arguments.json,
        lambda: dump_json(policy, other, compared, profiles(episodes)),
        lambda: episodes_document(policy, other, compared),
    )
    return int(ExitCode.OK)


def _across(arguments: argparse.Namespace) -> int:
    from gpusimbench.evaluator.episodes.dependence import across, grouped
    from gpusimbench.evaluator.episodes.document import across_document, dump_across
    from gpusimbench.evaluator.episodes.side import check_distinct
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.read.episodes import At
    from gpusimbench.evaluator.runs.validation import verified

    recordings = verified(list(expand(arguments.files)))
    check_distinct(recordings)
    groups = grouped(recordings, arguments.across)
    with stage("evaluating episodes"):
        found = across(arguments.across, groups, arguments.per_env, arguments.success, At(arguments.success_at))
    answer(arguments.json, lambda: dump_across(found), lambda: across_document(found))
    return int(ExitCode.OK)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
