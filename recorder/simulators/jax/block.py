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


class JaxBlock(Captured):
    """What compiled loops kept of their steps. Copies to the host begin as soon as a loop has ended."""

    def __init__(self, parts: list[tuple[int, Rings]], split: Callable[[dict[str, NDArray[Any]]], States]) -> None:
        """parts  filled rows, and the rings on the device, one pair for each loop
        split  makes states of what was seen
        """
        import jax

        self._split = split
        self._parts: list[tuple[int, Any]] = list(parts)
        self._seen: dict[str, NDArray[Any]] = {}
        self._counts: dict[str, NDArray[Any]] = {}
        for _, rings in parts:
            for ring in jax.tree.leaves(rings):
                ring.copy_to_host_async()

    def wait(self) -> None:
        """See Captured.wait."""
        import jax

        host = [(rows, jax.device_get(rings)) for rows, rings in self._parts]
        self._parts = []  # and the device has its memory back
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


def evidence_of(rows: dict[str, NDArray[Any]]) -> Evidence:
    """From counts [step, env] by name; those of OVERFLOW are bits."""
    counts = {name: array for name, array in rows.items() if name != OVERFLOW}
    bits = rows.get(OVERFLOW)
    return Evidence(counts, None if bits is None else bits.astype(np.uint32))


def _concatenated(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    if len(parts) == 1:
        return parts[0]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
