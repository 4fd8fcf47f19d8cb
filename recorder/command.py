"""What gsb-record does: its arguments, and from them runs and their recordings."""

from __future__ import annotations

import argparse
import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.output import flush, show, show_document
from gpusimbench.schemas.command_line import add_common
from gpusimbench.schemas.configuration import CAPTURE_MODES, OPTIONAL_PHASES, RunConfiguration
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.printable import block, line
from gpusimbench.schemas.provenance import REAL

if TYPE_CHECKING:
    from gpusimbench.recorder.environments.interpreter import Interpreter
    from gpusimbench.recorder.series import Maker

_EPILOG = """\
exit codes:
  0  every run is complete; of a sweep, every run below its last point, and at least one run
  1  a run failed or is invalid; its recording says why; a replay took too much of this machine and was stopped
  2  the command asks for something that cannot be
  3  a run's process died or the disk was full: data was lost

sweeps:
  --sweep makes the runs of each number of environments, smallest first, and ends behind the first at which every run
  fails or is invalid. To find that limit is what a sweep is for, so a failure there is no failure of the command. Where
  the first run is out of memory or of a buffer, is refused or times out, the other runs of its point are not made.
  The same command with the same --out goes on where it stopped: runs whose recordings lie there are not made again.
  Two commands do not make the same sweep in one folder at once: the second ends with 1 and names the process that does.

replays:
  --replay FILE makes the run of a recording again, here: its configuration, which passes the same checks as arguments,
  and nothing else. What it asks for is printed first. The scene has to be the same; --option (and --impl, --device...)
  replaces what was recorded, and the new recording says so; --runs, --phases, --view-env, --timeout, --python and --out
  are yours.
  A replay that takes more memory, threads or disk than its recording accounts for is stopped; nothing of it is kept.
  gsb-audit FILE does this, and says whether the same came out.

clusters:
  --ray ADDRESS makes one run at a time on each GPU of a Ray cluster, or one a node where runs step on the CPU, and
  copies each recording to --out here. Only machines of one kind are used: those of the kind that there are most of, or
  that --ray-resource names. Every node needs this version of the project and the engine; see docs/cluster.md.

environments:
  Engines whose packages cannot live together get an environment each: --setup NAME makes it, in $GSB_ENVIRONMENTS or
  the user's folder for data, from pinned requirements whose hashes are checked. Later runs of that simulator find it.
  --python PATH takes one of your own. What builds on torch gets the torch that pip is configured for on this machine.

examples:
  gsb-record --sim mujoco
  gsb-record --sim mujoco --scene free-fall --n-env 64 --runs 3 --out recordings/
  gsb-record --sim mujoco --option cone=pyramidal --option integrator=Euler
  gsb-record --sim mujoco --scene free-fall --sweep 1..131072:4 --runs 3 --phases timed --timeout 600
  gsb-record --setup genesis && gsb-record --sim genesis
  gsb-record --replay theirs.mcap --runs 3
  gsb-record --sim real --trials trials.csv --unit cm
"""


_USAGE = """\
%(prog)s --sim NAME [options]
       %(prog)s --sim real --trials CSV --unit {m,cm} [options]
       %(prog)s --replay FILE [options]
       %(prog)s --setup NAME [--python PATH]
       %(prog)s --list [--json]"""


_SIMULATED: dict[str, Any] = {
    "scene": "inclined-collision",
    "sweep": None,
    "n_env": 16,
    "runs": 10,
    "dt": None,
    "seed": 0,
    "option": (),
    "impl": (),
    "backend": (),
    "solver": (),
    "device": (),
    "determinism": "default",
    "timeout": 0.0,
    "phases": ",".join(OPTIONAL_PHASES),
    "steps": None,
    "stride": 1,
    "capture": CAPTURE_MODES[0],
    "view_env": (),
    "no_view": False,
    "warmup": 100,
    "timed_steps": 1000,
    "ray": None,
    "ray_resource": None,
}
"""Arguments that make sense for a simulator only, and what each is where it is not given."""

