"""gsb-replay: do the recorded actions still lead to the recorded episodes?"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, local_path, new_parser, say
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import ExitCode, NotARecording, UsageError
from gpusimbench.schemas.location import Place, place

if TYPE_CHECKING:
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.replays.comparison import ReplayComparison

_REQUIRED = ("bit-identical", "same-outcome")
_READ = (
    "recording (.mcap) of gpusimbench.wrap, file of D4RL, robosuite or robomimic (.hdf5) or of ManiSkill (.h5), or "
    "folder of a Minari or LeRobot data set"
)

_EPILOG = """\
The environment is made again and reset with the recorded seeds, and the recorded actions are applied to it without
feedback (open loop). The replay is recorded, and compared with the original episode by episode. gsb-replay takes
recordings of gpusimbench.wrap; gsb-audit replays recordings of gsb-record. A data set is first converted to a
recording, NAME.mcap in the current folder.

The command runs only code that you have installed or name: from a file it takes an id of Gymnasium's registry and
keywords that are no paths, and --make imports your own module.

verdicts, strongest first:
  bit-identical   every observation and reward has the same bits, and the episode ends at the same step; observations
                  of ManiSkill's and robosuite's data sets are the states of the physics
  same outcome    bits differ; length, end, success and, within --tolerance, the return are the same
  outcome not known  bits differ, the length is the same, and the data set has neither rewards nor the info of --success
  other outcome   length, end, success or return differs
  not replayed    the replay has no such episode

exit codes:
  0  every episode has the verdict of --require, or a stronger one
  1  the environment failed while it was stepped, or the results cannot be written
  2  wrong usage, or the environment cannot be made
  3  a recording is damaged
  4  an episode has a weaker verdict
  5  there are no episodes to replay

files:
  NAME-replay.mcap  the replay, a recording like any other
  NAME.mcap  the recording that a data set becomes

see also:
  gsb-audit, which replays recordings of gsb-record
  gsb-diff, which compares two recordings step by step
  docs/how-to/will-my-dataset-replay.md
  docs/how-to/record-your-task.md

examples:
  gsb-replay demos.mcap
  gsb-replay demos.mcap --set frame_skip=4 --require same-outcome
  gsb-replay hopper_medium-v2.hdf5 --env Hopper-v5 --episodes 100
  gsb-replay PickCube-v1/motionplanning/trajectory.h5 --success-at any
  gsb-replay lift/demo.hdf5
  gsb-replay lerobot/pusht --env gym_pusht/PushT-v0 --success is_success
  gsb-replay demos.mcap --make my_task:make --success success
  gsb-replay demos.mcap --against replay-of-another-machine.mcap --json -
"""


def parser() -> Parser:
    """The command's arguments."""
    p = new_parser(
        "gsb-replay",
        "Make the environment of a recording or data set again, apply the recorded actions, and say for every episode "
        "whether the replay has the same bits, the same outcome or another outcome, and where they first differ.",
        _EPILOG,
    )
    p.add_argument(
        "file", type=place, metavar="FILE",
        help=_READ,
    )  # fmt: skip
    how = p.add_mutually_exclusive_group()
    how.add_argument(
        "--env",
        metavar="ID",
        help="environment of Gymnasium's registry, or MODULE:ID, whose module registers it (default: the recorded one)",
    )
    how.add_argument(
        "--make", metavar="MODULE:FUNCTION", help="function that takes a number of environments and returns a VectorEnv"
    )
    how.add_argument(
        "--against", type=place, metavar="FILE", help="compare with this recording of a replay, and replay nothing"
    )
    p.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="keywords",
        help="keyword of the environment, instead of the recorded one; repeatable",
    )  # fmt: skip
    p.add_argument(
        "--out", type=local_path, metavar="FILE", help="recording of the replay (default: NAME-replay.mcap, here)"
    )
    p.add_argument("--episodes", type=int, metavar="N", help="only the first N episodes of a data set (default: all)")
    p.add_argument("--success", metavar="NAME", help="info that says whether an episode succeeded (default: success)")
    p.add_argument(
        "--success-at", choices=("last", "any"), default="last",
        help="step of an episode at which the info of --success counts (default: %(default)s)",
    )  # fmt: skip
    p.add_argument(
        "--tolerance", type=float, default=0.01, metavar="SHARE",
        help="distance up to which returns are the same, as a share of the sum of absolute rewards "
        "(default: %(default)s)",
    )  # fmt: skip
    p.add_argument(
        "--require", choices=_REQUIRED, default=_REQUIRED[0],
        help="weakest verdict that ends with exit code 0 (default: %(default)s)",
    )  # fmt: skip
    p.add_argument("--all", action="store_true", help="list every episode")
    add_json(p, "result")
    p.show_first(
        "--env", "--make", "--against", "--set", "--out", "--episodes", "--success", "--require", "--all", "--json"
    )
    return p


