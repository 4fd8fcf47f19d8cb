"""gsb-probe: whether results depend on what should not matter, such as the number of environments or a reset."""

from __future__ import annotations

import argparse
import hashlib
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusimbench.evaluator.cli.command import (
    answer,
    check_target,
    complain,
    entry_point,
    local_name,
    local_path,
    new_parser,
)
from gpusimbench.schemas.commands.folder_lock import folder_lock
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import DataLost, ExitCode, NothingComparable, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.treatment import QUANTITIES, VARIED_SPREAD, Vary

if TYPE_CHECKING:
    from gpusimbench.evaluator.probe.runs import Plan
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.results.determinism_cost import Family
    from gpusimbench.schemas.location import Place

_OUT = Path("probe")
_SPREAD = 0.1
_SCENE = "inclined-collision"
_STEPS, _QUICK_STEPS = 300, 150
_NUMBERS = {"cpu": (1, 2, 64), "cuda": (1, 2, 64, 256, 1024, 4096)}
_QUICK_NUMBERS = (1, 2, 64)

_EPILOG = """\
Each question is about something that should not matter: whether the same run comes out again, how many environments
there are, in which slot an environment stands, what its neighbours do, whether others were reset, whether a state was
saved and restored on the way, whether all is mirrored or turned, whether identical bodies change places. gsb-probe
records about 20 short runs, each of which differs from a reference run in one of these alone, and compares them bit by
bit. If two differ, both are recorded again, to tell whether runs of the same configuration differ, too. "no" names the
first step, environment, body and number that differs, and how far apart bodies get. "open" means that runs of the
same configuration differ, too, so that nothing can be said of the cause.

The recordings lie in --out; a probe that was interrupted goes on where it stopped. With files or folders instead of
--sim nothing is recorded: the answers are those of the recordings.

exit codes:
  0  answered; with --gate, every answer is yes, those about the device, mirrored, turned and set states and
     identical bodies aside
  1  a run could not be recorded
  2  wrong usage
  3  a recording is damaged
  4  with --gate: an answer is no
  5  with --gate: an answer is open; without: nothing could be asked

files:
  OUT/NAME.mcap  a run, a recording like any other

see also:
  gsb-record, which makes its runs
  gsb-diff, which shows where two part
  docs/probe.md

examples:
  gsb-probe --sim mujoco --quick
  gsb-probe --sim mjx,warp --determinism default,run-to-run --out invariance
  gsb-probe --sim mujoco --model robot.xml --quick
  gsb-probe invariance --all
"""


def parser() -> Parser:
    """The command's arguments."""
    p = new_parser(
        "gsb-probe",
        "Ask a simulator whether its results depend on what should not matter: record short runs that differ in one "
        "thing alone, and compare them bit by bit.",
        _EPILOG,
        reads=(
            "CUDA_VISIBLE_DEVICES",
            "GSB_ENVIRONMENTS",
            "GSB_MADRONA_MODULE",
        ),
    )
    p.add_argument("files", nargs="*", type=place, metavar="FILE", help="recordings of a probe, or folders of them")
    p.add_argument("--sim", metavar="NAME[,NAME]", help="simulators to probe; see gsb-record --list")
    p.add_argument("--scene", metavar="NAME", help=f"(default: {_SCENE})")
    p.add_argument(
        "--model", type=local_path, metavar="FILE.xml",
        help="instead of --scene: a model file of your own, as of gsb-record; its actuators are given random controls",
    )  # fmt: skip
    p.add_argument(
        "--determinism", default="default", metavar="LEVEL[,LEVEL]",
        help="levels to probe, or all that have an effect on this machine's device (default: %(default)s)",
    )  # fmt: skip
    p.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="of the simulator; repeatable")
    p.add_argument("--n-env", type=int, default=16, metavar="N", help="environments (default: %(default)s)")
    p.add_argument(
        "--numbers", metavar="N,N", help="other numbers of environments (default: 1,2,64; on a GPU up to 4096)"
    )
    p.add_argument("--steps", type=int, metavar="N", help=f"of each run (default: {_STEPS}; --quick: {_QUICK_STEPS})")
    p.add_argument(
        "--stride", type=int, default=1, metavar="K",
        help="record every K-th state; differences are found at every step all the same (default: %(default)s)",
    )  # fmt: skip
    p.add_argument(
        "--spread", type=float, default=_SPREAD, metavar="S",
        help="of initial states that differ [m/s or rad] (default: %(default)s)",
    )  # fmt: skip
    p.add_argument(
        "--vary", default="", metavar="NAME:SPREAD[,NAME:SPREAD]",
        help="parameters that differ from environment to environment, such as mass:0.1,friction:0.2; see gsb-record "
        "--help-all. An environment keeps its own when it changes slot (default: none)",
    )  # fmt: skip
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of what is drawn (default: %(default)s)")
    p.add_argument("--quick", action="store_true", help="fewer steps and numbers of environments")
    p.add_argument("--out", type=Path, default=_OUT, metavar="DIR", help="of the recordings (default: %(default)s/)")
    p.add_argument("--all", action="store_true", help="say also what was compared, by which files")
    p.add_argument("--gate", action="store_true", help="end with 4 where an answer is no, and with 5 where one is open")
    p.add_argument("--json", type=local_name, metavar="FILE", help="write the answers as JSON; - for standard output")
    p.show_first(
        "--sim", "--scene", "--model", "--determinism", "--option", "--n-env", "--numbers", "--quick", "--out", "--all",
        "--gate", "--json",
    )  # fmt: skip
    return p


