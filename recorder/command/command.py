"""What gsb-record does with its arguments: runs and their recordings, replays, lists, environments."""

from __future__ import annotations

import argparse
import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gpusimbench.recorder.command.arguments import N_ENV, OUT, OUT_OF_REPLAYS, SCENE, SHORTHANDS, parser
from gpusimbench.recorder.command.parser import fill
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.output import flush, show, show_document, show_path
from gpusimbench.schemas.commands.json_version import SCHEMA_VERSION
from gpusimbench.schemas.commands.progress import Progress, stage
from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.configuration import SETTINGS, RunConfiguration
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import block, stored_text
from gpusimbench.schemas.treatment import CONTROLS, GIVEN, FromFile

if TYPE_CHECKING:
    from gpusimbench.recorder.environments.interpreter import Interpreter
    from gpusimbench.recorder.scenes.base import Scene
    from gpusimbench.recorder.sets.series import Maker


def configure(arguments: argparse.Namespace) -> tuple[RunConfiguration, dict[str, bytes]]:
    """The configuration that the arguments ask for, and the files that its runs are given, by name; UsageError where it
    cannot be."""
    with shielded():  # an import that is interrupted shows as one that is broken
        from gpusimbench.recorder.plan import check_dt, parse_keep, parse_snapshots, view_of
        from gpusimbench.recorder.run import intervention, start, vary
        from gpusimbench.recorder.run.start import read_given
        from gpusimbench.recorder.scenes.actions import table
        from gpusimbench.recorder.scenes.model import ModelScene
        from gpusimbench.recorder.trials.tosses import read_tosses

    scene, inputs = _scene(arguments)
    dt = scene.dt if arguments.dt is None else arguments.dt
    check_dt(dt)
    phases = _phases(arguments.phases)
    begins, given = arguments.initial, None
    model = scene if isinstance(scene, ModelScene) else None
    if arguments.tosses is not None and not scene.tosses:
        raise UsageError(f"--tosses is for scene cube-toss, not for {scene.name}")
    if arguments.tosses is not None and begins:
        raise UsageError("--tosses and --initial both say how environments begin; give one of them")
    tossed = bool(scene.tosses and not begins and arguments.sweep is None)
    every = intervention.rows(arguments.intervene, scene, tossed=tossed, dt=dt, stride=arguments.stride)
    if tossed:
        tosses = read_tosses(arguments.tosses)
        if arguments.n_env is None:
            arguments.n_env = len(tosses)
        if arguments.steps is None:
            arguments.steps = round(tosses.steps(scene) * scene.dt / dt)
        if arguments.n_env >= 1:
            begins, given = tosses.initial(arguments.n_env, every)
    elif arguments.n_env is None:
        arguments.n_env = N_ENV
    if begins.startswith("random:"):
        begins = start.parse(begins, arguments.n_env)
    elif begins and given is None:
        begins, given = read_given(begins, arguments.n_env if arguments.sweep is None else 1)
    steps = arguments.steps
    if steps is None:
        given_rows = table(scene.actions) if scene.actions else None
        steps = round(scene.sample_time / dt) if given_rows is None else len(given_rows)
    warmup, timed_steps = scene.timed_window()
    settings = {name: getattr(arguments, name) for name in SETTINGS if hasattr(arguments, name)} | {
        "initial": begins,
        "vary": arguments.vary and vary.parse(arguments.vary, arguments.n_env),
        "intervention": arguments.intervene and intervention.parse(arguments.intervene),
        "keep": arguments.keep and parse_keep(arguments.keep),
        "snapshots": parse_snapshots(arguments.snapshot, steps),
        "model": model.files_sha256 if model else "",
        "keyframe": model.keyframe if model else "",
        "actions": model.controls if model else "",
        "fitted": _fitted(arguments),
    }
    configuration = RunConfiguration(
        simulator=arguments.sim,
        scene=scene.name,
        n_env=arguments.n_env,
        dt=dt,
        steps=steps,
        stride=arguments.stride,
        warmup=warmup if arguments.warmup is None else arguments.warmup,
        timed_steps=timed_steps if arguments.timed_steps is None else arguments.timed_steps,
        phases=phases,
        seed=arguments.seed,
        compression=arguments.compression,
        options=_options(arguments),
        determinism=arguments.determinism,
        timeout=arguments.timeout,
        capture=arguments.capture,
        view=view_of(arguments.view_env, off=arguments.no_view, phases=phases, keep=arguments.keep),
        **settings,
    )
    check_configuration(configuration, scene)
    return configuration, inputs if given is None else {**inputs, GIVEN: given}


