"""The simulated time at which positions are compared, where the user names none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.runs.known_files import read_all
from gpusimbench.evaluator.runs.reader import Reader, Unreadable
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.location import Place

DEFAULT_S = 5.0
"""Of every scene whose recordings are that long [s]."""


@dataclass(frozen=True)
class Sampled:
    """Files as they were read, and the times at which their positions were sampled.

    files    in the order in which they were asked for
    time     of every scene that is not in `shorter` [s]
    shorter  by scene, the last time that all of its recordings have, where none of them reaches `time` [s]
    """

    files: tuple[Run | Unreadable, ...]
    time: float
    shorter: Mapping[str, float] = field(default_factory=dict)


def notes_on(shorter: Mapping[str, float], time: float) -> list[str]:
    """What is to be said of each scene whose recordings all end before a time [s]; see Sampled."""
    return [
        f"{scene}: positions are compared at {at:.4g} s, the last time that all its recordings have; "
        f"none has {time:g} s"
        for scene, at in shorter.items()
    ]


def read_sampled(places: Sequence[Place], reader: Reader, work: Work, *, chosen: bool) -> Sampled:
    """Read files, and those of scenes whose recordings all end before the reader's sample time at one that they have.

    chosen  the user has named the reader's sample time, and no other is taken
    """
    files = dict(zip(places, read_all(places, reader, work), strict=True))
    shorter = {} if chosen else _shorter([file for file in files.values() if isinstance(file, Run)])
    for time in set(shorter.values()):
        again = [
            place
            for place, file in files.items()
            if isinstance(file, Run) and file.usable and shorter.get(file.configuration.scene) == time
        ]
        files.update(zip(again, read_all(again, replace(reader, sample_time=time), work), strict=True))
    return Sampled(tuple(files[place] for place in places), reader.sample_time, shorter)


def _shorter(runs: Sequence[Run]) -> dict[str, float]:
    with_states = [run for run in runs if run.usable and (run.reached or run.histories)]
    scenes = dict.fromkeys(run.configuration.scene for run in with_states)
    found = {}
    for scene in scenes:
        of_scene = [run for run in with_states if run.configuration.scene == scene]
        if not any(run.reached for run in of_scene) and (time := last_common_time(of_scene)):
            found[scene] = time
    return found


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
