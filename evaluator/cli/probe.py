"""gsb-probe: whether results depend on what should not matter, such as the number of environments or a reset."""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.arguments import check_target, local_name, local_path, verified
from gpusimbench.evaluator.cli.entry import answer, complain, entry_point, new_parser
from gpusimbench.schemas.commands.folder_lock import held
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import DataLost, ExitCode, NothingComparable, UsageError
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import line, show
from gpusimbench.schemas.treatment import QUANTITIES, VARIED_SPREAD, Vary

if TYPE_CHECKING:
    from gpusimbench.evaluator.probe.plan import Arm, Plan
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.results.determinism_cost import Family
    from gpusimbench.schemas.configuration import RunConfiguration
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
saved and restored on the way. gsb-probe records about 15 short runs, each of which differs from a reference run in
one of these alone, and compares them bit by bit. If two differ, both are recorded again, to tell whether runs of the
same configuration differ, too. "no" names the first step, environment, body and number that differs, and how far
apart bodies get. "open" means that runs of the same configuration differ, too, so that nothing can be said of the
cause.

The recordings lie in --out; a probe that was interrupted goes on where it stopped. With files or folders instead of
--sim nothing is recorded: the answers are those of the recordings.

exit codes:
  0  answered; with --gate, every answer is yes, those about the device and about set states aside
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