_MEASURED: dict[str, Any] = {"scene": "inclined-collision", "trials": None, "unit": None, "sample_time": 5.0}
"""The same for real trials."""

_REPLAYED: dict[str, Any] = {
    "runs": 1, "option": (), "timeout": 0.0, "phases": None, "view_env": (), "no_view": False,
    "ray": None, "ray_resource": None,
}  # fmt: skip
"""The same for replays; and so are the options that are short for --option."""

_OUT, _OUT_OF_REPLAYS = Path("recordings"), Path("replays")  # replays are no further runs of a set

_SHORTHANDS = {
    "impl": "implementation, of simulators that have several",
    "backend": "engine, of simulators that stand on several",
    "solver": "solver",
    "device": "device to step on",
}
"""Options of simulators that are common enough for a switch of their own."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """See ArgumentParser.error."""
        super().error(line(message))


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = _Parser(
        prog="gsb-record",
        description="Run a scene in N identical environments on a simulator; write one MCAP recording per run, "
        "each run in a fresh process.",
        usage=_USAGE,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_common(p, _names)
    p.add_argument("--list", action="store_true", help="show simulators, where they are installed, and scenes")
    p.add_argument("--setup", metavar="NAME", help="make the environment of a simulator that needs one of its own")
    p.add_argument(
        "--python",
        type=Path,
        metavar="PATH",
        help="interpreter, or virtual environment, that makes the runs (or the environment of --setup)",
    )
    p.add_argument("--json", action="store_true", help="print results (or the list) as JSON on standard output")

    what = p.add_argument_group("what is run")
    what.add_argument("--sim", metavar="NAME", help="simulator (see --list), or 'real' for measured trials")
    what.add_argument("--replay", type=Path, metavar="FILE", help="run what a recording says that it ran; see below")
    what.add_argument("--scene", metavar="NAME", help=f"what is simulated; see --list (default: {_SIMULATED['scene']})")
    what.add_argument("--n-env", type=int, metavar="N", help=f"environments (default: {_SIMULATED['n_env']})")
    what.add_argument(
        "--sweep",
        metavar="A..B[:F]",
        help="instead of --n-env: A, A*F, A*F*F... and B environments, powers of two (F: 2); see below",
    )
    what.add_argument(
        "--runs", type=int, metavar="R", help=f"independent runs (default: {_SIMULATED['runs']}; of --replay: 1)"
    )
    what.add_argument("--dt", type=float, metavar="S", help="step [s] (default: the scene's, such as 0.01)")
    what.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help=f"of what is drawn at random, in every run (default: {_SIMULATED['seed']})",
    )
    what.add_argument("--option", action="append", metavar="NAME=VALUE", help="an option of the simulator; repeatable")
    for name, meaning in _SHORTHANDS.items():
        what.add_argument(f"--{name}", action="append", metavar="X", help=f"{meaning}: short for --option {name}=X")
    what.add_argument(
        "--determinism",
        metavar="LEVEL",
        help="what the engine has for it; see --list (default: default, the engine as it ships)",
    )
    what.add_argument(
        "--timeout", type=float, metavar="S", help="end each run after so many seconds (default: 0, never)"
    )

    how = p.add_argument_group("what is recorded")
    how.add_argument(
        "--phases",
        metavar="LIST",
        help=f"timed (throughput), capture (states) or both (default: {_SIMULATED['phases']}; of --replay: as there)",
    )
    how.add_argument("--steps", type=int, metavar="N", help="captured steps (default: 5 s of simulated time)")
    how.add_argument(
        "--stride", type=int, metavar="K", help=f"record every K-th state (default: {_SIMULATED['stride']})"
    )
    how.add_argument(
        "--capture",
        choices=CAPTURE_MODES,
        help="lossless: write while stepping, and wait where the disk is slower; memory: write after the last step "
        f"(default: {_SIMULATED['capture']})",
    )
    how.add_argument(
        "--view-env",
        type=int,
        action="append",
        metavar="E",
        help="environment that viewers such as Foxglove and rerun show; repeatable, up to 4 times (default: 0)",
    )
    how.add_argument("--no-view", action="store_true", default=None, help="write nothing for viewers")
    how.add_argument("--warmup", type=int, metavar="N", help=f"untimed steps first (default: {_SIMULATED['warmup']})")
    how.add_argument(
        "--timed-steps", type=int, metavar="N", help=f"steps that are timed (default: {_SIMULATED['timed_steps']})"
    )
    how.add_argument(
        "--compression",
        choices=("none", "lz4", "zstd"),
        default="none",
        help="compression of the file's chunks (default: none)",
    )
    how.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder of the recordings (default: {_OUT}/; of --replay: {_OUT_OF_REPLAYS}/)",
    )

    across = p.add_argument_group("where it is run")
    across.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="spread the runs over the Ray cluster there (HOST:PORT, auto), or over the GPUs of this machine (local); "
        "see below",
    )
    across.add_argument("--ray-resource", metavar="NAME", help="use only nodes with this resource of Ray's")

    real = p.add_argument_group("real trials (--sim real)")
    real.add_argument("--trials", type=Path, metavar="CSV", help="positions of the cubes: trial,cube,x,y[,z]")
    real.add_argument("--unit", choices=("m", "cm"), help="unit of the positions in the CSV")
    real.add_argument(
        "--sample-time",
        type=float,
        metavar="S",
        help=f"when they were measured [s] (default: {_MEASURED['sample_time']})",
    )
    return p


def _names() -> dict[str, tuple[str, ...]]:
    from gpusimbench.recorder.environments.specification import SPECIFICATIONS
    from gpusimbench.recorder.scenes.registry import scene_names
    from gpusimbench.recorder.simulators.registry import simulators

    return {"sim": (*simulators(), REAL), "scene": scene_names(), "setup": tuple(SPECIFICATIONS)}


def configure(arguments: argparse.Namespace) -> RunConfiguration:
    """The configuration that the arguments ask for; UsageError where it cannot be."""
    with shielded():  # an import that is interrupted shows as one that is broken
        from gpusimbench.recorder.plan import check_dt, view_of
        from gpusimbench.recorder.scenes.registry import make_scene

    scene = make_scene(arguments.scene)
    dt = scene.dt if arguments.dt is None else arguments.dt
    check_dt(dt)
    phases = _phases(arguments.phases)
    configuration = RunConfiguration(
        simulator=arguments.sim,
        scene=arguments.scene,
        n_env=arguments.n_env,
        dt=dt,
        steps=round(scene.sample_time / dt) if arguments.steps is None else arguments.steps,
        stride=arguments.stride,
        warmup=arguments.warmup,
        timed_steps=arguments.timed_steps,
        phases=phases,
        seed=arguments.seed,
        compression=arguments.compression,
        options=_options(arguments),
        determinism=arguments.determinism,
        timeout=arguments.timeout,
        capture=arguments.capture,
        view=view_of(arguments.view_env, off=arguments.no_view, phases=phases),
    )
    check_configuration(configuration)
    return configuration


def check_configuration(configuration: RunConfiguration) -> None:
    """UsageError where no run can be made of it, whoever asks: a number, an option or a determinism level."""
    with shielded():
        from gpusimbench.recorder.options import parse_options
        from gpusimbench.recorder.plan import check
        from gpusimbench.recorder.simulators.registry import find_simulator

    check(configuration)
    simulator = configuration.simulator
    adapter = find_simulator(simulator).adapter()
    parse_options(simulator, adapter.Options, configuration.options)
    levels = adapter.determinism_levels
    if configuration.determinism not in levels:
        has = "; ".join(f"{level} ({meaning})" for level, meaning in levels.items())
        raise UsageError(
            f"simulator '{simulator}' has no determinism level '{configuration.determinism}'; it has: {has}"
        )


def _options(arguments: argparse.Namespace) -> dict[str, str]:
    with shielded():
        from gpusimbench.recorder.options import split_options
    shorthands = [f"{name}={value}" for name in _SHORTHANDS for value in getattr(arguments, name)]
    return split_options([*arguments.option, *shorthands])


def _phases(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def record(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make all runs; returns the exit code."""
    with shielded():
        from gpusimbench.recorder.plan import check_runs
        from gpusimbench.recorder.series import Request, record_set, record_sweep
        from gpusimbench.recorder.sweep import Sweep, parse_points

    check_runs(arguments.runs)
    points = () if arguments.sweep is None else parse_points(arguments.sweep)
    if points:
        arguments.n_env = points[0]
    interpreter = _interpreter(arguments, arguments.sim)
    configuration = configure(arguments)
    out = arguments.out or _OUT
    request = Request(configuration, out, argv, quiet=arguments.json, end_killed=bool(points))
    with _maker(arguments, configuration, interpreter) as maker:
        if points:
            code, results = record_sweep(request, Sweep(points, arguments.runs), maker)
        else:
            code, results = record_set(request, arguments.runs, maker)
    if arguments.json:
        _print_json(results)
    return code