def run(arguments: argparse.Namespace) -> int:
    """Record what is missing, compare and print; returns the exit code."""
    from gpusimbench.evaluator.probe.finding import Answer
    from gpusimbench.evaluator.probe.questions import QUESTIONS, probed, why_nothing_asked
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.report.json import dump_probe
    from gpusimbench.evaluator.report.sections.probed import probe_document

    _check(arguments)
    files, problems = _recorded(arguments) if arguments.sim else (list(expand(arguments.files)), [])
    recordings = _verified(files)
    asked, prices = probed(recordings), _prices(recordings)
    findings = [finding for one in asked for finding in one.findings]
    if all(finding.answer is Answer.NOT_ASKED for finding in findings):
        raise NothingComparable("; ".join(problems) or why_nothing_asked(recordings))
    answer(
        arguments.json,
        lambda: dump_probe(asked, prices),
        lambda: probe_document(asked, prices, every=arguments.all),
    )
    if problems:
        return int(ExitCode.FAILURE)
    gated = {question.key for question in QUESTIONS if question.gate} if arguments.gate else set()
    found = {finding.answer for finding in findings if finding.key in gated}
    if Answer.NO in found:
        return int(ExitCode.GATE_FAILED)
    return int(ExitCode.NOTHING_COMPARABLE if Answer.OPEN in found else ExitCode.OK)


def _check(arguments: argparse.Namespace) -> None:
    if bool(arguments.sim) == bool(arguments.files):
        raise UsageError("name simulators to probe with --sim, or recordings of a probe, not both and not neither")
    if arguments.scene is not None and arguments.model is not None:
        raise UsageError("--model and --scene both say what is simulated; give one of them")
    for name in ("n_env", "steps"):
        value = getattr(arguments, name)
        if value is not None and value < (1 if name == "n_env" else 30):
            raise UsageError(f"--{name.replace('_', '-')} is at least {1 if name == 'n_env' else 30}, not {value}")
    arguments.vary = arguments.vary and _vary(arguments.vary)
    check_target(arguments.json)


def _vary(text: str) -> str:
    # in the order in which recordings have it; gsb-record says of each simulator what it can vary
    try:
        found = Vary.parse(text)
        if found != found.usual:
            raise ValueError(text)
    except ValueError:
        quantities = ", ".join(f"{name}:SPREAD" for name in QUANTITIES)
        raise UsageError(
            f"--vary takes {quantities}, separated by commas, each at most once, with spreads up to "
            f"{VARIED_SPREAD:g}, not '{text}'"
        ) from None
    return str(found)


def _verified(files: list[Place]) -> list[Recording]:
    from gpusimbench.evaluator.runs.validation import verified

    found = verified(files)
    if lost := [recording for recording in found if recording.status == "incomplete"]:
        raise DataLost(f"{lost[0].path} is incomplete: {lost[0].reason}")
    return found


def _prices(recordings: list[Recording]) -> tuple[Family, ...]:
    """What levels of determinism cost, of those that were clocked alone."""
    from gpusimbench.evaluator.results.determinism_cost import price_list
    from gpusimbench.evaluator.results.evaluate import evaluate_files

    clocked = [r.path for r in recordings if r.configuration.phases == ("timed",)]
    return price_list(evaluate_files(clocked).results) if clocked else ()


def _recorded(arguments: argparse.Namespace) -> tuple[list[Place], list[str]]:
    """The recordings of all plans, those that were missing made; and what could not be recorded."""
    from gpusimbench.evaluator.probe.runs import ProbeFolder

    plans = _plans(arguments)
    folder = ProbeFolder(arguments.out, partial(complain, "gsb-probe"))
    with folder_lock(arguments.out, "gsb-probe", "records a probe"):
        files = folder.record(plans)
    return files, folder.problems


def _plans(arguments: argparse.Namespace) -> list[Plan]:
    from gpusimbench.evaluator.compute.recorder import about, as_path
    from gpusimbench.evaluator.probe.runs import Model, Plan
    from gpusimbench.schemas.model_files import pack

    plans = []
    model = None
    if arguments.model is not None:
        model = Model(as_path(arguments.model), hashlib.sha256(pack(arguments.model)).hexdigest())
    for name in filter(None, (part.strip() for part in arguments.sim.split(","))):
        engine = about(name)
        chosen = dict(option.partition("=")[::2] for option in arguments.option)
        device = chosen.get("device") if chosen.get("device") in _NUMBERS else engine["device_here"]
        plans += [
            Plan(
                simulator=name,
                scene=arguments.scene or _SCENE,
                determinism=level,
                options=tuple(arguments.option),
                seed=arguments.seed,
                steps=arguments.steps or (_QUICK_STEPS if arguments.quick else _STEPS),
                n_env=arguments.n_env,
                numbers=_numbers(arguments, device or "cpu"),
                spread=arguments.spread,
                stride=arguments.stride,
                vary=arguments.vary,
                model=model,
            )
            for level in _levels(arguments.determinism, engine["levels"], name)
        ]
    return plans


def _levels(asked: str, known: list[dict[str, Any]], simulator: str) -> list[str]:
    if asked != "all":
        return [part.strip() for part in asked.split(",")]
    for level in known:
        if not level["effect_here"]:
            complain("gsb-probe", f"{simulator}: {level['level']} has no effect on this device: {level['why_none']}")
    return [level["level"] for level in known if level["effect_here"]]


def _numbers(arguments: argparse.Namespace, device: str) -> tuple[int, ...]:
    if arguments.numbers is None:
        return _QUICK_NUMBERS if arguments.quick else _NUMBERS[device]
    try:
        found = tuple(int(part) for part in arguments.numbers.split(","))
    except ValueError:
        found = ()
    if not found or min(found) < 1:
        raise UsageError(f"--numbers is a list of numbers of environments, such as 1,2,64, not '{arguments.numbers}'")
    return found


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