def run(arguments: argparse.Namespace) -> int:
    """Replay, compare and print; returns the exit code."""
    from gpusimbench.evaluator.read.episodes import At
    from gpusimbench.evaluator.replays.comparison import compare, successes_of
    from gpusimbench.evaluator.replays.document import dump_json, replay_document
    from gpusimbench.evaluator.runs.validation import verified
    from gpusimbench.recorder.demonstrations.formats import data_set_at
    from gpusimbench.replay.dataset import converted
    from gpusimbench.replay.origin import given
    from gpusimbench.replay.parts import infos_of
    from gpusimbench.replay.replaying import replayed

    check_target(arguments.json)
    _check_out(arguments.out)
    source = data_set_at(arguments.file) if isinstance(arguments.file, Path) else None
    if not 0 <= arguments.tolerance < float("inf"):
        raise UsageError(f"--tolerance is a share of at least 0, not {arguments.tolerance}")
    if arguments.against and (arguments.keywords or arguments.out):
        raise UsageError("--against replays nothing: --set and --out have no use")
    if arguments.episodes is not None and source is None:
        raise UsageError("--episodes is of data sets; of a recording, all episodes are replayed")
    if arguments.make and arguments.keywords:
        raise UsageError("--set is of environments of Gymnasium's registry: put it into the function of --make")
    changed = given(arguments.keywords)
    if source is None:
        (original,) = _original(arguments.file)
    else:
        _check_data_set(arguments)
        (original,) = verified([converted(source, arguments.env, changed, arguments.episodes)])
    success = arguments.success or ("success" if "success" in infos_of(original) else None)
    if success:
        successes_of(original, success, At(arguments.success_at))  # what it lacks is said before anything is replayed
    made = arguments.against
    if made is None:
        path = _target(original, arguments.out)
        replayed(original, path, env=arguments.env, changed=changed, make=arguments.make, success=success, say=say)
        made = place(str(path))
    (replay,) = verified([made])
    with stage("comparing episodes"):
        found = compare(original, replay, success=success, at=At(arguments.success_at), tolerance=arguments.tolerance)
    answer(arguments.json, lambda: dump_json(found), lambda: replay_document(found, every=arguments.all))
    return int(_exit_code(found, arguments.require))


def _check_data_set(arguments: argparse.Namespace) -> None:
    if arguments.against or arguments.make:
        raise UsageError("a data set is replayed in an environment of Gymnasium's registry: give --env")
    if arguments.episodes is not None and arguments.episodes < 1:
        raise UsageError(f"--episodes is at least 1, not {arguments.episodes}")


def _original(file: Place) -> list[Recording]:
    from gpusimbench.evaluator.runs.validation import verified

    try:
        return verified([file])
    except NotARecording as error:
        if not (isinstance(file, Path) and file.is_file()):
            raise
        raise NotARecording(f"{error}; gsb-replay takes a {_READ}") from None


def _target(original: Recording, named: Path | None) -> Path:
    """Where the replay is recorded; UsageError where a file is there."""
    path = named or Path(f"{Path(str(original.path)).name.removesuffix('.mcap')}-replay.mcap")
    _check_out(path)
    return path


def _check_out(path: Path | None) -> None:
    if path is not None and path.exists():
        raise UsageError(f"{path} exists: name another file with --out")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"--out takes the file to write; {path} is in no folder that exists ({path.parent})")


def _exit_code(found: ReplayComparison, required: str) -> ExitCode:
    from gpusimbench.evaluator.replays.verdict import EpisodeVerdict

    allowed = [EpisodeVerdict.IDENTICAL, *([EpisodeVerdict.SAME] if required == _REQUIRED[1] else [])]
    met = all(one.verdict in allowed for one in found.episodes)
    return ExitCode.OK if met else ExitCode.GATE_FAILED


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
