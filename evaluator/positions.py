"""Where the cubes are at the sample step, as every positional metric needs it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.metrics.variability import sampling_step
from evaluator.recording import Recording

GROUP = "cubes"


def sampled_positions(recording: Recording, sample_time: float) -> tuple[NDArray[Any] | None, str]:
    """Positions of the cubes as recorded, [env, item, component], or None and the reason.

    sample_time  [s]; the step is round(sample_time / dt)
    """
    if not any(f.name == f"{GROUP}/position" for f in recording.fields):
        return None, f"no positions of {GROUP} were recorded"
    step = sampling_step(sample_time, recording.configuration.dt)
    array = recording.state(GROUP, "position")
    if not len(array):
        return None, "no states were recorded (the capture phase was left out or not reached)"
    try:
        return array.at_step(step), ""
    except KeyError:
        dt = recording.configuration.dt
        return None, (
            f"step {step} ({sample_time:g} s) was not recorded; recorded are steps {array.steps[0]} to "
            f"{array.steps[-1]} ({array.steps[-1] * dt:g} s)"
        )


def planar_positions(recording: Recording, sample_time: float) -> tuple[NDArray[np.float64] | None, str]:
    """Planar positions [m] in each env's own frame, [env, item, 2], float64; or None and the reason.

    Env origins are subtracted here, in float64: before recording it would have cost bits.
    """
    recorded, why_not = sampled_positions(recording, sample_time)
    if recorded is None:
        return None, why_not
    positions = recorded[..., :2].astype(np.float64)
    if recording.simulation and recording.simulation.env_origins:
        positions = positions - np.array(recording.simulation.env_origins)[:, None, :2]
    if not np.isfinite(positions).all():
        return None, "positions at the sample step are not finite"
    return positions, ""
