"""What a bare loop is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from benchmarks.bare.work import Work
from gpusimbench.recorder.simulators.base import States


class Loop(ABC):
    """Environments of a recording's scene on an engine, in their first state."""

    @abstractmethod
    def step(self, first_step: int, n_step: int) -> float:
        """Make the steps that follow state `first_step` by the engine's own calls, and wait for the device; the time
        of that [s], without the time that the actions took to reach the device."""

    @abstractmethod
    def state(self) -> States:
        """The present state, an array [env, item, width] for each field of the recording."""

    @abstractmethod
    def contacts(self) -> float | None:
        """Of the last step, mean over environments; None where the engine does not tell."""


class Built(Loop):
    """Environments that the recorder's adapter has built and compiled; nothing of it takes part in the steps."""

    def __init__(self, work: Work) -> None:
        self.work = work
        asked = work.asked
        self.simulator: Any = work.adapter(  # what is its own is read by the modules of engines
            work.scene, n_env=asked.n_env, dt=asked.dt, seed=asked.seed, options=work.options,
            determinism=asked.determinism,
        )  # fmt: skip
        self.simulator.build()
        self.simulator.compile("timed")

    def state(self) -> States:
        """See Loop.state."""
        state: States = self.simulator.state()
        return state

    def contacts(self) -> float | None:
        """See Loop.contacts."""
        evidence = self.simulator.evidence()
        if evidence is None or "contacts" not in evidence.counts:
            return None
        return float(evidence.counts["contacts"][-1].mean())
