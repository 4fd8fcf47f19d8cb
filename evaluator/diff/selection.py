"""A side of a comparison: some environments of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.result import Contacts, Side
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import engine_name


@dataclass(frozen=True)
class Selection:
    """A recording and those of its environments that are compared, in order."""

    recording: Recording
    envs: range

    @property
    def slice(self) -> slice:
        """The environments as a slice."""
        return slice(self.envs.start, self.envs.stop)

    def side(self) -> Side:
        """The side as results describe it."""
        r = self.recording
        version = r.simulation.version if r.simulation else ""
        label = f"{engine_name(r.configuration.simulator, r.simulation)} {version}".strip()
        return Side(r.path, r.provenance.run_id, label, r.configuration.dt, self.envs, r.status, lost(r))

    def offsets(self, field: StateField) -> NDArray[np.float64]:
        """What the environments' origins add to the recorded positions of a field [m], shape [env, 3]."""
        origins = self.recording.simulation.env_origins if self.recording.simulation else ()
        if not origins or field.field != "position" or field.frame != "world":
            return np.zeros((len(self.envs), 3))
        return np.array(origins[self.slice], dtype=np.float64)

    def contacts(self, phase: str, step: int) -> Contacts | None:
        """The counter of contacts at a step, over all environments of the recording; None where it has none."""
        counted = self.recording.counts.get(phase, {}).get("contacts")
        at = np.flatnonzero(counted.steps == step) if counted else np.empty(0)
        if counted is None or not at.size:
            return None
        return Contacts(float(counted.mean[at[0]]), float(counted.max[at[0]]))


def one_env(recording: Recording, env: int) -> Selection:
    """One environment; UsageError where it is not there."""
    if not 0 <= env < recording.configuration.n_env:
        last = recording.configuration.n_env - 1
        raise UsageError(f"{recording.path} has no environment {env}: it has 0 to {last}")
    return Selection(recording, range(env, env + 1))


def lost(recording: Recording) -> tuple[str, ...]:
    """One sentence for each thing that a recording should hold and does not."""
    found = [f"{recording.path}: lost data: {sentence}" for sentence in recording.dropouts]
    if recording.status == "incomplete":
        found.append(f"{recording.path}: {recording.reason}")
    return tuple(found)
