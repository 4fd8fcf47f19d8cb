"""Actions from a file instead of a generator, and what a run is told of either."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.action_generator import MAX_RANGE, JointTargets, Streams, undrawable
from gpusimbench.schemas.configuration import RunConfiguration


@dataclass(frozen=True)
class GivenControls(JointTargets):
    """Controls from a file, the same for all environments or of each.

    joints        names of the actuators
    lower, upper  least and largest control of each
    each          each environment has its own
    sha256        of the file [hex]
    rows          [step, env or 1, actuator]; the description leaves them out
    """

    unit = "of the actuator"
    meaning = "control of each actuator, held during the step, from a file"

    each: bool
    sha256: str
    rows: NDArray[np.float32] = field(repr=False, compare=False, metadata={"described": False})

    def draw(
        self, seed: int, *, n_env: int, first_step: int, n_step: int, streams: Streams | None = None
    ) -> NDArray[np.float32]:
        """See JointTargets.draw: rows of the file."""
        given = Streams.usual(n_env) if streams is None else streams
        steps = given.steps(first_step, n_step) % np.uint32(len(self.rows))
        return np.ascontiguousarray(self.rows[steps, given.env % np.uint32(self.rows.shape[1])])

    def describe(self, seed: int, streams: Streams) -> str:
        """See JointTargets.describe."""
        steps, envs = self.rows.shape[:2]
        about = {"name": self.name, "joints": self.joints, "sha256": self.sha256, "steps": steps, "envs": envs}
        return json.dumps({"generator": "file", **about, **streams.describe()})


def table(actions: JointTargets) -> NDArray[np.float32] | None:
    """Actions that were given and are not drawn, [step, env or 1, action], to be used row after row, and from the first
    on again after the last; None where they are drawn."""
    return actions.rows if isinstance(actions, GivenControls) else None


def refusal(actions: JointTargets, run: RunConfiguration) -> str:
    """Why a run cannot be given these actions; empty where it can."""
    if not isinstance(actions, GivenControls):
        refused = undrawable(actions)
        return f"actions {actions.name} have {refused}; at most {MAX_RANGE} steps can be drawn" if refused else ""
    steps, envs = actions.rows.shape[:2]
    if actions.each and envs != run.n_env:
        return f"the file of actions has controls of {envs} environments, and --n-env is {run.n_env}"
    if "capture" in run.phases and run.steps > steps:
        return f"the file of actions has controls of {steps} steps, fewer than --steps, {run.steps}"
    return ""
