"""What is done to the state of environments on the way, where a run was asked for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run.given_actions import prepare
from gpusimbench.recorder.simulators.base import Simulator, States
from gpusimbench.recorder.simulators.snapshot import Claim, Extent
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.treatment import KINDS, Intervention

_CLAIMS = {
    "reset": "reset", "set": "set_state", "poison": "set_state", "excursion": "snapshot", "teacher": "set_state",
}  # fmt: skip
"""The operation of StateClaims that each kind needs."""


def intervene(
    simulator: Simulator,
    fields: tuple[StateField, ...],
    intervention: Intervention,
    configuration: RunConfiguration,
) -> None:
    """Do it, between two steps of a capture of these fields."""
    every = range(simulator.n_env)
    match intervention.kind:
        case "reset":
            simulator.reset(np.array([env for env in every if intervention.treated(env)]))
        case "set":
            simulator.set_state(tuple(np.array(array) for array in simulator.state()), np.array(every))
        case "poison":
            some = np.array([env for env in every if intervention.treated(env)])
            simulator.set_state(_poisoned(simulator, fields, some), some)
        case "excursion":
            snapshot = simulator.snapshot()
            prepare(simulator, configuration, intervention.step, intervention.more)
            block = simulator.begin_states(intervention.more)
            block.wait()
            block.release()
            simulator.restore(snapshot)


def _poisoned(simulator: Simulator, fields: tuple[StateField, ...], envs: NDArray[np.int64]) -> States:
    present = [np.array(array)[envs] for array in simulator.state()]
    for layout, array in zip(fields, present, strict=True):
        if layout.field in ("linear_velocity", "qvel"):
            array[:] = np.nan
    return tuple(present)


def refusal(name: str, adapter: type[Simulator], options: object, text: str) -> str:
    """Why a simulator cannot do what a run is asked to; empty where it can."""
    if not text:
        return ""
    kind = Intervention.parse(text).kind
    claim: Claim = getattr(adapter.state_claims(options), _CLAIMS[kind])
    if claim.extent is not Extent.NONE:
        return ""
    return f"simulator '{name}' cannot do --intervene {text} ({KINDS[kind]}): {claim.why}"


def parse(text: str) -> str:
    """What --intervene was given, as the recording keeps it. UsageError where it is none."""
    try:
        return str(Intervention.parse(text))
    except ValueError:
        kinds = "reset@STEP, poison@STEP, set@STEP, excursion@STEP+MORE or teacher@STEPS"
        raise UsageError(f"--intervene is {kinds}, not '{text}'") from None
