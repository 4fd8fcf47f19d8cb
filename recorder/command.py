"""What gsb-record does: its arguments, and from them runs and their recordings."""

from __future__ import annotations

import argparse
import json
import sys
import uuid
from pathlib import Path
from typing import Any

import schemas
from recorder.interruption import shielded
from recorder.output import flush, show
from schemas.configuration import OPTIONAL_PHASES, RunConfiguration
from schemas.errors import ExitCode, UsageError
from schemas.provenance import REAL

_EPILOG = """\
exit codes:
  0  every run is complete
  1  a run failed or is invalid; its recording says why
  2  the command asks for something that cannot be
  3  a run's process died or the disk was full: data was lost

examples:
  gsb-record --sim mujoco
  gsb-record --sim mujoco --scene free-fall --n-env 64 --runs 3 --out recordings/
  gsb-record --sim mujoco --option cone=pyramidal --option integrator=Euler
  gsb-record --sim real --trials trials.csv --unit cm
"""


_SIMULATED: dict[str, Any] = {
    "n_env": 16,
    "runs": 10,
    "dt": None,
    "seed": 0,
    "option": (),
    "phases": ",".join(OPTIONAL_PHASES),
    "steps": None,
    "stride": 1,
    "warmup": 100,
    "timed_steps": 1000,
}
"""Arguments that make sense for a simulator only, and what each is where it is not given."""

_MEASURED: dict[str, Any] = {"trials": None, "unit": None, "sample_time": 5.0}
"""The same for real trials."""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = argparse.ArgumentParser(
        prog="gsb-record",
        description="Run a scene in N identical environments on a simulator; write one MCAP recording per run, "
        "each run in a fresh process.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--version", action="version", version=f"gpusimbench {schemas.__version__}")
    p.add_argument("--list", action="store_true", help="show simulators, whether they are installed, and scenes")
    p.add_argument("--json", action="store_true", help="print results (or the list) as JSON on standard output")

    what = p.add_argument_group("what is run")
    what.add_argument("--sim", metavar="NAME", help="simulator (see --list), or 'real' for measured trials")
    what.add_argument("--scene", default="inclined-collision", metavar="NAME", help="default: %(default)s")
    what.add_argument("--n-env", type=int, metavar="N", help=f"environments (default: {_SIMULATED['n_env']})")
    what.add_argument("--runs", type=int, metavar="R", help=f"independent runs (default: {_SIMULATED['runs']})")
    what.add_argument("--dt", type=float, metavar="S", help="step in seconds (default: the scene's, such as 0.01)")
    what.add_argument("--seed", type=int, help=f"default: {_SIMULATED['seed']}; the same in every run")
    what.add_argument("--option", action="append", metavar="NAME=VALUE", help="an option of the simulator; repeatable")

    how = p.add_argument_group("what is recorded")
    how.add_argument(
        "--phases",
        metavar="LIST",
        help=f"timed (throughput), capture (states) or both (default: {_SIMULATED['phases']})",
    )
    how.add_argument("--steps", type=int, metavar="N", help="captured steps (default: 5 s of simulated time)")
    how.add_argument(
        "--stride", type=int, metavar="K", help=f"record every K-th state (default: {_SIMULATED['stride']})"
    )
    how.add_argument("--warmup", type=int, metavar="N", help=f"untimed steps first (default: {_SIMULATED['warmup']})")
    how.add_argument("--timed-steps", type=int, metavar="N", help=f"default: {_SIMULATED['timed_steps']}")
    how.add_argument(
        "--compression", choices=("none", "lz4", "zstd"), default="none", help="of the file's chunks (default: none)"
    )
    how.add_argument("--out", type=Path, default=Path("recordings"), metavar="DIR", help="default: %(default)s/")

    real = p.add_argument_group("real trials (--sim real)")
    real.add_argument("--trials", type=Path, metavar="CSV", help="positions of the cubes: trial,cube,x,y[,z]")
    real.add_argument("--unit", choices=("m", "cm"), help="unit of the positions in the CSV")
    real.add_argument(
        "--sample-time", type=float, metavar="S", help=f"when they were measured ({_MEASURED['sample_time']})"
    )
    return p


def configure(arguments: argparse.Namespace) -> RunConfiguration:
    """The configuration that the arguments ask for; UsageError where it cannot be."""
    with shielded():  # an import that is interrupted shows as one that is broken
        from recorder.options import parse_options, split_options
        from recorder.plan import check, check_dt
        from recorder.scenes.registry import make_scene
        from recorder.simulators.registry import find_simulator

    scene = make_scene(arguments.scene)
    dt = scene.dt if arguments.dt is None else arguments.dt
    check_dt(dt)
    configuration = RunConfiguration(
        simulator=arguments.sim,
        scene=arguments.scene,
        n_env=arguments.n_env,
        dt=dt,
        steps=round(scene.sample_time / dt) if arguments.steps is None else arguments.steps,
        stride=arguments.stride,
        warmup=arguments.warmup,
        timed_steps=arguments.timed_steps,
        phases=tuple(name.strip() for name in arguments.phases.split(",") if name.strip()),
        seed=arguments.seed,
        compression=arguments.compression,
        options=split_options(arguments.option),
    )
    check(configuration)
    adapter = find_simulator(arguments.sim).load()
    parse_options(arguments.sim, adapter.Options, configuration.options)
    return configuration


