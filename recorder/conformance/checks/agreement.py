"""Stepping, which is timed, and capturing, which is recorded, are the same simulation."""

from __future__ import annotations

from recorder.conformance.scene import N_STEP
from recorder.conformance.subject import Subject
from recorder.conformance.verdict import NotApplicable, fail
from recorder.simulators.base import Description, States


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
