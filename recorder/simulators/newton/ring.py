"""Rows of states and counts on the device, to be read at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.newton.watch import Watch
from gpusimbench.recorder.simulators.newton.worlds import Worlds

_BODY = 4 * (7 + 6)  # bytes of a body's pose and speeds


class Ring:
    """Some rows; a row is what a step left."""

    def __init__(self, worlds: Worlds, watch: Watch, rows: int) -> None:
        """Allocate `rows` rows."""
        import warp as wp

        self._worlds = worlds
        self._watch = watch
        self.rows = rows
        bodies, n_env = worlds.model.body_count, worlds.n_env
        self._row = wp.zeros(1, dtype=wp.int32)
        self._poses = wp.empty((rows, bodies), dtype=wp.transform)
        self._speeds = wp.empty((rows, bodies), dtype=wp.spatial_vector)
        self._bits = wp.empty((rows, n_env), dtype=wp.int32)
        self._counts = tuple(wp.empty((rows, n_env), dtype=wp.int32) for _ in watch.counters)

    @staticmethod
    def row_bytes(worlds: Worlds, watch: Watch) -> int:
        """Of a row, on the device."""
        return int(_BODY * worlds.model.body_count + 4 * worlds.n_env * (1 + len(watch.counters)))

    def rewind(self) -> None:
        """Begin with the first row."""
        self._row.zero_()

    def store(self) -> None:
        """Enqueue: store the present state and the counts of the last step, and go on to the next row."""
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        state, n_env = self._worlds.state, self._worlds.n_env
        wp.launch(
            kernels.store_bodies,
            dim=self._worlds.model.body_count,
            inputs=[self._row, state.body_q, state.body_qd, self._poses, self._speeds],
        )
        self._watch.count(self._row, self._counts)
        wp.launch(kernels.store_bits, dim=n_env, inputs=[self._row, self._watch.bits, self._bits])
        wp.launch(kernels.next_row, dim=1, inputs=[self._row])

    def states(self, rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The first rows: poses [row, body, 7], positions and quaternions xyzw; speeds [row, body, 6], linear of the
        centre of mass and angular, both in the world frame. On the CPU they are the ring itself, not a copy."""
        return self._poses[:rows].numpy(), self._speeds[:rows].numpy()

    def evidence(self, rows: int) -> Evidence:
        """The counts and overflow bits of the first rows."""
        counts = {
            counter.name: array[:rows].numpy().copy()
            for counter, array in zip(self._watch.counters, self._counts, strict=True)
        }
        return Evidence(counts, self._bits[:rows].numpy().astype(np.uint32))
