"""The runs of one command: a set of equal ones, or a sweep over n_env."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.plan import prepare_folder, runs
from gpusimbench.recorder.process.cage import Cage
from gpusimbench.recorder.process.launch import Interruptions, Result, make
from gpusimbench.recorder.process.planned_run import PlannedRun, provenance_now
from gpusimbench.recorder.sets.progress import SetProgress, make_progress, say
from gpusimbench.recorder.sets.sweep import Outcome, Outcomes, Sweep, SweepRun
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.provenance import ReplayOf
from gpusimbench.schemas.text import few, plural

if TYPE_CHECKING:
    from gpusimbench.recorder.sets.finished import Finished

Json = dict[str, Any]

_SHOWN = 3  # files, and points at the beginning of a sweep


@dataclass(frozen=True)
class Request:
    """What a command is to make.

    configuration  of its runs; n_env and run_index are set where a run has its own
    out            folder of the recordings
    argv           the user's command
    quiet          print no paths and no summary: the caller prints the results itself
    replay_of      the recording that the runs are replays of
    end_killed     where a run has to be killed after its timeout, write a recording that says so
    cage           what a run may take of the machine; None: anything
    inputs         files that a run is given, by name
    """

    configuration: RunConfiguration
    out: Path
    argv: tuple[str, ...]
    quiet: bool
    replay_of: ReplayOf | None = None
    end_killed: bool = False
    cage: Cage | None = None
    inputs: Mapping[str, bytes] = field(default_factory=dict)

    def planned(self, run: RunConfiguration) -> PlannedRun:
        """One of the runs, to be made now."""
        provenance = provenance_now(run, self.argv, self.replay_of)
        return PlannedRun(provenance, self.end_killed, self.cage, self.inputs)


class Maker(Protocol):
    """Makes runs, here or elsewhere."""

    def where(self) -> str:
        """Machine and software that runs are made with, as of recorder.sets.finished."""

    def make(
        self, request: Request, planned: Sequence[RunConfiguration], progress: SetProgress, interruptions: Interruptions
    ) -> Generator[tuple[RunConfiguration, Result], None, None]:
        """Make the runs and tell how each ended, in the order in which they end, the first of them before all others.

        Once the user interrupts, no further run is begun. Where the iterator is closed early, only recordings of what
        it has told remain.
        """


class Here:
    """Makes runs on this machine, one after another, so that none disturbs another's clocks."""

    def __init__(self, interpreter: Interpreter) -> None:
        """interpreter  that the runs' processes are of"""
        self._interpreter = interpreter

    def where(self) -> str:
        """See Maker.where."""
        with shielded():
            from gpusimbench.recorder.sets.finished import where_am_i

        return where_am_i(self._interpreter)

    def make(
        self, request: Request, planned: Sequence[RunConfiguration], progress: SetProgress, interruptions: Interruptions
    ) -> Generator[tuple[RunConfiguration, Result], None, None]:
        """See Maker.make."""
        for run in planned:

            def report(phase: str, done: int, of: int, index: int = run.run_index) -> None:
                progress.update(index, phase, done, of)

            result = make(request.planned(run), request.out, self._interpreter, report, interruptions)
            progress.finish(result)
            yield run, result
            if interruptions.count:
                return


def record_set(request: Request, count: int, maker: Maker) -> tuple[int, Json]:
    """Make so many equal runs; returns the exit code and the results.

    If the folder holds only a part of the runs, the others are made; if it holds all, it is given a set more. Replays
    are always made.
    """
    planned = runs(request.configuration, count)
    prepare_folder(request.out)
    c = request.configuration
    there = {} if request.replay_of else _part_of_a_set(request, count, maker)
    planned = [run for run in planned if run.run_index not in there]
    title = f"{c.simulator}, {c.scene}, {plural(c.n_env, 'env')}, dt {c.dt:g} s, {plural(count, 'run')}"
    if there:
        title += f", {len(there)} of them in {request.out} already"
    code = ExitCode.OK if all(f.outcome.good for f in there.values()) else ExitCode.FAILURE
    refused = False
    results = [{**_json(f.configuration, f.path, f.outcome), "found": True} for f in there.values()]
    with (
        Interruptions() as interruptions,
        make_progress(title, count, len(there)) as progress,
        closing(maker.make(request, planned, progress, interruptions)) as made,
    ):
        for run, result in made:
            _show(request, result, progress)
            results.append({**_json(run, result.path, _outcome(result)), "found": False})
            code = max(code, result.exit_code)
            refused = result.cause == "REFUSED"
            if refused or result.exit_code == ExitCode.USAGE or result.status == "stopped":  # so would the next
                break
    if refused and (spared := count - len(results)):
        say(f"{spared} of {count} runs are not made: they would be refused as this one was")
    if interruptions.count:
        say(f"interrupted: {len(results)} of {count} runs were started; the same command makes the others")
        code = max(code, ExitCode.FAILURE)
    return int(code), {"runs": sorted(results, key=lambda result: int(result["run"]))}


