"""What is done to the state of environments on the way, where a run was asked for it.

Among it is teacher forcing: environments are set to measured states again and again, so that errors cannot grow
meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run.given_actions import prepare
from gpusimbench.recorder.run.start import states_of
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.snapshot import Claim, Extent, StateClaims
from gpusimbench.schemas import arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.treatment import KINDS, TEACHER, Intervention


@dataclass(frozen=True)
class Asked:
    """What an intervention is done to: a simulator between two steps of a capture of these fields.

    envs  that it treats
    """

    simulator: Simulator
    fields: tuple[StateField, ...]
    intervention: Intervention
    configuration: RunConfiguration

    @property
    def envs(self) -> NDArray[np.int64]:
        return np.array(self.intervention.treated(self.simulator.n_env), dtype=np.int64)


def _reset(asked: Asked) -> None:
    asked.simulator.reset(asked.envs)


def _set(asked: Asked) -> None:
    asked.simulator.set_state(_present(asked), asked.envs)


def _poison(asked: Asked) -> None:
    present = _present(asked)
    for layout, array in zip(asked.fields, present, strict=True):
        if layout.field in ("linear_velocity", "qvel"):
            array[:] = np.nan
    asked.simulator.set_state(present, asked.envs)


def _excursion(asked: Asked) -> None:
    simulator, more = asked.simulator, asked.intervention.more
    snapshot = simulator.snapshot()
    prepare(simulator, asked.configuration, asked.intervention.step, more)
    block = simulator.begin_states(more)
    block.wait()
    block.release()
    simulator.restore(snapshot)


def _present(asked: Asked) -> States:
    return tuple(np.array(array)[asked.envs] for array in asked.simulator.state())


DOING: dict[str, tuple[Callable[[StateClaims], Claim], Callable[[Asked], None] | None]] = {
    "poison": (lambda claims: claims.set_state, _poison),
    "reset": (lambda claims: claims.reset, _reset),
    "excursion": (lambda claims: claims.snapshot, _excursion),
    "set": (lambda claims: claims.set_state, _set),
    "teacher": (lambda claims: claims.set_state, None),
}
"""For each of KINDS, the claim on the engine's state that it needs, and what does it; None: Teacher, below."""


def intervene(
    simulator: Simulator,
    fields: tuple[StateField, ...],
    intervention: Intervention,
    configuration: RunConfiguration,
) -> None:
    """Do it, between two steps of a capture of these fields."""
    _, do = DOING[intervention.name]
    if do is not None:
        do(Asked(simulator, fields, intervention, configuration))


def refusal(name: str, adapter: type[Simulator], options: object, text: str) -> str:
    """Why a simulator cannot do what a run is asked to; empty where it can."""
    intervention = Intervention.of(text)
    if intervention is None:
        return ""
    needed, _ = DOING[intervention.name]
    claim = needed(adapter.state_claims(options))
    if claim.extent is not Extent.NONE:
        return ""
    return f"simulator '{name}' cannot do --intervene {text} (it {intervention.kind.does}): {claim.why}"


def parse(text: str) -> str:
    """What --intervene was given, as the recording keeps it. UsageError where it is none."""
    try:
        return str(Intervention.parse(text))
    except ValueError:
        *forms, last = (kind.form for kind in KINDS.values())
        raise UsageError(f"--intervene is {', '.join(forms)} or {last}, not '{text}'") from None


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
