"""The arguments of gsb-record: what it takes, and what each is where it is not given."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from gpusimbench.recorder.command.parser import RecordParser, names
from gpusimbench.schemas.commands.command_line import add_common
from gpusimbench.schemas.configuration import CAPTURE_MODES, USUAL_PHASES
from gpusimbench.schemas.treatment import KINDS

_EPILOG = """\
exit codes:
  0  every run is complete; of a sweep, every run below its last point, and at least one run
  1  a run failed or is INVALID (its recording gives the reason), or a replay exceeded its limits and was stopped
  2  wrong usage
  3  a run's process died, or the disk was full: data was lost

sweeps:
  --sweep records each number of environments, smallest first, and ends after the first number at which every run fails
  or is INVALID. A sweep searches for this limit, so such a failure does not make the command fail. If the first run of
  a number runs out of memory or of a buffer, is refused or times out, the other runs of this number are skipped.
  To continue a sweep, repeat the command with the same --out: existing recordings are kept. Two commands cannot record
  the same sweep in one folder at once: the second ends with exit code 1 and names the process of the first.

replays:
  --replay FILE repeats the run of a recording on this machine, with the recorded configuration, which is printed first
  and checked like arguments. The scene must be the same. --option (and --impl, --device...) replaces recorded options,
  and the new recording stores that. --runs, --phases, --view-env, --timeout, --python and --out are not taken from the
  recording.
  --replay FILE --from STEP begins at a snapshot that --snapshot STEP saved, and captures the states from there on. The
  engine loads the snapshot unchecked: continue only recordings of people whose code you would run.
  A replay that uses more memory, threads or disk than its recording accounts for is stopped, and its files are deleted.
  gsb-audit FILE replays a recording and compares the results.

clusters:
  --ray ADDRESS makes one run at a time on each GPU of a Ray cluster (on each node, if runs step on the CPU), and copies
  the recordings to --out on this machine. Only machines of one kind are used: the most frequent kind, or the kind with
  the resource --ray-resource. Every node needs this version of the project and the engine; see docs/cluster.md.

environments:
  Engines whose packages conflict with others get a Python environment each. --setup NAME makes the environment, in
  $GSB_ENVIRONMENTS or the user's data folder, from pinned requirements with hashes; later runs of this simulator use
  it. --python PATH uses an environment of your own. torch is installed as pip is configured on this machine.

files:
  OUT/SIM-SCENE-nN-rR-TIME.mcap  run R, begun at TIME (UTC); SIM with its solver and level of determinism
  OUT/NAME.mcap.partial  a run that is being made, or what a crash left of it, for gsb-share recover

see also:
  gsb-eval, which computes what the runs show
  gsb-audit, which replays and compares
  docs/simulators.md
  docs/timing.md

examples:
  gsb-record --list mujoco
  gsb-record --sim mujoco
  gsb-record --sim mujoco --scene free-fall --n-env 64 --runs 3 --out falling/
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
       %(prog)s --list [NAME] [--json]"""


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
        usage=_USAGE,
        epilog=_EPILOG,
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
