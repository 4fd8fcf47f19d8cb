"""The actions that a run gives its simulator: drawn from the seed, for the phase that comes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.actions import Actions, write_action_stream
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.schemas.configuration import RunConfiguration


def given(
    simulator: Simulator, configuration: RunConfiguration, first_step: int, n_step: int
) -> NDArray[np.float32] | None:
    """Actions of consecutive steps, [step, env, action]; None where there are none, or where the engine draws them."""
    actions = simulator.scene.actions
    if actions is None or simulator.draws_actions:
        return None
    return actions.draw(configuration.seed, n_env=configuration.n_env, first_step=first_step, n_step=n_step)


def prepare(simulator: Simulator, configuration: RunConfiguration, first_step: int, n_step: int) -> Actions | None:
    """Give the simulator what it needs for these steps; returns their actions by range of environments, if any."""
    array = given(simulator, configuration, first_step, n_step)
    simulator.prepare(array)
    if array is not None:
        return lambda envs: array[:, envs.start : envs.stop]
    drawn = simulator.scene.actions
    if drawn is None:
        return None
    return lambda envs: drawn.draw(
        configuration.seed, n_env=len(envs), first_env=envs.start, first_step=first_step, n_step=n_step
    )


def write_applied(
    journal: Journal, simulator: Simulator, configuration: RunConfiguration, first_step: int, n_step: int
) -> None:
    """Write what the present phase applied; a gate fires where the engine holds other actions than it was given."""
    if simulator.scene.actions is None:
        return
    problem = write_action_stream(
        journal.sink,
        journal.phase,
        simulator.scene.actions,
        seed=configuration.seed,
        n_env=configuration.n_env,
        first_step=first_step,
        n_step=n_step,
        applied=simulator.applied(),
    )
    if problem:
        journal.gate(problem)
