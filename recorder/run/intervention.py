"""What is done to the state of environments on the way, where a run was asked for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run.given_actions import prepare
from gpusimbench.recorder.simulators.base import Simulator, States
from gpusimbench.recorder.simulators.snapshot import Claim, Extent, StateClaims
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.treatment import KINDS, Intervention


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
"""For each of KINDS, the claim on the engine's state that it needs, and what does it; None: recorder.run.teacher."""


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
