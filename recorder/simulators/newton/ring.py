"""Rows of states and counts on the device, to be read at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.newton.watch import Watch
from gpusimbench.recorder.simulators.newton.worlds import Worlds


class Ring:
    """Some rows; a row is what a step left."""

    def __init__(self, worlds: Worlds, watch: Watch, rows: int) -> None:
        """Allocate `rows` rows."""
        import warp as wp

        self._worlds = worlds
        self._watch = watch
        self.rows = rows
        n_env = worlds.n_env
        self._row = wp.zeros(1, dtype=wp.int32)
        self._states = tuple(wp.empty((rows, array.size), dtype=array.dtype) for array in worlds.shown())
        self._bits = wp.empty((rows, n_env), dtype=wp.int32)
        self._counts = tuple(wp.empty((rows, n_env), dtype=wp.int32) for _ in watch.counters)

    @staticmethod
    def row_bytes(worlds: Worlds, watch: Watch) -> int:
        """Of a row, on the device."""
        states = sum(array.capacity for array in worlds.shown())
        return int(states + 4 * worlds.n_env * (1 + len(watch.counters)))

    def rewind(self) -> None:
        """Begin with the first row."""
        self._row.zero_()

    def store(self) -> None:
        """Enqueue: store the present state and the counts of the last step, and go on to the next row."""
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        n_env = self._worlds.n_env
        for array, stored in zip(self._worlds.shown(), self._states, strict=True):
            wp.launch(kernels.store, dim=array.size, inputs=[self._row, array, stored])
        self._watch.count(self._row, self._counts)
        wp.launch(kernels.store_bits, dim=n_env, inputs=[self._row, self._watch.bits, self._bits])
        wp.launch(kernels.next_row, dim=1, inputs=[self._row])

    def states(self, rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The first rows of both arrays of the layout, [row, env, number]. On the CPU they are the ring itself, not a
        copy."""
        positions, velocities = (a[:rows].numpy().reshape(rows, self._worlds.n_env, -1) for a in self._states)
        return positions, velocities

    def evidence(self, rows: int) -> Evidence:
        """The counts and overflow bits of the first rows."""
        counts = {
            counter.name: array[:rows].numpy().copy()
            for counter, array in zip(self._watch.counters, self._counts, strict=True)
        }
        return Evidence(counts, self._bits[:rows].numpy().astype(np.uint32))