def _scene(arguments: argparse.Namespace) -> tuple[Scene, dict[str, bytes]]:
    # what is simulated, and the files that it consists of, where it is a model of the user's own
    with shielded():
        from gpusimbench.recorder.scenes.actions import packed
        from gpusimbench.recorder.scenes.model import model_scene
        from gpusimbench.recorder.scenes.registry import make_scene, scene_names
        from gpusimbench.schemas.model_files import MODEL, pack, scene_name

    if arguments.model is None:
        for name in ("keyframe", "actions"):
            if getattr(arguments, name):
                raise UsageError(f"--{name} is for a model file: --model FILE")
        return make_scene(arguments.scene or SCENE).with_options(_options(arguments)), {}
    if arguments.scene is not None:
        raise UsageError("--model and --scene both say what is simulated; give one of them")
    name = scene_name(arguments.model, scene_names())
    inputs = {MODEL: pack(arguments.model)}
    actions = arguments.actions
    if actions.endswith(".npz"):
        actions, inputs[CONTROLS] = packed(actions)
    archive, file = inputs[MODEL], inputs.get(CONTROLS)
    return model_scene(name, archive, keyframe=arguments.keyframe, actions=actions, file=file), inputs


def check_configuration(configuration: RunConfiguration, scene: Scene) -> None:
    """UsageError where no run can be made of it, whoever asks: a number, an option, a determinism level or a scene."""
    with shielded():
        from gpusimbench.recorder.plan import check, check_keep
        from gpusimbench.recorder.run import intervention, start, vary
        from gpusimbench.recorder.scenes.actions import refusal as refusal_of
        from gpusimbench.recorder.simulators.registry import able, find_simulator

    check(configuration)
    simulator = configuration.simulator
    adapter = find_simulator(simulator).adapter()
    options = adapter.parsed(simulator, scene, configuration.options)
    levels = adapter.determinism_levels
    if configuration.determinism not in levels:
        has = "; ".join(f"{level} ({meaning})" for level, meaning in levels.items())
        hint = did_you_mean(configuration.determinism, levels)
        raise UsageError(
            f"simulator '{simulator}' has no determinism level '{configuration.determinism}'; it has: {has}{hint}"
        )
    if refusal := adapter.refusal(simulator, scene, options):
        others = "" if scene.needs() <= adapter.offered(options) else ", ".join(able(scene))
        raise UsageError(f"{refusal}; simulators that can: {others}" if others else refusal)
    if scene.actions and (refusal := refusal_of(scene.actions, configuration)):
        raise UsageError(refusal)
    check_keep(configuration, scene)
    if refusal := start.refusal(simulator, adapter, options, configuration.initial, configuration.snapshots):
        raise UsageError(refusal)
    if refusal := vary.refusal(simulator, adapter, options, scene, configuration.vary):
        raise UsageError(refusal)
    if refusal := intervention.refusal(simulator, adapter, options, configuration.intervention):
        raise UsageError(refusal)


def _options(arguments: argparse.Namespace) -> dict[str, str]:
    with shielded():
        from gpusimbench.recorder.options import split_options
    shorthands = [f"{name}={value}" for name in SHORTHANDS for value in getattr(arguments, name)]
    return split_options([*arguments.option, *shorthands])


