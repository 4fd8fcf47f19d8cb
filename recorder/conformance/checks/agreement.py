"""Stepping, which is timed, and capturing, which is recorded, are the same simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.scene import N_STEP
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, fail
from gpusimbench.recorder.simulators.base import Description, Evidence, Simulator, States


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
