"""What a simulator needs of the environments that SAPIEN steps, on whatever device."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas.fields import StateField, body_fields, joint_field
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit


class Worlds(Protocol):
    """Some environments, stepped together.

    device         "cpu", or the name of the GPU
    env_origins    of each environment [m]; empty where all are at zero
    fields         layout of the state
    buffers        capacities; none on the CPU
    counters       what `evidence` counts
    overflow_bits  what its bits mean
    timing_covers  what lies between two clock readings around `advance`
    """

    device: str
    env_origins: tuple[tuple[float, float, float], ...]
    fields: tuple[StateField, ...]
    buffers: tuple[Buffer, ...]
    counters: tuple[Counter, ...]
    overflow_bits: tuple[OverflowBit, ...]
    timing_covers: str

    def advance(self, n_step: int) -> None:
        """See Simulator.step."""

    def state(self) -> States:
        """See Simulator.state."""

    def record(self, n_step: int) -> States:
        """See Simulator.states."""

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""

    def applied(self) -> NDArray[np.float32]:
        """See Simulator.applied; only where there is a robot."""


def fields_of(scene: Scene) -> tuple[StateField, ...]:
    """The layout of a scene's state, as SAPIEN gives it."""
    bodies = body_fields(scene.groups(), "float32")
    if scene.robot is None:
        return bodies
    joints = tuple(joint.name for joint in scene.robot.joints())
    return (*bodies, *(joint_field("robot", field, "float32", joints) for field in ("qpos", "qvel")))
