"""The simulated time at which positions are compared, where the user names none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable, read_all
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.read.addresses import Stamp
from gpusimbench.evaluator.runs.positions import joint_fields, positional
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.location import Place


@dataclass(frozen=True)
class Sampled:
    """Files as they were read, and the times at which their positions were sampled.

    files    by place
    time     of every scene that is not in `shorter` [s]
    shorter  by scene, the time of those that have another [s]: the one that the scene names, where a recording has it,
             else the last that all of its recordings have
    """

    files: Mapping[Place, Run | Unreadable]
    time: float
    shorter: Mapping[str, float] = field(default_factory=dict)


def notes_on(shorter: Mapping[str, float], time: float, runs: Sequence[Run]) -> list[str]:
    """What is to be said of each scene that is compared at another time than `time` [s]; see Sampled."""
    return [
        f"{scene}: {_what_is_compared(ours)} are compared at {at:.4g} s, {_why_then(at, time, ours)}"
        for scene, at in shorter.items()
        for ours in [[run for run in runs if _scene(run) == scene]]
    ]


def _what_is_compared(runs: Sequence[Run]) -> str:
    joints = any(joint_fields(run.fields) for run in runs)
    if not joints:
        return "positions"
    return "positions and joints" if any(positional(run.fields) for run in runs) else "joints"


def _why_then(at: float, time: float, runs: Sequence[Run]) -> str:
    if any(run.named_time == at for run in runs):
        return "the sample time of the scene"
    whose = (
        "all its recordings"
        if last_common_time([r for r in runs if r.usable]) == at
        else "the recordings of all scenes"
    )
    last = f"the last time that {whose} have"
    if any(run.named_time is not None for run in runs):
        return f"{last}; none has {time:g} s"
    return f"{last}; scene.json names no sample time"


def read_sampled(places: Sequence[Place], reader: Reader, work: Work, *, together: bool = False) -> Sampled:
    """Read files, and those of scenes with another sample time than the reader's at that one, if it says so.

    together  sample all scenes at one time, since they are compared with each other
    """
    places = list(dict.fromkeys(places))
    files = dict(zip(places, read_all(places, reader, work), strict=True))
    runs = [file for file in files.values() if isinstance(file, Run)]
    others = _others(runs, reader.time, together=together) if reader.sample_time is None else {}
    for time in set(others.values()):
        again = [
            place
            for place, file in files.items()
            if isinstance(file, Run) and file.usable and others.get(_scene(file)) == time
        ]
        read = [(place, files[place]) for place in again]
        stamps = {place: file.stamp for place, file in read if isinstance(file, Run) and isinstance(file.stamp, Stamp)}
        anew = replace(reader, sample_time=time, verified=stamps)  # each was verified, if at all, a moment ago
        files.update(zip(again, read_all(again, anew, work), strict=True))
    return Sampled(files, reader.time, others)


def _others(runs: Sequence[Run], time: float, *, together: bool) -> dict[str, float]:
    """By scene, the sample time where it is not `time` [s]."""
    # arrays of a task have no positions, and so no time at which these are compared
    bodies = [run for run in runs if any(field.group != ENV for field in run.fields) or not run.fields]
    with_states = [run for run in bodies if run.usable and (run.reached or run.histories)]
    found = {}
    for scene in dict.fromkeys(map(_scene, with_states)):
        of_scene = [run for run in with_states if together or _scene(run) == scene]
        wanted = _named_by_scene(of_scene) or last_common_time(of_scene)
        if wanted is not None and wanted != time:
            found[scene] = wanted
    return found


def _named_by_scene(runs: Sequence[Run]) -> float | None:
    """The time that the scene names, where all of its recordings name the same, and one of them has it [s]."""
    named = {run.named_time for run in runs}
    (time,) = named if len(named) == 1 else (None,)
    return time if time is not None and any(_has(run, time) for run in runs) else None


def _has(run: Run, time: float) -> bool:
    if not run.histories:  # measured trials have no hashes, and one time
        return run.reached
    step = sampling_step(time, run.configuration.dt)
    return step % run.configuration.stride == 0 and step in run.histories.steps


def _scene(run: Run) -> str:
    return run.configuration.scene


def last_common_time(runs: Sequence[Run]) -> float | None:
    """The last simulated time whose nearest step every one of these runs has recorded [s]; None where there is none."""
    recorded = {(run.configuration.dt, tuple(run.histories.steps.tolist())) for run in runs if run.histories}
    if not recorded:
        return None
    dt, steps = min(recorded, key=lambda one: one[0] * one[1][-1])
    others = [(other_dt, frozenset(other)) for other_dt, other in recorded]
    for step in reversed(steps):
        time = float(np.round(step * dt, 9))
        if step > 0 and all(sampling_step(time, other_dt) in other for other_dt, other in others):
            return time
    return None