def run(arguments: argparse.Namespace, command: str) -> int:
    """Record what is missing, compare and print; returns the exit code."""
    from gpusimbench.evaluator.probe.finding import Answer
    from gpusimbench.evaluator.probe.json import dump_probe
    from gpusimbench.evaluator.probe.questions import QUESTIONS, probed
    from gpusimbench.evaluator.report.evidence_json import family_record
    from gpusimbench.evaluator.report.sections.probed import probe_document

    _check(arguments)
    problems: list[str] = []
    files = _recorded(arguments, problems) if arguments.sim else _given(arguments)
    recordings = _verified(files)
    asked, prices = probed(recordings), _prices(recordings)
    findings = [finding for one in asked for finding in one.findings]
    if all(finding.answer is Answer.NOT_ASKED for finding in findings):
        raise NothingComparable("; ".join(problems) or _nothing_asked(recordings))
    answer(
        arguments.json,
        lambda: dump_probe(asked, [family_record(family) for family in prices]),
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


def _given(arguments: argparse.Namespace) -> list[Place]:
    from gpusimbench.evaluator.read.addresses import expand

    return list(expand(arguments.files))


def _verified(files: list[Place]) -> list[Recording]:
    found = verified(files)
    if lost := [recording for recording in found if recording.status == "incomplete"]:
        raise DataLost(f"{lost[0].path} is incomplete: {lost[0].reason}")
    return found


def _nothing_asked(recordings: list[Recording]) -> str:
    if any(field.group == ENV for recording in recordings for field in recording.fields):
        return (
            "of recordings of tasks, gsb-probe asks only whether runs repeat, and no two of these recordings have the "
            "same configuration; gsb-diff A B compares the environments that two recordings have in common, "
            "gsb-episodes compares success rates"
        )
    failed = [recording for recording in recordings if recording.status not in ("complete", "incomplete")]
    if recordings and len(failed) == len(recordings):
        return f"no run ended well: {failed[0].path} is {failed[0].status}: {failed[0].reason}"
    return "nothing to compare: gsb-probe needs runs of one configuration, or recordings that differ in one thing alone"


def _prices(recordings: list[Recording]) -> tuple[Family, ...]:
    """What levels of determinism cost, of those that were clocked alone."""
    from gpusimbench.evaluator.results.determinism_cost import price_list
    from gpusimbench.evaluator.results.evaluate import evaluate_files

    clocked = [r.path for r in recordings if r.configuration.phases == ("timed",)]
    return price_list(evaluate_files(clocked).results) if clocked else ()


def _recorded(arguments: argparse.Namespace, problems: list[str]) -> list[Place]:
    """The recordings of all plans, those that were missing made; `problems` gets what could not be recorded."""
    plans = _plans(arguments)
    with held(arguments.out, "gsb-probe", "records a probe"):
        for plan in plans:
            _record_arms(plan, arguments.out, problems)
        together: dict[tuple[str, str, tuple[str, ...]], list[Plan]] = {}
        for plan in plans:
            together.setdefault((plan.simulator, plan.scene, plan.options), []).append(plan)
        for levels in together.values():
            _clock(levels, arguments.out, problems)
    return [recording.path for plan in plans for recording in _there(arguments.out, plan)]


def _record_arms(plan: Plan, out: Path, problems: list[str]) -> None:
    from gpusimbench.schemas.text import plural

    refused = _record(plan, plan.missing(_configurations(out, plan)), out, problems)
    again = plan.missing(_configurations(out, plan), differing(_there(out, plan)))
    _record(plan, [arm for arm in again if arm not in refused], out, problems, "once more")
    for why in dict.fromkeys(refused.values()):  # an ability that is missing is an answer
        count = sum(reason == why for reason in refused.values())
        show(line(f"gsb-probe: {plural(count, 'arm')} not recorded: {why}"), error=True)


def _clock(levels: list[Plan], out: Path, problems: list[str]) -> None:
    """Make the runs that tell what each level of determinism costs; none where there is one level alone."""
    from gpusimbench.evaluator.probe.plan import PRICED, arm_of, interleaved

    if len(levels) < 2:
        return
    there = {plan: sum(arm_of(c) == plan.priced for c in _configurations(out, plan)) for plan in levels}
    order = list(interleaved(levels))
    left = [plan for at, plan in enumerate(order) if order[:at].count(plan) >= there[plan]]
    for plan in each(left, f"clocking {levels[0].simulator}, {PRICED} runs a level"):
        _make(plan, plan.priced, out, problems)


def _record(plan: Plan, left: list[Arm], out: Path, problems: list[str], what: str = "") -> dict[Arm, str]:
    """Make the runs of these arms; returns those that the simulator refuses, with its reason."""
    found: dict[Arm, str] = {}
    title = " ".join(filter(None, (f"recording {plan.simulator}, {plan.determinism}", what)))
    for arm in each(left, title, [plan.n_env + arm.n_env for arm in left]):
        if arm in found:
            continue
        if refused := _make(plan, arm, out, problems):
            found[arm] = refused
    return found


def _make(plan: Plan, arm: Arm, out: Path, problems: list[str]) -> str:
    """Make the run of an arm; returns why the simulator refuses what is done to it."""
    from gpusimbench.evaluator.compute.recorder import record

    saved = _saved(plan, arm, out) if arm.continued else ""
    if arm.continued and not saved:
        return "there is no snapshot to continue"
    made, refused = record(plan.arguments(arm, str(out), saved), lambda text: None)
    for one in made:
        if one.file is None or one.status == "stopped":
            problems.append(f"{plan.command(arm, str(out), saved)}: {one.status}: {one.reason}")
            complain("gsb-probe", problems[-1])
    if refused and not arm.intervention and not arm.initial:
        raise UsageError(refused)
    return refused


def _saved(plan: Plan, arm: Arm, out: Path) -> str:
    """The latest recording with the snapshot that an arm continues; empty without one."""
    found = [r for r in _there(out, plan) if arm.continued in r.configuration.snapshots and r.status == "complete"]
    return str(found[-1].path) if found else ""


def differing(recordings: list[Recording]) -> list[Arm]:
    """Arms of which something differs: more runs of them tell whether that is more than runs do anyway."""
    from gpusimbench.evaluator.probe.finding import Answer
    from gpusimbench.evaluator.probe.plan import arm_of
    from gpusimbench.evaluator.probe.questions import probed

    at = {recording.path: arm_of(recording.configuration) for recording in recordings}
    no = (f for one in probed(recordings) for f in one.findings if f.answer is Answer.NO and f.found is not None)
    return list(dict.fromkeys(at[path] for finding in no if finding.found for path in finding.found.files))


def _configurations(out: Path, plan: Plan) -> list[RunConfiguration]:
    return [recording.configuration for recording in _there(out, plan)]


def _there(out: Path, plan: Plan) -> list[Recording]:
    from gpusimbench.evaluator.read.recording import Recording

    found = [Recording(place(str(path))) for path in (sorted(out.glob("*.mcap")) if out.is_dir() else [])]
    return [r for r in found if r.status != "incomplete" and plan.has(r.configuration)]


def _plans(arguments: argparse.Namespace) -> list[Plan]:
    from gpusimbench.evaluator.compute.recorder import about, as_path
    from gpusimbench.evaluator.probe.plan import Model, Plan
    from gpusimbench.schemas.model_files import pack

    plans = []
    model = None
    if arguments.model is not None:
        model = Model(as_path(arguments.model), hashlib.sha256(pack(arguments.model)).hexdigest())
    for name in filter(None, (part.strip() for part in arguments.sim.split(","))):
        known = about(name)
        chosen = dict(option.partition("=")[::2] for option in arguments.option)
        device = chosen.get("device") if chosen.get("device") in _NUMBERS else known["device_here"]
        levels = known["levels"]
        if arguments.determinism == "all":
            wanted = [level["level"] for level in levels if level["effect_here"]]
            for level in levels:
                if not level["effect_here"]:
                    why = f"{level['level']} has no effect on this device: {level['why_none']}"
                    show(line(f"gsb-probe: {name}: {why}"), error=True)
        else:
            wanted = [part.strip() for part in arguments.determinism.split(",")]
        plans += [
            Plan(
                name,
                arguments.scene or _SCENE,
                level,
                tuple(arguments.option),
                arguments.seed,
                arguments.steps or (_QUICK_STEPS if arguments.quick else _STEPS),
                arguments.n_env,
                _numbers(arguments, device or "cpu"),
                arguments.spread,
                arguments.stride,
                arguments.vary,
                model,
            )
            for level in wanted
        ]
    return plans


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
