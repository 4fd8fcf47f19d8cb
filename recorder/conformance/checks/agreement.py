"""Stepping, which is timed, and capturing, which is recorded, are the same simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.scene import N_STEP
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, fail
from gpusimbench.recorder.simulators.base import Description, Evidence, Simulator, States
from gpusimbench.recorder.simulators.flight import BLOCK_STEPS, NEVER, FailureKind, Watch, failure


def step_and_states_agree(subject: Subject) -> None:
    """Reach the same bits by step as by states, on an engine that repeats itself bit for bit."""
    if differ := stepped_differently(subject):
        expect_repeatable(subject)  # asked only now: where step agrees with states, the engine repeats itself, too
        fail(f"after {N_STEP} steps, step and states differ in {', '.join(differ)}, though two captures are the same")


def captured_states_stay(subject: Subject) -> None:
    """What states returned is not overwritten by its next call: the recorder keeps rows until a block is full."""
    trajectory = subject.trajectory
    first = tuple(array[1 : trajectory.blocks[0] + 1] for array in trajectory.states)
    changed = differences(trajectory.description, first, trajectory.kept)
    if changed:
        fail(f"states() gave arrays whose numbers its next call changed: {', '.join(changed)}; return copies")


def blocks_ahead_are_the_same(subject: Subject) -> None:
    """Give the same numbers and counts where blocks are begun before the ones ahead of them are read."""
    if subject.adapter.begin_states is Simulator.begin_states:
        raise NotApplicable("begin_states is not overridden: each block is made before the next is begun")
    trajectory = subject.trajectory
    states, evidence = subject.ahead
    captured = tuple(array[1:] for array in trajectory.states)
    if differ := differences(trajectory.description, captured, states):
        expect_repeatable(subject)
        fail(f"blocks begun ahead give other states than one after another, in {', '.join(differ)}")
    for name in counted(trajectory.evidence):
        one, other = (joined(found, name) for found in (trajectory.evidence, evidence))
        if not np.array_equal(one, other):
            fail(f"blocks begun ahead give other counts of {name} than one after another")


def flights_hold_the_captured_states(subject: Subject) -> None:
    """Hold the same numbers in a flight, and find who leaves bounds in the step in which captured states do."""
    if subject.adapter.flight is Simulator.flight:
        raise NotApplicable("flight is not overridden: captured states are looked at on the host")
    trajectory = subject.trajectory
    description, n_env = trajectory.description, trajectory.n_env
    origins = np.array(description.env_origins, dtype=np.float64) if description.env_origins else None
    free = Watch(description.fields, origins=origins)
    far = [
        np.abs(free.local(field, array)).max(axis=(1, 2, 3))
        for field, array in zip(description.fields, trajectory.states, strict=True)
        if field.field == "position"
    ]
    # so that some leave on the way, as long as anything moves away
    watch = replace(free, within=float(np.max(far, axis=0)[N_STEP // 2]))
    beyond = [watch.beyond(f, array).any(axis=(2, 3)) for f, array in zip(watch.fields, trajectory.states, strict=True)]
    left = np.any(beyond, axis=0)  # [step, env]
    expected = [failure(int(own.argmax()), FailureKind.OUT_OF_BOUNDS) if own.any() else NEVER for own in left.T]
    with subject.built(trajectory.scene) as (simulator, _):
        simulator.compile("capture")
        flight = simulator.flight(watch)
        found = flight.failures()
        for first in range(0, N_STEP, BLOCK_STEPS):
            simulator.prepare(None)
            flight.begin(min(BLOCK_STEPS, N_STEP - first))
            found = flight.failures()
        held = [flight.window(env, 0, N_STEP) for env in range(n_env)]
    whole = tuple(np.concatenate(columns, axis=1) for columns in zip(*held, strict=True))
    if differ := differences(description, trajectory.states, whole):
        expect_repeatable(subject)
        fail(f"a flight holds other states than states() gives, in {', '.join(differ)}")
    if found.tolist() != expected:
        fail(f"a flight finds the first failures {found.tolist()}; by the captured states they are {expected}")


def counted(evidence: Sequence[Evidence | None]) -> list[str]:
    """Names of what was counted."""
    return list(next((found.counts for found in evidence if found is not None), {}))


def joined(evidence: Sequence[Evidence | None], name: str) -> NDArray[np.integer]:
    """The rows of one counter over all blocks, [row, env]."""
    return np.concatenate([found.counts[name] for found in evidence if found is not None])


def stepped_differently(subject: Subject) -> list[str]:
    """Names of the fields in which step and states lead to other bits."""
    trajectory = subject.trajectory
    captured = tuple(array[-1] for array in trajectory.states)
    return differences(trajectory.description, captured, subject.stepped.state)


def expect_repeatable(subject: Subject) -> None:
    """NotApplicable where two captures of the same scene differ, as a second one shows."""
    description = subject.trajectory.description
    if varying := differences(description, subject.trajectory.states, subject.repeated.states):
        raise NotApplicable(
            f"not deterministic from run to run on {description.device}: two captures differ in {', '.join(varying)}"
        )


def differences(description: Description, one: States, other: States) -> list[str]:
    """Names of the fields in which two states are not the same bits."""
    return [
        layout.name
        for layout, a, b in zip(description.fields, one, other, strict=True)
        if a.shape != b.shape or a.tobytes() != b.tobytes()
    ]