def _fitted(arguments: argparse.Namespace) -> dict[str, str]:
    fitted = dict[str, str]()
    options = _options(arguments)
    for text in arguments.fitted:
        name, _, data = (part.strip() for part in text.partition("="))
        if not data:
            raise UsageError(f"--fitted takes an option and what it was fitted to, as solref=even tosses, not '{text}'")
        if name not in options:
            raise UsageError(f"--fitted {name}: give its value as well, with --option {name}=VALUE")
        fitted[name] = data
    return fitted


def _phases(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


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
    interpreter = _interpreter(arguments, arguments.sim)
    out = arguments.out or OUT
    request = Request(configuration, out, argv, quiet=arguments.json, end_killed=bool(points), inputs=inputs)
    with _maker(arguments, configuration, interpreter) as maker:
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
        from gpusimbench.recorder.trials.real import SAMPLE_TIME, UNITS, Target, record_tosses, record_trials

    scene = make_scene(arguments.scene)
    target = Target(arguments.out or OUT, arguments.compression, argv)
    if scene.tosses:
        for name in ("trials", "unit", "sample_time"):
            if getattr(arguments, name) is not None:
                raise UsageError(
                    f"--{name.replace('_', '-')} is for positions from a CSV file; scene {scene.name} has --tosses"
                )
        path = record_tosses(scene, arguments.tosses, target)
    else:
        if arguments.tosses is not None:
            raise UsageError(f"--tosses is for scene cube-toss; trials of {scene.name} are a CSV file, --trials")
        if arguments.trials is None:
            raise UsageError("--sim real needs --trials FILE.csv with the header trial,cube,x,y or trial,cube,x,y,z")
        if arguments.unit is None:
            raise UsageError(f"--sim real needs --unit {' or '.join(UNITS)}: the unit of the positions in the file")
        sample_time = SAMPLE_TIME if arguments.sample_time is None else arguments.sample_time
        path = record_trials(scene, arguments.trials, target, unit=arguments.unit, sample_time=sample_time)
    if arguments.json:
        ended = {"run": 0, "status": "complete", "cause": "", "reason": "", "file": str(path)}
        _print_json({"runs": [ended]})
    else:
        show_path(path)
    return ExitCode.OK


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
        from gpusimbench.recorder.sets.series import Here
    if interpreter is not None:
        check_known(interpreter, configuration.simulator, configuration.registered_scene)
        return nullcontext(Here(interpreter))
    with shielded():
        from gpusimbench.recorder.cluster.team import team
    return team(arguments.ray, configuration, resource=arguments.ray_resource, python=arguments.python)


def replay(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make the run of a recording again; returns the exit code."""
    with shielded():
        from gpusimbench.recorder.environments.choice import check_known
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
        options=_options(arguments),
        phases=None if arguments.phases is None else _phases(arguments.phases),
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
        interpreter = _interpreter(arguments, configuration.simulator)
        if interpreter is not None:
            check_known(interpreter, configuration.simulator, configuration.registered_scene)
        check_room(source, arguments.runs, arguments.out or OUT_OF_REPLAYS)
    except UsageError as error:
        said = shown(str(error))
        whole = said if str(arguments.replay) in said else f"{arguments.replay} cannot be replayed here: {said}"
        raise UsageError(whole) from None
    say(announcement(source, configuration))
    of = origin(source, configuration)
    out = arguments.out or OUT_OF_REPLAYS
    request = Request(configuration, out, argv, quiet=arguments.json, replay_of=of, cage=source.cage, inputs=inputs)
    with _maker(arguments, configuration, interpreter) as maker:
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
        from gpusimbench.recorder import clock
        from gpusimbench.recorder.sets.progress import say
    if wrong := clock.problem():
        say(wrong)
    command = ("gsb-record", *(stored_text(text) for text in given))
    if arguments.replay is not None:
        return replay(arguments, command)
    if arguments.sim == REAL:
        return _record_real(arguments, command)
    return record(arguments, command)
