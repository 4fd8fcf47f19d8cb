"""What one run was asked to do: stored in every recording, and enough to run it again."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any

from schemas.errors import DamagedRecording

PHASES = ("baseline", "init", "warmup", "timed", "capture")
"""Phases of a run in order. The first two always happen."""

OPTIONAL_PHASES = ("timed", "capture")
"""Phases that a run can leave out; "warmup" belongs to "timed"."""


@dataclass(frozen=True)
class RunConfiguration:
    """Configuration of one run.

    simulator    name in the registry of simulators
    scene        name in the registry of scenes
    n_env        number of identical environments
    dt           simulator step [s]
    steps        steps captured after the initial state
    stride       every how many steps a state is recorded; divides `steps`
    warmup       steps before the timed ones, excluded from throughput
    timed_steps  steps that throughput is computed from
    phases       which of OPTIONAL_PHASES happen
    seed         seed of whatever the scene draws at random
    run_index    number of the run within its set, from 0
    compression  of the file's chunks: "none", "lz4" or "zstd"
    options      options of the simulator, by name, as text
    """

    simulator: str
    scene: str
    n_env: int
    dt: float
    steps: int
    stride: int = 1
    warmup: int = 100
    timed_steps: int = 1000
    phases: tuple[str, ...] = OPTIONAL_PHASES
    seed: int = 0
    run_index: int = 0
    compression: str = "none"
    options: dict[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {**asdict(self), "phases": list(self.phases)}

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> RunConfiguration:
        """From JSON; keys that this version does not know are ignored, as the format's evolution rules ask."""
        known = {f.name for f in fields(cls)}
        try:
            values = {key: value for key, value in record.items() if key in known}
            configuration = cls(**{**values, "phases": tuple(values.get("phases", OPTIONAL_PHASES))})
            numbers = (configuration.n_env, configuration.steps, configuration.stride)
            if not all(isinstance(n, int) and n >= 0 for n in numbers) or not configuration.dt > 0:
                raise ValueError("n_env, steps, stride and dt must be positive numbers")
        except (TypeError, ValueError, AttributeError) as error:
            raise DamagedRecording(f"the configuration in the recording is unreadable: {error}") from None
        return configuration


def sim_time_ns(step: int, dt: float) -> int:
    """Simulated time of a step [ns]."""
    return round(step * dt * 1e9)
