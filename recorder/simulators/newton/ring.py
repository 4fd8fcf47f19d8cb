"""Rows of states and counts on the device, filled one after the other, and their way to a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.newton.layout import Layout
from gpusimbench.recorder.simulators.newton.watch import Watch
from gpusimbench.recorder.simulators.newton.worlds import Worlds
from gpusimbench.recorder.simulators.slots import Host
from gpusimbench.schemas.provenance import Counter

STATES = ("positions", "velocities")
"""Names of the rows of the layout's two arrays. Counts have the names of their counters."""
_BITS = "overflow_bits"


def state_shapes(worlds: Worlds, rows: int) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Shapes and types of rows of the states of all worlds."""
    return {name: ((rows, a.size), a.dtype) for name, a in zip(STATES, worlds.shown(), strict=True)}


def evidence_shapes(watch: Watch, n_env: int, rows: int) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Shapes and types of rows of the counts and overflow bits of all worlds."""
    import warp as wp

    return dict.fromkeys((*(counter.name for counter in watch.counters), _BITS), ((rows, n_env), wp.int32))


def row_bytes(worlds: Worlds, watch: Watch) -> int:
    """The bytes of a row of states and of evidence, on the device."""
    states = sum(array.capacity for array in worlds.shown())
    return int(states + 4 * worlds.n_env * (1 + len(watch.counters)))


def states_of(layout: Layout, n_env: int, rows: Host, envs: slice) -> States:
    """States [row, env of the range, item, width] from rows by name: copies."""
    return layout.split(*(a.reshape(len(a), n_env, -1)[:, envs] for a in map(rows, STATES)))


def evidence_of(counters: Sequence[Counter], rows: Host) -> Evidence:
    """rows  by name, [row, world]; the counts are these arrays, not copies"""
    return Evidence({counter.name: rows(counter.name) for counter in counters}, rows(_BITS).astype(np.uint32))


class Ring:
    """Kernels that fill rows; a row is what a step left. Which row comes next stands on the device."""

    def __init__(self, worlds: Worlds, watch: Watch, arrays: Mapping[str, Any]) -> None:
        """arrays  on the device, of evidence_shapes and, for `store`, of state_shapes"""
        import warp as wp

        self._worlds = worlds
        self._watch = watch
        self._row = wp.zeros(1, dtype=wp.int32)
        self._arrays = arrays
        self._counts = tuple(arrays[counter.name] for counter in watch.counters)

    def go_to(self, row: int) -> None:
        """Enqueue: go on with that row."""
        self._row.fill_(row)

    def store(self) -> None:
        """Enqueue: store the present state and the counts of the last step, and go on to the next row."""
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        for name, array in zip(STATES, self._worlds.shown(), strict=True):
            wp.launch(kernels.store, dim=array.size, inputs=[self._row, array, self._arrays[name]])
        self.store_evidence()
        wp.launch(kernels.next_row, dim=1, inputs=[self._row])

    def store_evidence(self) -> None:
        """Enqueue: store the counts of the last step, and the bits since they were last stored."""
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        self._watch.count(self._row, self._counts)
        inputs = [self._row, self._watch.bits, self._arrays[_BITS]]
        wp.launch(kernels.store_bits, dim=self._worlds.n_env, inputs=inputs)
