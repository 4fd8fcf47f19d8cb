"""gsb-record: run a scene in N environments on a simulator and write one recording per run."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import uuid
from pathlib import Path
from typing import Any

import schemas
from schemas.configuration import OPTIONAL_PHASES, RunConfiguration
from schemas.errors import ExitCode, GsbError, UsageError
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
    what.add_argument("--n-env", type=int, default=16, metavar="N", help="environments (default: %(default)s)")
    what.add_argument("--runs", type=int, default=10, metavar="R", help="independent runs (default: %(default)s)")
    what.add_argument("--dt", type=float, metavar="S", help="step in seconds (default: the scene's, 0.01)")
    what.add_argument("--seed", type=int, default=0, help="default: %(default)s; the same in every run")
    what.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE", help="an option of the simulator; repeatable"
    )

    how = p.add_argument_group("what is recorded")
    how.add_argument(
        "--phases",
        default=",".join(OPTIONAL_PHASES),
        metavar="LIST",
        help="timed (throughput), capture (states) or both (default: %(default)s)",
    )
    how.add_argument("--steps", type=int, metavar="N", help="captured steps (default: 5 s of simulated time)")
    how.add_argument("--stride", type=int, default=1, metavar="K", help="record every K-th state (default: 1)")
    how.add_argument("--warmup", type=int, default=100, metavar="N", help="untimed steps first (default: 100)")
    how.add_argument("--timed-steps", type=int, default=1000, metavar="N", help="default: %(default)s")
    how.add_argument(
        "--compression", choices=("none", "lz4", "zstd"), default="none", help="of the file's chunks (default: none)"
    )
    how.add_argument("--out", type=Path, default=Path("recordings"), metavar="DIR", help="default: %(default)s/")

    real = p.add_argument_group("real trials (--sim real)")
    real.add_argument("--trials", type=Path, metavar="CSV", help="positions of the cubes: trial,cube,x,y[,z]")
    real.add_argument("--unit", choices=("m", "cm"), help="unit of the positions in the CSV")
    real.add_argument("--sample-time", type=float, default=5.0, metavar="S", help="when they were measured (5.0)")
    return p


def configure(arguments: argparse.Namespace) -> RunConfiguration:
    """The configuration that the arguments ask for; UsageError where it cannot be."""
    from recorder.options import parse_options, split_options
    from recorder.plan import check
    from recorder.scenes.registry import make_scene
    from recorder.simulators.registry import find_simulator

    scene = make_scene(arguments.scene)
    dt = scene.dt if arguments.dt is None else arguments.dt
    if not 0 < dt <= 1:
        raise UsageError(f"--dt is a step in seconds, above 0 and at most 1, not {dt}")
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
    from recorder.launch import Interrupted, Result, launch
    from recorder.plan import prepare_folder, recording_path, runs, utc_now
    from recorder.progress import make_progress

    configuration = configure(arguments)
    planned = runs(configuration, arguments.runs)
    prepare_folder(arguments.out)
    title = (
        f"{configuration.simulator}, {configuration.scene}, {configuration.n_env} envs, "
        f"dt {configuration.dt:g} s, {len(planned)} runs"
    )
    results: list[Result] = []
    interrupted = False
    with make_progress(title, len(planned)) as progress:
        for run in planned:
            created = utc_now()
            try:
                result = launch(
                    run,
                    recording_path(arguments.out, run, created),
                    run_id=str(uuid.uuid4()),
                    created=created,
                    argv=argv,
                    progress=lambda phase, done, of, index=run.run_index: progress.update(  # type: ignore[misc]
                        index, phase, done, of
                    ),
                )
            except Interrupted as interruption:
                result, interrupted = interruption.result, True
            results.append(result)
            progress.finish(result)
            if not arguments.json and result.path:
                print(result.path, flush=True)
            if interrupted or result.exit_code == ExitCode.USAGE:
                break
    if arguments.json:
        _print_json({"runs": [_result_json(r) for r in results]})
    if interrupted:
        print(f"interrupted: {len(results)} of {len(planned)} runs were started", file=sys.stderr)
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
    print(json.dumps({"schema_version": 1, **record}, indent=1))


def list_all(as_json: bool) -> int:
    """Print simulators and scenes."""
    from recorder.scenes.registry import SCENES, make_scene
    from recorder.simulators.registry import simulators

    known = [
        {
            "name": entry.name,
            "summary": entry.summary,
            "installed": not entry.missing(),
            "install": entry.install,
        }
        for entry in simulators().values()
    ]
    known.append({"name": REAL, "summary": "measured trials from a CSV file", "installed": True, "install": ""})
    scenes = [{"name": name, "summary": make_scene(name).summary} for name in SCENES]
    if as_json:
        _print_json({"simulators": known, "scenes": scenes})
        return ExitCode.OK
    print("simulators")
    for entry in known:
        state = "installed" if entry["installed"] else f"not installed: {entry['install']}"
        print(f"  {entry['name']:<20} {entry['summary']}\n{'':<23}{state}")
    print("scenes")
    for scene in scenes:
        print(f"  {scene['name']:<20} {scene['summary']}")
    return ExitCode.OK


def main(argv: list[str] | None = None) -> int:
    """Entry point of gsb-record."""
    given = sys.argv[1:] if argv is None else argv
    arguments = parser().parse_args(given)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if arguments.list:
            return list_all(arguments.json)
        if not arguments.sim:
            raise UsageError("say which simulator with --sim NAME; gsb-record --list shows them")
        command = ("gsb-record", *given)
        if arguments.sim == REAL:
            from recorder.real import record_trials

            return record_trials(arguments, command)
        return record(arguments, command)
    except GsbError as error:
        print(f"gsb-record: {error}", file=sys.stderr)
        return int(error.exit_code)
    except KeyboardInterrupt:
        print("gsb-record: interrupted", file=sys.stderr)
        return int(ExitCode.FAILURE)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone; nothing is left to say to it
        return int(ExitCode.FAILURE)


if __name__ == "__main__":
    sys.exit(main())
