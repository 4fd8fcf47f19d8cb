"""The runs of one command, one process after another: a set of equal ones, or a sweep over n_env."""

from __future__ import annotations

import uuid
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from recorder.environments.interpreter import Interpreter
from recorder.interruption import shielded
from recorder.launch import Interruptions, Result, launch
from recorder.plan import prepare_folder, reserve, runs, utc_now
from recorder.progress import Progress, make_progress, say
from recorder.sweep import Outcome, Outcomes, Place, Sweep
from schemas.configuration import RunConfiguration
from schemas.errors import ExitCode
from schemas.provenance import ReplayOf

Json = dict[str, Any]

_SHOWN = 3  # files, and points at the beginning of a sweep


@dataclass(frozen=True)
class Request:
    """What a command is to make.

    configuration  of its runs; n_env and run_index are set where a run has its own
    out            folder of the recordings
    argv           the user's command
    quiet          print no paths and no summary: the caller prints the results itself
    interpreter    that the runs' processes are of
    replay_of      the recording that the runs are replays of
    """

    configuration: RunConfiguration
    out: Path
    argv: tuple[str, ...]
    quiet: bool
    interpreter: Interpreter
    replay_of: ReplayOf | None = None


def record_set(request: Request, count: int) -> tuple[int, Json]:
    """Make so many equal runs; returns the exit code and the results."""
    planned = runs(request.configuration, count)
    prepare_folder(request.out)
    c = request.configuration
    title = f"{c.simulator}, {c.scene}, {c.n_env} envs, dt {c.dt:g} s, {count} runs"
    code = ExitCode.OK
    results = []
    with Interruptions() as interruptions, make_progress(title, count) as progress:
        for run in planned:
            result = _make(request, run, progress, interruptions)
            results.append(_json(run, result.path, _outcome(result)))
            code = max(code, result.exit_code)
            if interruptions.count or result.exit_code == ExitCode.USAGE:
                break
    if interruptions.count:
        say(f"interrupted: {len(results)} of {count} runs were started")
        code = max(code, ExitCode.FAILURE)
    return int(code), {"runs": results}


def record_sweep(request: Request, sweep: Sweep) -> tuple[int, Json]:
    """Make the runs of a sweep that its folder does not hold yet; returns the exit code and the results."""
    with shielded():  # the reader of recordings is nothing that a set of runs needs
        from recorder.finished import matching, read_folder, where_am_i

    prepare_folder(request.out)
    found, others = read_folder(request.out)
    where = where_am_i(request.interpreter)
    there = {place: f for place, f in matching(found, request.configuration, where).items() if place in sweep}
    known = {place: f.outcome for place, f in there.items()}
    results = {place: {**_json(f.configuration, f.path, f.outcome), "found": True} for place, f in there.items()}
    codes: dict[int, ExitCode] = {}  # the gravest of the runs that are made here, by n_env
    cut = ""
    _announce(request, sweep, len(there), others)
    with Interruptions() as interruptions:
        while (place := sweep.next_place(known)) and not cut:
            n_env = place.n_env
            with make_progress(*_heading(sweep, n_env, known)) as progress:
                while place and place.n_env == n_env and not cut:
                    run = replace(request.configuration, n_env=n_env, run_index=place.run_index)
                    result = _make(request, run, progress, interruptions, end_killed=True)
                    known[place] = _outcome(result)
                    results[place] = {**_json(run, result.path, known[place]), "found": False}
                    codes[n_env] = max(codes.get(n_env, ExitCode.OK), result.exit_code)
                    cut = _cut(n_env, result, interruptions)
                    place = sweep.next_place(known)
            if not cut and (spared := sweep.cut_short(n_env, known)):
                say(f"{n_env} envs: {spared} of {sweep.runs} runs are not made: they would fail as the first did")
    summary = _summary(sweep, known, cut)
    below = {} if cut else sweep.failed_below_the_last(known)
    if not request.quiet:
        _tell(sweep, summary, below)
    code = ExitCode.OK  # however the last point ended: it is the limit that a sweep is after
    if cut or below or summary["n_env_max"] is None:
        code = max([ExitCode.FAILURE, *codes.values()])
    return int(code), {"sweep": summary, "runs": [results[place] for place in sorted(results)]}


