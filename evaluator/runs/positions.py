"""Where the bodies of the outcome are at the sample step, as every positional metric needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.failing import ONLY_FAILING
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.outcome import OutcomeArray, outcome_of
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import REAL


def no_states(recording: Recording) -> Missing:
    """Why a recording has no states."""
    if recording.configuration.keep:
        return Missing(ONLY_FAILING)
    return Missing("no states were recorded (the capture phase was left out or not reached)")


_FAR_M = 1e6  # a body that far away belongs to a simulation that blew up


@dataclass(frozen=True)
class Positions:
    """Positions of the bodies of the outcome at the sample step, kept as recorded: half of what they take in float64.

    recorded  as recorded [m], [env, item, component]
    origins   to be subtracted [m], [env, component]; None where the coordinates are relative to them already
    time      simulated time that was sampled [s]
    """

    recorded: NDArray[Any]
    origins: NDArray[np.float64] | None
    time: float

    @property
    def local(self) -> NDArray[np.float64]:
        """In each env's own frame, float64 [m], [env, item, component]."""
        local = self.recorded.astype(np.float64)
        return local if self.origins is None else local - self.origins[:, None, :]

    @property
    def planar(self) -> NDArray[np.float64]:
        """x and y in each env's own frame, float64 [m], [env, item, 2]."""
        return self.local[..., :2]

    @property
    def spatial(self) -> NDArray[np.float64] | None:
        """x, y and z likewise [m], [env, item, 3]; None where heights were not recorded."""
        return self.local if self.recorded.shape[-1] == 3 else None


def sample_positions(recording: Recording, sample_time: float) -> Positions | Missing:
    """Positions at step round(sample_time / dt), or the reason why there are none; see evaluator.runs.outcome.

    Origins are subtracted behind the recording, in float64, from coordinates of the world frame: before it, that would
    have cost bits. Coordinates that are declared relative to the env's origin already are left as they are.
    """
    fields = outcome_of(recording)
    if isinstance(fields, Missing):
        return fields
    array = OutcomeArray(recording, fields)
    if not len(array):
        return no_states(recording)
    dt = recording.configuration.dt
    step = sampling_step(sample_time, dt)
    if recording.configuration.simulator == REAL and not math.isclose(step * dt, sample_time, rel_tol=1e-6):
        return Missing(f"the trials were measured at {dt:g} s, not at {sample_time:g} s")
    try:
        recorded = array.at_step(step)
    except KeyError:
        last = array.steps[-1]
        return Missing(
            f"step {step} ({sample_time:g} s) was not recorded; recorded are steps {array.steps[0]} to {last} "
            f"({last * dt:g} s)"
        )
    positions = Positions(recorded, _origins(recording, array.field), step * dt)
    planar = positions.planar
    if not np.isfinite(positions.recorded).all():
        return Missing("positions at the sample step are not finite")
    if np.abs(planar).max() > _FAR_M:
        return Missing(f"positions at the sample step are beyond {_FAR_M / 1000:g} km: the simulation blew up")
    return positions


def in_env_frame(
    recording: Recording, field: StateField, recorded: NDArray[Any], envs: slice = slice(None)
) -> NDArray[np.float64]:
    """Positions [..., env, item, component] in each env's own frame [m], float64; DamagedRecording where they are none.

    envs  that the positions are of
    """
    origins = _origins(recording, field)
    local = recorded.astype(np.float64)
    return local if origins is None else local - origins[envs, None, :]


def check_format(recording: Recording, field: StateField) -> None:
    """DamagedRecording where a field of positions has another unit, frame or other components than the format has."""
    if field.unit != "m" or field.frame not in ("world", "env"):
        raise DamagedRecording(
            f"{recording.path}: {field.name} is in {field.unit}, frame {field.frame}: not of this format"
        )
    if field.components not in (("x", "y"), ("x", "y", "z")):
        raise DamagedRecording(f"{recording.path}: {field.name} has the components {', '.join(field.components)}")


def _origins(recording: Recording, field: StateField) -> NDArray[np.float64] | None:
    """What is to be subtracted from a field of positions [m], [env, component]."""
    check_format(recording, field)
    origins = recording.simulation.env_origins if recording.simulation else ()
    if not origins or field.frame != "world":
        return None
    return np.array(origins, dtype=np.float64)[:, : len(field.components)]
