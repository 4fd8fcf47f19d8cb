"""From the arguments of gsb-record to the configuration of its runs, checked before anything is made."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gpusimbench.recorder.command.arguments import N_ENV, SCENE, SHORTHANDS
from gpusimbench.recorder.interruption import shielded
from gpusimbench.schemas.configuration import SETTINGS, RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.treatment import CONTROLS

if TYPE_CHECKING:
    from gpusimbench.recorder.scenes.base import Scene


@dataclass(frozen=True)
class _Start:
    """How the environments of a run begin, and how many there are.

    steps    that they are captured for; None where that does not depend on how they begin
    initial  the setting, as recordings keep it
    given    the attachment GIVEN; None where there is none
    """

    n_env: int
    steps: int | None
    initial: str
    given: bytes | None = None


def configure(arguments: argparse.Namespace) -> tuple[RunConfiguration, dict[str, bytes]]:
    """The configuration that the arguments ask for, and the files that its runs are given, by name; UsageError where it
    cannot be."""
    with shielded():  # an import that is interrupted shows as one that is broken
        from gpusimbench.recorder.plan import check_dt, parse_keep, parse_snapshots, view_of
        from gpusimbench.recorder.run import intervention, vary
        from gpusimbench.recorder.scenes.model import ModelScene

    scene, inputs = _scene(arguments)
    dt = scene.dt if arguments.dt is None else arguments.dt
    check_dt(dt)
    phases = parsed_phases(arguments.phases)
    start = _start(arguments, scene, dt)
    steps = _usual_steps(scene, dt) if start.steps is None else start.steps
    warmup, timed_steps = scene.timed_window()
    model = scene if isinstance(scene, ModelScene) else None
    settings = {name: getattr(arguments, name) for name in SETTINGS if hasattr(arguments, name)} | {
        "initial": start.initial,
        "vary": arguments.vary and vary.parse(arguments.vary, start.n_env),
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
        n_env=start.n_env,
        dt=dt,
        steps=steps,
        stride=arguments.stride,
        warmup=warmup if arguments.warmup is None else arguments.warmup,
        timed_steps=timed_steps if arguments.timed_steps is None else arguments.timed_steps,
        phases=phases,
        seed=arguments.seed,
        compression=arguments.compression,
        options=given_options(arguments),
        determinism=arguments.determinism,
        timeout=arguments.timeout,
        capture=arguments.capture,
        view=view_of(arguments.view_env, off=arguments.no_view, phases=phases, keep=arguments.keep),
        **settings,
    )
    check_configuration(configuration, scene)
    return configuration, inputs if start.given is None else {**inputs, GIVEN: start.given}


def _start(arguments: argparse.Namespace, scene: Scene, dt: float) -> _Start:
    with shielded():
        from gpusimbench.recorder.run import intervention, start
        from gpusimbench.recorder.trials.tosses import read_tosses

    initial, steps = arguments.initial, arguments.steps
    if arguments.tosses is not None and not scene.tosses:
        raise UsageError(f"--tosses is for scene cube-toss, not for {scene.name}")
    if arguments.tosses is not None and initial:
        raise UsageError("--tosses and --initial both say how environments begin; give one of them")
    tossed = bool(scene.tosses and not initial and arguments.sweep is None)
    every = intervention.rows(arguments.intervene, scene, tossed=tossed, dt=dt, stride=arguments.stride)
    if tossed:
        tosses = read_tosses(arguments.tosses)
        n_env = len(tosses) if arguments.n_env is None else arguments.n_env
        if steps is None:
            steps = round(tosses.steps(scene) * scene.dt / dt)
        return _Start(n_env, steps, *tosses.initial(n_env, every)) if n_env >= 1 else _Start(n_env, steps, initial)
    n_env = N_ENV if arguments.n_env is None else arguments.n_env
    if initial.startswith("random:"):
        return _Start(n_env, steps, start.parse(initial, n_env, scene, arguments.vary))
    if initial:
        return _Start(n_env, steps, *start.read_given(initial, n_env if arguments.sweep is None else 1))
    return _Start(n_env, steps, initial)


def _usual_steps(scene: Scene, dt: float) -> int:
    with shielded():
        from gpusimbench.recorder.scenes.actions import table

    rows = table(scene.actions) if scene.actions else None
    return round(scene.sample_time / dt) if rows is None else len(rows)


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
        return make_scene(arguments.scene or SCENE).with_options(given_options(arguments)), {}
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


def given_options(arguments: argparse.Namespace) -> dict[str, str]:
    """Options of the simulator and of the scene, as text by name; UsageError where one is none."""
    with shielded():
        from gpusimbench.recorder.options import split_options
    shorthands = [f"{name}={value}" for name in SHORTHANDS for value in getattr(arguments, name)]
    return split_options([*arguments.option, *shorthands])


def _fitted(arguments: argparse.Namespace) -> dict[str, str]:
    fitted = dict[str, str]()
    options = given_options(arguments)
    for text in arguments.fitted:
        name, _, data = (part.strip() for part in text.partition("="))
        if not data:
            raise UsageError(f"--fitted takes an option and what it was fitted to, as solref=even tosses, not '{text}'")
        if name not in options:
            raise UsageError(f"--fitted {name}: give its value as well, with --option {name}=VALUE")
        fitted[name] = data
    return fitted


def parsed_phases(text: str) -> tuple[str, ...]:
    """Names of phases, from a list with commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