def _make(
    request: Request,
    run: RunConfiguration,
    progress: Progress,
    interruptions: Interruptions,
    *,
    end_killed: bool = False,
) -> Result:
    # end_killed: a run that had to be killed after its timeout gets a recording that says so
    created, run_id = utc_now(), str(uuid.uuid4())
    result = launch(
        run,
        reserve(request.out, run, created),
        run_id=run_id,
        created=created,
        argv=request.argv,
        interpreter=request.interpreter,
        progress=lambda phase, done, of: progress.update(run.run_index, phase, done, of),
        interruptions=interruptions,
        replay_of=request.replay_of,
    )
    if end_killed and result.died and result.cause == "TIMEOUT" and not interruptions.count:
        from recorder.killed import record_killed

        path = record_killed(
            request.out, run, result.path, run_id=run_id, created=created, argv=request.argv,
            interpreter=request.interpreter, reason=result.reason,
        )  # fmt: skip
        result = replace(result, status="failed", path=path, exit_code=ExitCode.FAILURE)
    progress.finish(result)
    if not request.quiet and result.path:
        progress.path(result.path)
    return result


def _outcome(result: Result) -> Outcome:
    return Outcome(result.status, result.cause, result.reason)


def _json(run: RunConfiguration, path: Path | None, outcome: Outcome) -> Json:
    return {
        "run": run.run_index,
        "n_env": run.n_env,
        "file": str(path) if path else None,
        "status": outcome.status,
        "reason": outcome.reason,
        "cause": outcome.cause,
    }


def _cut(n_env: int, result: Result, interruptions: Interruptions) -> str:
    # why no further run of a sweep can be made; empty where one can
    if interruptions.count:
        return f"interrupted at {n_env}; the same command goes on from there"
    if result.exit_code >= ExitCode.USAGE and not result.died:  # such as a full disk
        return f"given up at {n_env}: {result.reason}"
    return ""


def _announce(request: Request, sweep: Sweep, there: int, others: dict[Path, str]) -> None:
    c, points = request.configuration, list(map(str, sweep.points))
    shown = points if len(points) <= _SHOWN + 2 else [*points[:_SHOWN], "...", points[-1]]
    say(f"sweep of {c.simulator}, {c.scene}, dt {c.dt:g} s: {' '.join(shown)} envs, {sweep.runs} runs each")
    say(f"{there} of {len(points) * sweep.runs} runs are in {request.out} already")
    if others:
        few = [f"{path.name} ({why})" for path, why in list(others.items())[:_SHOWN]]
        more = f" and {len(others) - len(few)} more" if len(others) > len(few) else ""
        say(f"ignored there, no finished recordings: {', '.join(few)}{more}")


def _heading(sweep: Sweep, n_env: int, known: Outcomes) -> tuple[str, int, int]:
    there = len(sweep.at(n_env, known))
    return f"{n_env} envs" + (f", {there} of {sweep.runs} runs there" if there else ""), sweep.runs, there


def _summary(sweep: Sweep, known: dict[Place, Outcome], cut: str) -> Json:
    points = [
        {"n_env": n_env, "complete": sum(o.good for o in at), "failed": sum(not o.good for o in at)}
        for n_env in sweep.reached(known)
        if (at := sweep.at(n_env, known))
    ]
    return {"n_env_max": sweep.n_env_max(known), "stopped": cut or sweep.stopped(known), "points": points}


def _tell(sweep: Sweep, summary: Json, below: dict[int, int]) -> None:
    if below:
        each = ", ".join(f"{count} of {sweep.runs} at {n_env} envs" for n_env, count in below.items())
        say(f"runs failed below the last point: {each}")
    most = summary["n_env_max"]
    say(f"N_env^max {'none' if most is None else most}: {summary['stopped']}")
