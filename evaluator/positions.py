"""Where the cubes are at the sample step, as every positional metric needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.metrics.variability import sampling_step
from evaluator.recording import Recording
from schemas.errors import DamagedRecording
from schemas.fields import StateField
from schemas.provenance import REAL

GROUP = "cubes"

_FAR_M = 1e6  # a cube that far away belongs to a simulation that blew up


@dataclass(frozen=True)
class Positions:
    """Positions of the cubes at the sample step.

    recorded  as recorded, [env, item, component]
    planar    x and y in each env's own frame, float64 [m], [env, item, 2]
    spatial   x, y and z likewise [m], [env, item, 3]; None where heights were not recorded
    time      simulated time that was sampled [s]
    """

    recorded: NDArray[Any]
    planar: NDArray[np.float64]
    spatial: NDArray[np.float64] | None
    time: float


def sample_positions(recording: Recording, sample_time: float) -> tuple[Positions | None, str]:
    """Positions at step round(sample_time / dt), or None and the reason why there are none.

    Origins are subtracted here, in float64, from coordinates of the world frame: before recording it would have cost
    bits. Coordinates that are declared relative to the env's origin already are left as they are.
    """
    field = next((f for f in recording.fields if f.name == f"{GROUP}/position"), None)
    if field is None:
        return None, f"no positions of {GROUP} were recorded"
    array = recording.state(GROUP, "position")
    if not len(array):
        return None, "no states were recorded (the capture phase was left out or not reached)"
    dt = recording.configuration.dt
    step = sampling_step(sample_time, dt)
    if recording.configuration.simulator == REAL and not math.isclose(step * dt, sample_time, rel_tol=1e-6):
        return None, f"the trials were measured at {dt:g} s, not at {sample_time:g} s"
    try:
        recorded = array.at_step(step)
    except KeyError:
        last = array.steps[-1]
        return None, (
            f"step {step} ({sample_time:g} s) was not recorded; recorded are steps {array.steps[0]} to {last} "
            f"({last * dt:g} s)"
        )
    local = in_env_frame(recording, field, recorded)
    planar, spatial = local[..., :2], local if local.shape[-1] == 3 else None
    if not np.isfinite(planar).all():
        return None, "positions at the sample step are not finite"
    if np.abs(planar).max() > _FAR_M:
        return None, f"positions at the sample step are beyond {_FAR_M / 1000:g} km: the simulation blew up"
    return Positions(recorded, planar, spatial, step * dt), ""


def in_env_frame(
    recording: Recording, field: StateField, recorded: NDArray[Any], envs: slice = slice(None)
) -> NDArray[np.float64]:
    """Positions [..., env, item, component] in each env's own frame [m], float64; DamagedRecording where they are none.

    envs  that the positions are of
    """
    if field.unit != "m" or field.frame not in ("world", "env"):
        raise DamagedRecording(f"{recording.path}: positions in {field.unit}, frame {field.frame}: not of this format")
    if field.components not in (("x", "y"), ("x", "y", "z")):
        raise DamagedRecording(f"{recording.path}: positions have the components {', '.join(field.components)}")
    local = recorded.astype(np.float64)
    origins = recording.simulation.env_origins if recording.simulation else ()
    if origins and field.frame == "world":
        local = local - np.array(origins)[envs, None, : local.shape[-1]]
    return local
