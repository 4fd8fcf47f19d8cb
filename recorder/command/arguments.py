"""The arguments of gsb-record: what it takes, and what each is where it is not given."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from gpusimbench.recorder.command.parser import EPILOG, USAGE, RecordParser, names
from gpusimbench.schemas.commands.parser import add_common
from gpusimbench.schemas.configuration import CAPTURE_MODES, USUAL_PHASES
from gpusimbench.schemas.treatment import KINDS

SCENE = "inclined-collision"
"""The scene where nothing says which."""

N_ENV = 16
"""Environments where nothing says how many."""

OUT, OUT_OF_REPLAYS = Path("runs"), Path("replays")  # replays are no further runs of a set

SHORTHANDS = {
    "impl": "implementation, of a simulator that has several",
    "backend": "engine, of a simulator that can use several",
    "solver": "solver",
    "device": "device to step on",
}
"""Options of simulators that are common enough for a switch of their own."""


def parser() -> RecordParser:
    """The command's arguments."""
    p = RecordParser(
        prog="gsb-record",
        description="Run a scene in N identical environments on a simulator; write one MCAP recording per run, "
        "each run in a fresh process.",
        usage=USAGE,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_common(
        p,
        names,
        reads=("CUDA_VISIBLE_DEVICES", "GSB_CUBE_TOSS", "GSB_ENVIRONMENTS", "GSB_MADRONA_MODULE", "GSB_PROGRESS"),
    )
    p.add_argument(
        "--list",
        nargs="?",
        const="",
        metavar="NAME",
        help="show all simulators and scenes; with NAME, show one in detail: options, determinism levels, and whether "
        "each level has an effect on this machine",
    )
    p.add_argument("--setup", metavar="NAME", help="install a simulator in a Python environment of its own")
    p.add_argument(
        "--python",
        type=Path,
        metavar="PATH",
        help="Python interpreter or virtual environment for the runs (or for --setup)",
    )
    p.add_argument("--json", action="store_true", help="print results (or the list) as JSON on standard output")
    _add_run(p)
    _add_recorded(p)
    _add_where(p)
    _add_trials(p)
    p.show_first(
        "--list", "--setup", "--sim", "--scene", "--n-env", "--runs", "--option", "--determinism", "--phases",
        "--steps", "--out", "--replay",
    )  # fmt: skip
    return p


def _add_run(p: RecordParser) -> None:
    take = partial(p.take, p.add_argument_group("what is run"))
    _add_scene(take)
    _add_settings(take)
    _add_states(take)
    take(
        "--determinism",
        metavar="LEVEL",
        help="determinism level of the engine; see --list NAME (default: default, the engine as it ships)",
        simulated="default",
    )
    take(
        "--timeout",
        type=float,
        metavar="S",
        help="end each run after this time [s] (default: 0, never)",
        simulated=0.0,
        replayed=0.0,
    )


def _add_scene(take: Callable[..., None]) -> None:
    take("--sim", metavar="NAME", help="simulator (see --list), or 'real' for measured trials")
    take("--replay", type=Path, metavar="FILE", help="repeat the run of a recording")
    take("--scene", metavar="NAME", help=f"scene; see --list (default: {SCENE})", simulated=None, measured=SCENE)
    take(
        "--model",
        type=Path,
        metavar="FILE.xml",
        help="instead of --scene: a model file of your own, MJCF or URDF, with the files that it refers to; the "
        "recording carries them",
        simulated=None,
    )
    take(
        "--actions",
        metavar="none|random[:SPREAD]|keyframe|FILE.npz",
        help="with --model: controls of the actuators. random draws each control anew at each step, uniformly within "
        "its range (SPREAD: the share of the range, about its middle); keyframe holds those of the keyframe; FILE.npz "
        "has controls [step, actuator], or [step, env, actuator] (default: random, if the model has actuators)",
        simulated="",
    )
    take(
        "--keyframe",
        metavar="NAME",
        help="with --model: the keyframe that environments begin in, or none for the model's reference state "
        "(default: the model's first keyframe, if it has one)",
        simulated="",
    )
    take(
        "--allow-model",
        action="store_true",
        default=None,
        help="with --replay: load the model files that the recording carries; they are a stranger's input to the "
        "engine's parser",
        replayed=False,
    )


def _add_settings(take: Callable[..., None]) -> None:
    take(
        "--n-env",
        type=int,
        metavar="N",
        help=f"number of environments (default: {N_ENV}; of cube-toss: one per toss)",
        simulated=None,
    )
    take(
        "--sweep",
        metavar="A..B[:F]",
        help="instead of --n-env: record A, A*F, A*F*F... and B environments, powers of two (F: 2)",
        simulated=None,
    )
    take(
        "--runs",
        type=int,
        metavar="R",
        help="independent runs (default: {simulated}; of --replay: {replayed})",
        simulated=10,
        replayed=1,
    )
    take("--dt", type=float, metavar="S", help="time step [s] (default: the scene's, such as 0.01)", simulated=None)
    take(
        "--seed",
        type=int,
        metavar="N",
        help="seed of random numbers, the same in every run (default: {simulated})",
        simulated=0,
    )
    take(
        "--option",
        action="append",
        metavar="NAME=VALUE",
        help="option of the simulator; repeatable",
        simulated=(),
        replayed=(),
    )
    for name, meaning in SHORTHANDS.items():
        take(
            f"--{name}",
            action="append",
            metavar="X",
            help=f"{meaning}: short for --option {name}=X",
            simulated=(),
            replayed=(),
        )
    take(
        "--fitted",
        action="append",
        metavar="NAME=DATA",
        help="state that the value of this --option was fitted, and to what, such as solref=even tosses; repeatable "
        "(default: nothing was fitted)",
        simulated=(),
    )


def _add_states(take: Callable[..., None]) -> None:
    take(
        "--initial",
        metavar="random:SPREAD|FILE",
        help="initial states. random:SPREAD gives each environment velocities of bodies [m/s] and joint angles [rad] "
        "drawn within +-SPREAD of the scene's. FILE.mcap or FILE.mcap@STEP takes positions and velocities from a step "
        "of a recording (default: its first), also of another simulator. FILE.npz has arrays named GROUP/FIELD "
        "(default: the scene's initial state in all environments)",
        simulated="",
    )
    take(
        "--vary",
        metavar="NAME:SPREAD[,NAME:SPREAD]",
        help="parameters that differ from environment to environment: mass:0.1,friction:0.2,size:0.05 multiplies each "
        "moving body's by a factor of its own in each environment, drawn within 1+-SPREAD (default: none)",
        simulated="",
    )
    take(
        "--tosses",
        type=Path,
        metavar="PATH",
        help="measured tosses for scene cube-toss: a folder of .pt files as published by ContactNets, or an .npz file. "
        "Each environment begins as one toss; --sim real records the tosses themselves (default: $GSB_CUBE_TOSS, or "
        "else a synthetic set)",
        simulated=None,
        measured=None,
    )
    take(
        "--intervene",
        metavar="KIND@STEP",
        help="change the state after a captured step. "
        + "; ".join(f"{kind.form} {kind.does}" for kind in KINDS.values())
        + ". gsb-probe uses these, but for teacher, which is for cube-toss: gsb-eval then gives the error after so "
        "many steps (default: none)",
        simulated="",
    )
    take(
        "--from",
        dest="from_step",
        type=int,
        metavar="STEP",
        help="with --replay: begin at the recording's snapshot of this step, and capture the rest",
        replayed=None,
    )


def _add_recorded(p: RecordParser) -> None:
    take = partial(p.take, p.add_argument_group("what is recorded"))
    take(
        "--phases",
        metavar="LIST",
        help="any of timed (throughput), capture (states) and import (what the engine made of a model file, which "
        "gsb-import uses) (default: {simulated}; --replay: as recorded)",
        simulated=",".join(USUAL_PHASES),
        replayed=None,
    )
    take(
        "--steps",
        type=int,
        metavar="N",
        help="number of captured steps (default: 5 s of simulated time)",
        simulated=None,
    )
    take("--stride", type=int, metavar="K", help="record every K-th state (default: {simulated})", simulated=1)
    take(
        "--snapshot",
        metavar="STEP[,STEP...]",
        help="save the engine's complete state after these captured steps; --replay FILE --from STEP continues there "
        "(default: none)",
        simulated="",
    )
    take(
        "--capture",
        choices=CAPTURE_MODES,
        help="lossless: write while stepping, and wait if the disk is slower; memory: write after the last step "
        "(default: {simulated})",
        simulated=CAPTURE_MODES[0],
    )
    take(
        "--keep",
        metavar="failing[,within:M]",
        help="write only the states from 100 steps before to 10 steps after a failure, of the first 16 environments "
        "that fail. An environment fails if its state is not finite, a buffer overflows, or a body is further than M "
        "metres from the environment's origin along an axis (default: all states of all environments)",
        simulated="",
    )
    take(
        "--view-env",
        type=int,
        action="append",
        metavar="E",
        help="environment that viewers such as Foxglove and rerun show; repeatable, up to 4 times (default: 0)",
        simulated=(),
        replayed=(),
    )
    take(
        "--no-view",
        action="store_true",
        default=None,
        help="write nothing for viewers",
        simulated=False,
        replayed=False,
    )
    take(
        "--warmup",
        type=int,
        metavar="N",
        help="untimed steps first (default: 100; of cube-toss: 10)",
        simulated=None,
    )
    take(
        "--timed-steps",
        type=int,
        metavar="N",
        help="number of timed steps; 100 and more are timed again, from the initial states on, until they took 1 s "
        "together (default: 1000; of cube-toss: 100)",
        simulated=None,
    )
    take(
        "--compression",
        choices=("none", "lz4", "zstd"),
        default="none",
        help="compression of the recordings (default: none)",
    )
    take(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder of the recordings (default: {OUT}/; of --replay: {OUT_OF_REPLAYS}/)",
    )


def _add_where(p: RecordParser) -> None:
    take = partial(p.take, p.add_argument_group("where it is run"))
    take(
        "--ray",
        metavar="ADDRESS",
        help="make the runs on a Ray cluster (HOST:PORT or auto), or on all GPUs of this machine (local)",
        simulated=None,
        replayed=None,
    )
    take(
        "--ray-resource",
        metavar="NAME",
        help="use only nodes with this Ray resource",
        simulated=None,
        replayed=None,
    )


def _add_trials(p: RecordParser) -> None:
    take = partial(p.take, p.add_argument_group("real trials (--sim real)"))
    take("--trials", type=Path, metavar="CSV", help="positions of the cubes: trial,cube,x,y[,z]", measured=None)
    take("--unit", choices=("m", "cm"), help="unit of the positions in the CSV", measured=None)
    take(
        "--sample-time",
        type=float,
        metavar="S",
        help="time at which the positions were measured [s] (default: 5.0)",
        measured=None,
    )
