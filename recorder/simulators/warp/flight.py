"""The last steps of MuJoCo Warp's worlds, held and looked at on the device: few bytes a block reach the host."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.flight import NEVER, RING_STEPS, FailureKind, Flight, Watch


class WarpFlight(Flight):
    """A ring of the last RING_STEPS states, and of each world its first failure, which kernels of the step's graph
    find as the state passes them."""

    ahead = 2
    where = "device"

    def __init__(
        self,
        device: Any,
        data: Any,
        compiled: Any,
        watch: Watch,
        one_step: Callable[[], None],
        captured: Callable[[Callable[[], None]], Callable[[], None]],
    ) -> None:
        """data      mujoco_warp.Data, in the state that the flight begins with
        compiled  recorder.simulators.mujoco.model.MjcfModel, which knows where bodies are in qpos and qvel
        one_step  enqueues a step
        captured  makes a graph of what a call enqueues
        """
        import warp as wp

        self._device, self._data, self._compiled = device, data, compiled
        n_env, n_qpos = data.qpos.shape
        self._held = {
            name: wp.zeros((RING_STEPS, n_env, count), dtype=float, device=device)
            for name, count in (("qpos", n_qpos), ("qvel", data.qvel.shape[1]))
        }
        self._bits = wp.zeros((RING_STEPS, n_env), dtype=int, device=device)
        self.held_bytes = 4 * (self._bits.size + sum(ring.size for ring in self._held.values()))
        self._bounded = wp.array(self._coordinates(n_qpos), dtype=wp.int32, device=device)
        self._within = math.inf if watch.within is None else watch.within
        self._fatal = watch.fatal
        self._step = wp.zeros(1, dtype=wp.int32, device=device)
        self._failures = wp.full(n_env, NEVER, dtype=wp.int64, device=device)
        # as many as blocks may be begun, and the one that is being read
        self._copies = deque(
            wp.empty(n_env, dtype=wp.int64, device="cpu", pinned=device.is_cuda) for _ in range(self.ahead + 1)
        )
        self._begun: deque[tuple[Any, Any]] = deque()
        data.overflow.zero_()  # what the steps before have left
        self._hold()  # builds its kernels, too
        self._copy()
        self._one = captured(lambda: self._step_and_hold(one_step))

    def _coordinates(self, n_qpos: int) -> NDArray[np.int32]:
        # of each number of qpos, whether it is a coordinate of a body
        bounded = np.zeros(n_qpos, dtype=np.int32)
        bounded[self._compiled.coordinates] = 1
        return bounded

    def _step_and_hold(self, one_step: Callable[[], None]) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        one_step()
        wp.launch(kernels.advance, dim=1, inputs=[self._step])
        self._hold()

    def _hold(self) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        data = self._data
        n_env, n_qpos = data.qpos.shape
        wp.launch(
            kernels.hold,
            dim=(n_env, n_qpos + data.qvel.shape[1] + 1),
            inputs=[
                self._step, data.qpos, data.qvel, data.overflow, self._bounded, self._within, self._fatal,
                len(FailureKind),
            ],
            outputs=[self._held["qpos"], self._held["qvel"], self._bits, self._failures],
        )  # fmt: skip

    def _copy(self) -> None:
        # behind all that the device has been given to do
        import warp as wp

        copy = self._copies.popleft()
        wp.copy(copy, self._failures)
        self._begun.append((copy, self._device.stream.record_event() if self._device.is_cuda else None))

    def begin(self, n_step: int) -> None:
        """See Flight.begin."""
        for _ in range(n_step):
            self._one()
        self._copy()

    def failures(self) -> NDArray[np.int64]:
        """See Flight.failures."""
        import warp as wp

        copy, copied = self._begun.popleft()
        if copied is not None:
            wp.synchronize_event(copied)
        failures: NDArray[np.int64] = copy.numpy().copy()
        self._copies.append(copy)
        return failures

    def window(self, env: int, first: int, last: int) -> States:
        """See Flight.window."""
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        rows = np.arange(first, last + 1) % RING_STEPS
        found = []
        for ring in self._held.values():
            own = wp.empty((RING_STEPS, ring.shape[2]), dtype=float, device=self._device)
            wp.launch(kernels.held_of_env, dim=own.shape, inputs=[env, ring], outputs=[own])
            found.append(own.numpy()[rows][:, np.newaxis])
        states: States = self._compiled.split(*found)
        return states

    def overflow(self, env: int, step: int) -> int:
        """See Flight.overflow."""
        bits: NDArray[np.int32] = self._bits.numpy()  # of all worlds: 16 times a run at most
        return int(bits[step % RING_STEPS, env].view(np.uint32))
