"""Steps of Newton on their way to a recording."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.newton.layout import Layout
from gpusimbench.recorder.simulators.newton.ring import STATES, evidence_of
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots
from gpusimbench.schemas.provenance import Counter


class NewtonBlock(SlotBlock):
    """States and counts of steps in a slot, as a Ring has stored them."""

    def __init__(
        self, slots: Slots, slot: Slot, rows: int, n_env: int, layout: Layout, counters: Sequence[Counter]
    ) -> None:
        super().__init__(slots, slot, rows)
        self._n_env = n_env
        self._layout = layout
        self._counters = counters

    def states(self, envs: slice) -> States:
        """See Captured.states: copies."""
        stored = (self.host(name) for name in STATES)
        return self._layout.split(*(a.reshape(len(a), self._n_env, -1)[:, envs] for a in stored))

    def evidence(self) -> Evidence:
        """See Captured.evidence."""
        return evidence_of(self._counters, self.host)
