"""The actions that a run gives its simulator: drawn from the seed, for the phase that comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.actions import Actions, write_action_stream
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.treatment import Intervention, drawn


def streams_of(configuration: RunConfiguration) -> Streams:
    """Whose actions each environment is given, so that actions are no reason why a treatment should matter.

    An environment that begins in the initial state of another slot is given the actions of that slot, too.
    """
    initial = drawn(configuration.initial)
    usual = Streams.usual(configuration.n_env)
    if initial is None:
        return usual
    return replace(usual, env=np.roll(usual.env, -initial.shift))


def begin_anew(simulator: Simulator, configuration: RunConfiguration) -> None:
    """Before the first step of a phase with an intervention: the actions of environments that will be reset begin anew
    then, so that they are those of environments that have just begun."""
    intervention = Intervention.of(configuration.intervention)
    if intervention is None or not intervention.kind.restarts:
        return
    begun = np.zeros(configuration.n_env, dtype=np.uint32)
    begun[intervention.treated(configuration.n_env)] = intervention.step
    simulator.streams = replace(simulator.streams, begun=begun)


def given(
    simulator: Simulator, configuration: RunConfiguration, first_step: int, n_step: int
) -> NDArray[np.float32] | None:
    """Actions of consecutive steps, [step, env, action]; None where there are none, or where the engine draws them."""
    actions = simulator.scene.actions
    if actions is None or simulator.draws_actions:
        return None
    return actions.draw(
        configuration.seed, n_env=configuration.n_env, first_step=first_step, n_step=n_step, streams=simulator.streams
    )


def prepare(simulator: Simulator, configuration: RunConfiguration, first_step: int, n_step: int) -> Actions | None:
    """Give the simulator what it needs for these steps; returns their actions by range of environments, if any."""
    array = given(simulator, configuration, first_step, n_step)
    simulator.prepare(array)
    if array is not None:
        return lambda envs: array[:, envs.start : envs.stop]
    actions, every = simulator.scene.actions, simulator.streams
    if actions is None:
        return None

    def of(envs: range) -> NDArray[np.float32]:
        return actions.draw(
            configuration.seed, n_env=len(envs), first_step=first_step, n_step=n_step, streams=every.of(envs)
        )

    return of


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
        streams=simulator.streams,
        first_step=first_step,
        n_step=n_step,
        applied=simulator.applied(),
    )
    if problem:
        journal.gate(problem)
