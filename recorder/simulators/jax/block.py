"""Steps of an engine on JAX on their way to a recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import Captured, States
from gpusimbench.recorder.simulators.evidence import Evidence

OVERFLOW = "overflow"

Rings = dict[str, dict[str, Any]]
"""Arrays [row, env, ...] of what was seen and counted, by "seen" and "counts" and by name."""


def begin_copy(rings: Rings) -> Rings:
    """Copies in page-locked memory of the host, begun and not waited for; on a CPU, the arrays themselves.

    Not ``copy_to_host_async``, which copies to pageable memory: on an H100 that goes at 1 GB/s in place of 43, and what
    a loop reads on the host, such as whether to go on, waits behind it, so that no step is made meanwhile.
    """
    import jax

    def copied(ring: Any) -> Any:
        (device,) = ring.devices()
        if device.platform == "cpu":
            return ring
        return jax.device_put(ring, ring.sharding.with_memory_kind("pinned_host"))

    copies: Rings = jax.tree.map(copied, rings)
    return copies


class JaxBlock(Captured):
    """What compiled loops kept of their steps. Copies to the host begin as soon as a loop has ended."""

    def __init__(self, parts: list[tuple[int, Rings]], split: Callable[[dict[str, NDArray[Any]]], States]) -> None:
        """parts  filled rows, and the rings on the device, one pair for each loop
        split  makes states of what was seen
        """
        self._split = split
        self._parts = [(rows, begin_copy(rings)) for rows, rings in parts]
        self._seen: dict[str, NDArray[Any]] = {}
        self._counts: dict[str, NDArray[Any]] = {}

    def wait(self) -> None:
        """See Captured.wait."""
        import jax

        host = [(rows, jax.device_get(rings)) for rows, rings in self._parts]
        self._parts = []
        self._seen, self._counts = (
            _concatenated([{name: ring[:rows] for name, ring in rings[kind].items()} for rows, rings in host])
            for kind in ("seen", "counts")
        )

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        return self._split({name: array[:, envs] for name, array in self._seen.items()})

    def evidence(self) -> Evidence:
        """See Captured.evidence."""
        return evidence_of(self._counts)

    def release(self) -> None:
        """See Captured.release: what was read are views of memory that JAX gives to the next block."""
        self._seen, self._counts = {}, {}


def evidence_of(rows: dict[str, NDArray[Any]]) -> Evidence:
    """From counts [step, env] by name; those of OVERFLOW are bits."""
    counts = {name: array for name, array in rows.items() if name != OVERFLOW}
    bits = rows.get(OVERFLOW)
    return Evidence(counts, None if bits is None else bits.astype(np.uint32))


def _concatenated(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    if len(parts) == 1:
        return parts[0]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
