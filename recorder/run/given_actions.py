"""The actions that a run gives its simulator: drawn from the seed, for the phase that comes."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.actions import Actions
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.schemas import topics
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.initial import drawn
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.treatment import Intervention


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
    actions, streams = simulator.scene.actions, simulator.streams
    if actions is None:
        return
    seed, n_env, last_step = configuration.seed, configuration.n_env, first_step + n_step - 1

    def row(step: int) -> NDArray[np.float32]:
        found: NDArray[np.float32] = actions.draw(seed, n_env=n_env, first_step=step, n_step=1, streams=streams)[0]
        return found

    first, last = row(first_step), row(last_step)
    applied = simulator.applied()
    same = applied is not None and np.array_equal(applied, last)
    message = message_class("gsb.v1.ActionStream")(
        generator=actions.describe(seed, streams),
        first_step=first_step,
        steps=n_step,
        envs=n_env,
        first_sha256=_sha256(first),
        last_sha256=_sha256(last),
        verified=same,
    )
    topic = topics.action_stream(journal.phase)
    journal.sink.channel(topic, "gsb.v1.ActionStream")
    journal.sink.write(topic, message.SerializeToString())
    if applied is not None and not same:
        wrong = int(np.count_nonzero((applied != last).any(axis=1))) if applied.shape == last.shape else n_env
        before = row(last_step - 1) if last_step else None
        journal.gate(
            f"the engine's actions of step {last_step} are not those it was given, in {wrong} envs"
            f"{_taken_from(applied, last, before)}"
        )


def _taken_from(applied: NDArray[np.float32], given: NDArray[np.float32], before: NDArray[np.float32] | None) -> str:
    """Whose actions were applied in place of those given, [env, action] all, where they are another's."""
    if before is not None and np.array_equal(applied, before):
        return ": they are those of the step before"
    if any(np.array_equal(applied, np.roll(given, by, axis=0)) for by in (1, -1)):
        return ": they are those of the neighbouring environments"
    return ""


def _sha256(array: NDArray[np.float32]) -> str:
    return hashlib.sha256(np.ascontiguousarray(array, dtype="<f4").tobytes()).hexdigest()
