"""What gsb-record does with its arguments: runs and their recordings, replays, lists, environments."""

from __future__ import annotations

import argparse
import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gpusimbench.recorder.command.arguments import OUT, OUT_OF_REPLAYS, parser
from gpusimbench.recorder.command.configure import check_configuration, configure, given_options, parsed_phases
from gpusimbench.recorder.command.parser import fill
from gpusimbench.recorder.interruption import shielded
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.commands.output import flush, show, show_document, show_path
from gpusimbench.schemas.commands.progress import Progress, stage
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import block, stored_text
from gpusimbench.schemas.treatment import FromFile

if TYPE_CHECKING:
    from gpusimbench.recorder.sets.series import Maker


def record(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make all runs; returns the exit code."""
    with shielded():
        from gpusimbench.recorder.plan import check_runs
        from gpusimbench.recorder.sets.series import Request, record_set, record_sweep
        from gpusimbench.recorder.sets.sweep import Sweep, parse_points

    check_runs(arguments.runs)
    points = () if arguments.sweep is None else parse_points(arguments.sweep)
    if points:
        arguments.n_env = points[0]
    configuration, inputs = configure(arguments)
    if points and configuration.actions and (found := FromFile.parse(configuration.actions)) and found.each:
        raise UsageError(
            f"--actions {arguments.actions} has controls of each environment, whose number --sweep changes"
        )
    out = arguments.out or OUT
    request = Request(configuration, out, argv, quiet=arguments.json, end_killed=bool(points), inputs=inputs)
    with _maker(arguments, configuration) as maker:
        if points:
            code, results = record_sweep(request, Sweep(points, arguments.runs), maker)
        else:
            code, results = record_set(request, arguments.runs, maker)
    if arguments.json:
        _print_json(results)
    return code


def _record_real(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    with shielded():
        from gpusimbench.recorder.scenes.registry import make_scene
        from gpusimbench.recorder.trials.real import SAMPLE_TIME, UNITS, Destination, record_tosses, record_trials

    scene = make_scene(arguments.scene)
    destination = Destination(arguments.out or OUT, arguments.compression, argv)
    if scene.tosses:
        for name in ("trials", "unit", "sample_time"):
            if getattr(arguments, name) is not None:
                raise UsageError(
                    f"--{name.replace('_', '-')} is for positions from a CSV file; scene {scene.name} has --tosses"
                )
        path = record_tosses(scene, arguments.tosses, destination)
    else:
        if arguments.tosses is not None:
            raise UsageError(f"--tosses is for scene cube-toss; trials of {scene.name} are a CSV file, --trials")
        if arguments.trials is None:
            raise UsageError("--sim real needs --trials FILE.csv with the header trial,cube,x,y or trial,cube,x,y,z")
        if arguments.unit is None:
            raise UsageError(f"--sim real needs --unit {' or '.join(UNITS)}: the unit of the positions in the file")
        sample_time = SAMPLE_TIME if arguments.sample_time is None else arguments.sample_time
        path = record_trials(scene, arguments.trials, destination, unit=arguments.unit, sample_time=sample_time)
    if arguments.json:
        ended = {"run": 0, "status": "complete", "cause": "", "reason": "", "file": str(path)}
        _print_json({"runs": [ended]})
    else:
        show_path(path)
    return ExitCode.OK


def _maker(arguments: argparse.Namespace, configuration: RunConfiguration) -> AbstractContextManager[Maker]:
    # here, or with --ray on nodes, each of which finds its own interpreter
    if arguments.ray is not None:
        with shielded():
            from gpusimbench.recorder.cluster.team import team
        return team(arguments.ray, configuration, resource=arguments.ray_resource, python=arguments.python)
    with shielded():
        from gpusimbench.recorder.environments.choice import check_known, interpreter_for
        from gpusimbench.recorder.sets.series import Here
        from gpusimbench.recorder.simulators.registry import find_simulator
    interpreter = interpreter_for(find_simulator(configuration.simulator), arguments.python)
    check_known(interpreter, configuration.simulator, configuration.registered_scene)
    return nullcontext(Here(interpreter))


def replay(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make the run of a recording again; returns the exit code."""
    with shielded():
        from gpusimbench.recorder.plan import check_runs, view_of
        from gpusimbench.recorder.scenes.registry import scene_of
        from gpusimbench.recorder.sets.progress import say
        from gpusimbench.recorder.sets.replay import (
            announcement,
            begun,
            check_room,
            check_scene,
            check_varied,
            origin,
            read_source,
            replayed,
            shown,
        )
        from gpusimbench.recorder.sets.series import Request, record_set

    check_runs(arguments.runs)
    source = read_source(arguments.replay, allow_model=arguments.allow_model)
    configuration = replayed(
        source,
        options=given_options(arguments),
        phases=None if arguments.phases is None else parsed_phases(arguments.phases),
        timeout=arguments.timeout,
        compression=arguments.compression,
    )
    c, inputs = begun(source, configuration, arguments.from_step)
    view = view_of(arguments.view_env, off=arguments.no_view, phases=c.phases, keep=c.keep)
    configuration = replace(c, view=view)
    try:
        scene = scene_of(configuration, inputs)
        check_scene(source, scene)
        check_configuration(configuration, scene)
        check_varied(source, configuration, scene)
        made_by = _maker(arguments, configuration)
        check_room(source, arguments.runs, arguments.out or OUT_OF_REPLAYS)
    except UsageError as error:
        said = shown(str(error))
        whole = said if str(arguments.replay) in said else f"{arguments.replay} cannot be replayed here: {said}"
        raise UsageError(whole) from None
    say(announcement(source, configuration))
    of = origin(source, configuration)
    out = arguments.out or OUT_OF_REPLAYS
    request = Request(configuration, out, argv, quiet=arguments.json, replay_of=of, cage=source.cage, inputs=inputs)
    with made_by as maker:
        code, results = record_set(request, arguments.runs, maker)
    if code and configuration.options.get("device", "cpu") not in ("cpu", "auto"):
        say("if this machine does not have the recorded device, use --option device=cpu; the recording will store that")
    if arguments.json:
        _print_json(results)
    return code


def _print_json(record: dict[str, Any]) -> None:
    show_document(json.dumps({"schema_version": SCHEMA_VERSION, **record}, indent=1))


def _list(name: str, as_json: bool) -> int:
    with shielded():
        from gpusimbench.recorder.command.listing import lines_of, list_all, list_one, text_of
    known = list_one(name) if name else list_all()
    if as_json:
        _print_json(known)
    else:
        show(block(lines_of(known) if name else text_of(known).split("\n")))
    return ExitCode.OK


def _set_up(arguments: argparse.Namespace) -> int:
    with shielded():
        from gpusimbench.recorder.command.listing import about_environment, environment_lines
        from gpusimbench.recorder.environments.setup import set_up
    with Progress("gsb-record"), stage("making the environment"):
        made = about_environment(set_up(arguments.setup, arguments.python))
    if arguments.json:
        _print_json({"environment": made})
    else:
        show(block(environment_lines(made)))
    return ExitCode.OK


def run(given: list[str]) -> int:
    """Do what the arguments say; returns the exit code. Errors as of schemas.errors."""
    command_line = parser()
    try:
        arguments = command_line.parse_args(given)
    except SystemExit:
        flush()  # --help and --version only write to a buffer, and an error there would come too late
        raise
    commands = (
        arguments.list is not None,
        arguments.setup is not None,
        arguments.sim is not None,
        arguments.replay is not None,
    )
    if sum(commands) > 1:
        raise UsageError("use only one of --list, --setup, --sim and --replay")
    if arguments.python is not None and (arguments.list is not None or arguments.sim == REAL):
        raise UsageError(f"--python applies to runs of a simulator and to --setup, not to --list or --sim {REAL}")
    if arguments.list is not None:
        return _list(arguments.list, arguments.json)
    if arguments.setup is not None:
        return _set_up(arguments)
    if not arguments.sim and arguments.replay is None:
        raise UsageError("no simulator given: use --sim NAME; gsb-record --list shows the simulators")
    fill(arguments, command_line.unless_given)
    with shielded():
        from gpusimbench.recorder.probes.host import clock_problem
        from gpusimbench.recorder.sets.progress import say
    if wrong := clock_problem():
        say(wrong)
    command = ("gsb-record", *(stored_text(text) for text in given))
    if arguments.replay is not None:
        return replay(arguments, command)
    if arguments.sim == REAL:
        return _record_real(arguments, command)
    return record(arguments, command)