def _interpreter(arguments: argparse.Namespace, simulator: str) -> Interpreter | None:
    # that makes the runs here; None with --ray, where each node finds its own
    with shielded():
        from gpusimbench.recorder.environments.choice import interpreter_for
        from gpusimbench.recorder.simulators.registry import find_simulator
    entry = find_simulator(simulator)
    return interpreter_for(entry, arguments.python) if arguments.ray is None else None


def _maker(
    arguments: argparse.Namespace, configuration: RunConfiguration, interpreter: Interpreter | None
) -> AbstractContextManager[Maker]:
    with shielded():
        from gpusimbench.recorder.environments.choice import check_known
        from gpusimbench.recorder.series import Here
    if interpreter is not None:
        check_known(interpreter, configuration.simulator, configuration.scene)
        return nullcontext(Here(interpreter))
    with shielded():
        from gpusimbench.recorder.cluster.team import team
    return team(arguments.ray, configuration, resource=arguments.ray_resource, python=arguments.python)


def replay(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make the run of a recording again; returns the exit code."""
    with shielded():
        from gpusimbench.recorder.environments.choice import check_known
        from gpusimbench.recorder.plan import check_runs, view_of
        from gpusimbench.recorder.progress import say
        from gpusimbench.recorder.replay import (
            announcement,
            check_room,
            check_scene,
            origin,
            read_source,
            replayed,
            shown,
        )
        from gpusimbench.recorder.scenes.registry import make_scene
        from gpusimbench.recorder.series import Request, record_set

    check_runs(arguments.runs)
    source = read_source(arguments.replay)
    configuration = replayed(
        source,
        options=_options(arguments),
        phases=None if arguments.phases is None else _phases(arguments.phases),
        timeout=arguments.timeout,
        compression=arguments.compression,
    )
    view = view_of(arguments.view_env, off=arguments.no_view, phases=configuration.phases)
    configuration = replace(configuration, view=view)
    try:
        check_scene(source, make_scene(configuration.scene))
        check_configuration(configuration)
        interpreter = _interpreter(arguments, configuration.simulator)
        if interpreter is not None:
            check_known(interpreter, configuration.simulator, configuration.scene)
        check_room(source, arguments.runs, arguments.out or _OUT_OF_REPLAYS)
    except UsageError as error:
        said = shown(str(error))
        whole = said if str(arguments.replay) in said else f"{arguments.replay} cannot be replayed here: {said}"
        raise UsageError(whole) from None
    say(announcement(source, configuration))
    of = origin(source, configuration)
    out = arguments.out or _OUT_OF_REPLAYS
    request = Request(configuration, out, argv, quiet=arguments.json, replay_of=of, cage=source.cage)
    with _maker(arguments, configuration, interpreter) as maker:
        code, results = record_set(request, arguments.runs, maker)
    if code and configuration.options.get("device", "cpu") not in ("cpu", "auto"):
        say("where that device is not there, --option device=cpu replays on the CPU; the recording will say so")
    if arguments.json:
        _print_json(results)
    return code


def _print_json(record: dict[str, Any]) -> None:
    show_document(json.dumps({"schema_version": 1, **record}, indent=1))


def _list(as_json: bool) -> int:
    with shielded():
        from gpusimbench.recorder.listing import list_all, text_of
    known = list_all()
    if as_json:
        _print_json(known)
    else:
        show(block(text_of(known).split("\n")))
    return ExitCode.OK


def _set_up(arguments: argparse.Namespace) -> int:
    with shielded():
        from gpusimbench.recorder.environments.setup import set_up
        from gpusimbench.recorder.listing import about_environment, environment_line
    made = about_environment(set_up(arguments.setup, arguments.python))
    if arguments.json:
        _print_json({"environment": made})
    else:
        show(line(environment_line(made)))
    return ExitCode.OK


def run(given: list[str]) -> int:
    """Do what the arguments say; returns the exit code. Errors as of schemas.errors."""
    try:
        arguments = parser().parse_args(given)
    except SystemExit:
        flush()  # --help and --version only write to a buffer, and an error there would come too late
        raise
    commands = (arguments.list, arguments.setup is not None, arguments.sim is not None, arguments.replay is not None)
    if sum(commands) > 1:
        raise UsageError("--list, --setup, --sim and --replay are four commands; give one of them")
    if arguments.python is not None and (arguments.list or arguments.sim == REAL):
        raise UsageError("--python is for the runs of a simulator, and for --setup")
    if arguments.list:
        return _list(arguments.json)
    if arguments.setup is not None:
        return _set_up(arguments)
    if not arguments.sim and arguments.replay is None:
        raise UsageError("say which simulator with --sim NAME; gsb-record --list shows them")
    _fill(arguments)
    with shielded():
        from gpusimbench.recorder import clock
        from gpusimbench.recorder.progress import say
    if wrong := clock.problem():
        say(wrong)
    # Text that is no Unicode (a path in another encoding) cannot be stored as it is.
    command = ("gsb-record", *(text.encode("utf-8", "backslashreplace").decode() for text in given))
    if arguments.replay is not None:
        return replay(arguments, command)
    if arguments.sim == REAL:
        with shielded():
            from gpusimbench.recorder.real import record_trials

        arguments.out = arguments.out or _OUT
        return record_trials(arguments, command)
    return record(arguments, command)


def _fill(arguments: argparse.Namespace) -> None:
    # what was not given gets its default; what was given and would be ignored is refused
    if arguments.replay is not None:
        own = {**_REPLAYED, **dict.fromkeys(_SHORTHANDS, ())}
        foreign, whose, doing = {**_SIMULATED, **_MEASURED}, "--sim", "--replay takes it from the recording"
    elif arguments.sim == REAL:
        own, foreign, whose, doing = _MEASURED, _SIMULATED, "a simulator", f"--sim {REAL} has no use for it"
    else:
        own, foreign, whose = _SIMULATED, _MEASURED, f"--sim {REAL}"
        doing = f"--sim {arguments.sim} has no use for it"
    for name in foreign:
        if name not in own and getattr(arguments, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is for {whose}; {doing}")
    if arguments.ray_resource is not None and arguments.ray is None:
        raise UsageError("--ray-resource chooses nodes of a Ray cluster; say which cluster with --ray")
    if arguments.sweep is not None and arguments.n_env is not None:
        raise UsageError("--sweep says how many environments there are; leave --n-env out")
    for name, default in own.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