def record(arguments: argparse.Namespace, argv: tuple[str, ...]) -> int:
    """Make all runs; returns the exit code."""
    with shielded():
        from recorder.launch import Interruptions, Result, launch
        from recorder.plan import prepare_folder, reserve, runs, utc_now
        from recorder.progress import make_progress

    configuration = configure(arguments)
    planned = runs(configuration, arguments.runs)
    prepare_folder(arguments.out)
    title = (
        f"{configuration.simulator}, {configuration.scene}, {configuration.n_env} envs, "
        f"dt {configuration.dt:g} s, {len(planned)} runs"
    )
    results: list[Result] = []
    with Interruptions() as interruptions, make_progress(title, len(planned)) as progress:
        for run in planned:
            created = utc_now()
            result = launch(
                run,
                reserve(arguments.out, run, created),
                run_id=str(uuid.uuid4()),
                created=created,
                argv=argv,
                progress=lambda phase, done, of, index=run.run_index: progress.update(  # type: ignore[misc]
                    index, phase, done, of
                ),
                interruptions=interruptions,
            )
            results.append(result)
            progress.finish(result)
            if not arguments.json and result.path:
                progress.path(result.path)
            if interruptions.count or result.exit_code == ExitCode.USAGE:
                break
    if arguments.json:
        _print_json({"runs": [_result_json(r) for r in results]})
    if interruptions.count:
        print_error(f"interrupted: {len(results)} of {len(planned)} runs were started")
        return int(max(ExitCode.FAILURE, *(r.exit_code for r in results)))
    return int(max(r.exit_code for r in results))


def _result_json(result: Any) -> dict[str, Any]:
    return {
        "run": result.run_index,
        "file": str(result.path) if result.path else None,
        "status": result.status,
        "reason": result.reason,
    }


def _print_json(record: dict[str, Any]) -> None:
    show(json.dumps({"schema_version": 1, **record}, indent=1))


def list_all(as_json: bool) -> int:
    """Print simulators, what each of them can do, and scenes."""
    with shielded():
        from recorder.scenes.registry import SCENES, make_scene
        from recorder.simulators.registry import simulators

    known: list[dict[str, Any]] = [
        {
            "name": entry.name,
            "summary": entry.summary,
            "installed": not entry.missing(),
            "install": entry.install,
            "devices": list(entry.devices),
            "precision": list(entry.precision),
            "scenes": list(entry.scenes),
        }
        for entry in simulators().values()
    ]
    measurable = [name for name in SCENES if "cubes" in make_scene(name).groups()]
    known.append(
        {
            "name": REAL,
            "summary": "measured trials from a CSV file",
            "installed": True,
            "install": "",
            "devices": [],
            "precision": ["float64"],
            "scenes": measurable,
        }
    )
    scenes = [{"name": name, "summary": make_scene(name).summary} for name in SCENES]
    if as_json:
        _print_json({"simulators": known, "scenes": scenes})
        return ExitCode.OK
    lines = ["simulators"]
    for entry in known:
        lines.append(f"  {entry['name']:<20} {entry['summary']}")
        state = "installed" if entry["installed"] else f"not installed: {entry['install']}"
        can = (f"{what}: {', '.join(entry[what])}" for what in ("devices", "precision", "scenes") if entry[what])
        lines += [f"{'':<23}{line}" for line in (state, *can)]
    lines.append("scenes")
    lines += [f"  {scene['name']:<20} {scene['summary']}" for scene in scenes]
    show("\n".join(lines))
    return ExitCode.OK


def run(given: list[str]) -> int:
    """Do what the arguments say; returns the exit code. Errors as of schemas.errors."""
    try:
        arguments = parser().parse_args(given)
    except SystemExit:
        flush()  # --help and --version only write to a buffer, and an error there would come too late
        raise
    if arguments.list:
        return list_all(arguments.json)
    if not arguments.sim:
        raise UsageError("say which simulator with --sim NAME; gsb-record --list shows them")
    _fill(arguments)
    # Text that is no Unicode (a path in another encoding) cannot be stored as it is.
    command = ("gsb-record", *(text.encode("utf-8", "backslashreplace").decode() for text in given))
    if arguments.sim == REAL:
        with shielded():
            from recorder.real import record_trials

        return record_trials(arguments, command)
    return record(arguments, command)


def _fill(arguments: argparse.Namespace) -> None:
    # what was not given gets its default; what was given and would be ignored is refused
    own, others = (_MEASURED, _SIMULATED) if arguments.sim == REAL else (_SIMULATED, _MEASURED)
    for name in others:
        if getattr(arguments, name) is not None:
            kind = "a simulator" if arguments.sim == REAL else f"--sim {REAL}"
            raise UsageError(f"--{name.replace('_', '-')} is for {kind}; --sim {arguments.sim} has no use for it")
    for name, default in own.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)


def print_error(text: str) -> None:
    """One line on standard error."""
    sys.stderr.write(text + "\n")
