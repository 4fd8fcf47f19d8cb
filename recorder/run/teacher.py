"""Teacher forcing: environments are set to measured states again and again, so that errors cannot grow meanwhile."""

from __future__ import annotations

import numpy as np

from gpusimbench.recorder.run.intervention import parse
from gpusimbench.recorder.run.start import states_of
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.treatment import GIVEN, TEACHER, Intervention

_WHOLE = 1e-6  # relative difference at which a step is still a whole part of the time between rows
_FIRST = f"{TEACHER}first"


def rows(text: str, scene: Scene, *, tossed: bool, dt: float, stride: int) -> int:
    """Measured rows between two settings that --intervene asks for; 0 where it asks for none.

    tossed  whether environments begin as tosses
    dt      step [s]
    stride  steps between states that are recorded

    UsageError where there are no measured states, and where a setting would come between two measured rows or two
    recorded states.
    """
    asked = Intervention.parse(parse(text)) if text else None
    if asked is None or not asked.kind.repeats:
        return 0
    if not tossed:
        raise UsageError(
            f"--intervene {text} sets environments to measured tosses: use it with --scene cube-toss, and without "
            "--initial and --sweep"
        )
    per_row = round(scene.dt / dt)
    if per_row < 1 or abs(per_row * dt / scene.dt - 1.0) > _WHOLE:
        raise UsageError(
            f"--intervene {text}: measured rows are {scene.dt:.6g} s apart, and --dt {dt:g} is no whole part of that"
        )
    for steps, what in ((per_row, f"a measured row is {per_row} steps"), (stride, f"--stride is {stride}")):
        if asked.step % steps:
            raise UsageError(f"--intervene {text}: {what}; give a whole multiple of {steps} steps")
    return asked.step // per_row


class Teacher:
    """Sets a simulator to the states that an attachment has for that.

    given  the attachment GIVEN; its arrays are those of schemas.treatment.TEACHER

    UsageError where it has none, or where they contradict each other.
    """

    def __init__(self, given: bytes | None, simulator: Simulator, description: Description) -> None:
        found = {} if given is None else arrays.decode(GIVEN, given)
        first = found.get(_FIRST)
        self._rows = {
            name.removeprefix(TEACHER): array
            for name, array in found.items()
            if name.startswith(TEACHER) and name != _FIRST
        }
        if first is None or not self._rows:
            raise UsageError(f"the run is to be set to measured states, and {GIVEN} has none")
        count = len(next(iter(self._rows.values())))
        ends = first.tolist() if first.ndim == 1 and first.dtype.kind in "iu" else []
        if len(ends) < 2 or ends[0] != 0 or ends[-1] != count or sorted(ends) != ends:
            raise UsageError(f"{_FIRST} of {GIVEN} does not divide {count} rows into tosses")
        if any(len(rows) != count for rows in self._rows.values()):
            raise UsageError(f"arrays of {TEACHER} in {GIVEN} have different numbers of rows")
        toss = np.arange(simulator.n_env) % (len(first) - 1)
        self._begin, self._end = first[:-1][toss], first[1:][toss]
        self._simulator, self._description = simulator, description

    def set(self, number: int) -> None:
        """Set the environments whose toss goes on to its `number`-th row, from 0; the others step on as they are."""
        row = self._begin + number
        envs = np.flatnonzero(row < self._end)
        if not len(envs):
            return
        chosen = np.where(row < self._end, row, row[envs[0]])
        found = {name: rows[chosen] for name, rows in self._rows.items()}
        states = states_of(found, self._simulator, self._description)
        self._simulator.set_state(tuple(array[envs] for array in states), envs)