def _part_of_a_set(request: Request, count: int, maker: Maker) -> dict[int, Finished]:
    # by run: what the folder holds of a set that was cut short; nothing where the set is complete. A refusal ended its
    # set, and the user, who calls again, may have changed its cause.
    with shielded():
        from gpusimbench.recorder.sets.finished import matching, read_folder

    found, _ = read_folder(request.out)
    if not matching(found, request.configuration):
        return {}
    n_env = request.configuration.n_env
    there = {
        place.run_index: run
        for place, run in matching(found, request.configuration, maker.where()).items()
        if place.n_env == n_env and place.run_index < count and run.outcome.cause != "REFUSED"
    }
    return there if len(there) < count else {}


def record_sweep(request: Request, sweep: Sweep, maker: Maker) -> tuple[int, Json]:
    """Make the runs of a sweep that its folder does not hold yet; returns the exit code and the results.

    GsbError where another command makes the same sweep in that folder.
    """
    with shielded():  # nothing that a set of runs needs
        from gpusimbench.recorder.sets.finished import locked

    prepare_folder(request.out)
    where = maker.where()
    with locked(request.out, request.configuration, where):
        return _record_sweep(request, sweep, maker, where)


def _record_sweep(request: Request, sweep: Sweep, maker: Maker, where: str) -> tuple[int, Json]:
    with shielded():
        from gpusimbench.recorder.sets.finished import matching, read_folder
    found, others = read_folder(request.out)
    there = {p: f for p, f in matching(found, request.configuration, where).items() if p in sweep}
    known = {place: f.outcome for place, f in there.items()}
    results = {place: {**_json(f.configuration, f.path, f.outcome), "found": True} for place, f in there.items()}
    codes: dict[int, ExitCode] = {}  # the gravest of the runs that are made here, by n_env
    cut = ""
    _announce(request, sweep, len(there), others)
    with Interruptions() as interruptions:
        while (places := sweep.next_places(known)) and not cut:
            n_env = places[0].n_env
            planned = [replace(request.configuration, n_env=n_env, run_index=place.run_index) for place in places]
            with (
                make_progress(*_heading(sweep, n_env, known)) as progress,
                closing(maker.make(request, planned, progress, interruptions)) as made,
            ):
                for run, result in made:
                    _show(request, result, progress)
                    place = SweepRun(n_env, run.run_index)
                    known[place] = _outcome(result)
                    results[place] = {**_json(run, result.path, known[place]), "found": False}
                    codes[n_env] = max(codes.get(n_env, ExitCode.OK), result.exit_code)
                    cut = cut or _cut(n_env, result, interruptions)
                    if (cut and not interruptions.count) or sweep.cut_short(n_env, known):
                        break
            if interruptions.count:
                cut = _interrupted(n_env)
            if not cut and (spared := sweep.cut_short(n_env, known)):
                say(
                    f"{plural(n_env, 'env')}: {spared} of {sweep.runs} runs are not made: they would fail as the "
                    "first did"
                )
    summary = _summary(sweep, known, cut)
    below = {} if cut else sweep.failed_below_the_last(known)
    if not request.quiet:
        _tell(sweep, summary, below)
    code = ExitCode.OK  # however the last point ended: it is the limit that a sweep is after
    if cut or below or summary["n_env_max"] is None:
        code = max([ExitCode.FAILURE, *codes.values()])
    return int(code), {"sweep": summary, "runs": [results[place] for place in sorted(results)]}


def _show(request: Request, result: Result, progress: SetProgress) -> None:
    if not request.quiet and result.path:
        progress.path(result.path)


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
        return _interrupted(n_env)
    if result.exit_code >= ExitCode.USAGE and not result.died:  # such as a full disk
        return f"given up at {n_env}: {result.reason}"
    return ""


def _interrupted(n_env: int) -> str:
    return f"interrupted at {n_env}; the same command goes on from there"


def _announce(request: Request, sweep: Sweep, there: int, others: dict[Path, str]) -> None:
    c, points = request.configuration, list(map(str, sweep.points))
    shown = points if len(points) <= _SHOWN + 2 else [*points[:_SHOWN], "...", points[-1]]
    say(f"sweep of {c.simulator}, {c.scene}, dt {c.dt:g} s: {' '.join(shown)} envs, {plural(sweep.runs, 'run')} each")
    say(f"{there} of {len(points) * sweep.runs} runs are in {request.out} already")
    if others:
        named = few([f"{path.name} ({why})" for path, why in others.items()], _SHOWN)
        say(f"ignored there, no finished recordings: {named}")


def _heading(sweep: Sweep, n_env: int, known: Outcomes) -> tuple[str, int, int]:
    there = len(sweep.at(n_env, known))
    return (
        plural(n_env, "env") + (f", {there} of {plural(sweep.runs, 'run')} there" if there else ""),
        sweep.runs,
        there,
    )


def _summary(sweep: Sweep, known: dict[SweepRun, Outcome], cut: str) -> Json:
    points = [
        {"n_env": n_env, "n_run": sum(o.good for o in at), "n_recording": len(at)}
        for n_env in sweep.reached(known)
        if (at := sweep.at(n_env, known))
    ]
    return {"n_env_max": sweep.n_env_max(known), "ends": cut or sweep.stopped(known), "points": points}


def _tell(sweep: Sweep, summary: Json, below: dict[int, int]) -> None:
    if below:
        each = ", ".join(f"{count} of {sweep.runs} at {plural(n_env, 'env')}" for n_env, count in below.items())
        say(f"runs failed below the last point: {each}")
    most = summary["n_env_max"]
    say(f"N_env^max {'none' if most is None else most}: {summary['ends']}")
