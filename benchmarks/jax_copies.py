"""Where a captured step of an engine on JAX goes: the loop itself, or the copy of its states to the host.

usage: python -m benchmarks.jax_copies [--sim brax] [--scene inclined-collision] [--n-env 4096] [--blocks 6]
           [--rounds 2] [--option NAME=VALUE ...]

In one process and in turn: the timed loop; the loop that keeps states on the device, with nothing copied; and blocks of
that loop as the recorder makes them, two ahead, copied to pageable memory as JAX does by itself, or to pinned memory as
the adapter does. Times are means of a step over all blocks after the first. `--option ring=N` sets the steps that the
device keeps, all of which are copied; a block has as many.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import jax
import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.jax.block import JaxBlock, Rings
from gpusimbench.recorder.simulators.registry import find_simulator

WARMUP = 100
AHEAD = 2


class Pageable(JaxBlock):
    """A block whose copies go where JAX puts them by itself."""

    def __init__(self, parts: list[tuple[int, Rings]], split: Any) -> None:
        super().__init__([], split)
        self._parts = parts
        for ring in jax.tree.leaves(parts):
            if isinstance(ring, jax.Array):
                ring.copy_to_host_async()


def of_blocks(simulator: Any, kind: type[JaxBlock], blocks: int) -> float:
    """Seconds of a step, of blocks made AHEAD of those that are waited for."""
    ahead: deque[JaxBlock] = deque()
    arrived = []
    for made in range(blocks + AHEAD - 1):
        if made < blocks:
            ahead.append(kind([(simulator._ring, recorded(simulator))], simulator._split))
        if made >= AHEAD - 1:
            ahead.popleft().wait()
            arrived.append(time.perf_counter())
    steps: int = (blocks - 1) * simulator._ring
    return (arrived[-1] - arrived[0]) / steps


def recorded(simulator: Any) -> Rings:
    """A block of steps on the device, begun."""
    program, ring = simulator._program("record"), simulator._ring
    simulator._state, rings = program(simulator._state, simulator._step, np.int32(ring), *simulator._drawn_by())
    simulator._step = np.uint32(simulator._step + ring)
    found: Rings = rings
    return found


def main() -> None:
    """Measure, and print."""
    given = parser(__doc__, n_env=4096, blocks=6, rounds=2)
    given.add_argument("--sim", default="brax")
    given.add_argument("--scene", default="inclined-collision")
    given.add_argument("--option", action="append", default=[])
    asked = given.parse_args()
    scene, adapter = make_scene(asked.scene), find_simulator(asked.sim).adapter()
    options = adapter.parsed(asked.sim, scene, dict(one.split("=", 1) for one in asked.option))
    apply_environment(adapter.environment(options, "default"))
    simulator: Any = adapter(scene, n_env=asked.n_env, dt=scene.dt, seed=0, options=options, determinism="default")
    simulator.build()
    for phase in ("timed", "capture"):
        simulator.compile(phase)
    ring = simulator._ring
    simulator.step(WARMUP)
    size = sum(array.nbytes for array in jax.tree.leaves(recorded(simulator)))
    rows: dict[str, list[float]] = {}

    def keep(name: str, seconds: float) -> None:
        rows.setdefault(name, []).append(1e3 * seconds)

    for _ in range(asked.rounds):
        begin = time.perf_counter()
        simulator.step(ring)
        keep("timed", (time.perf_counter() - begin) / ring)
        begin = time.perf_counter()
        jax.block_until_ready((recorded(simulator), simulator._state))
        keep("kept on the device", (time.perf_counter() - begin) / ring)
        keep("copied to pageable memory", of_blocks(simulator, Pageable, asked.blocks))
        keep("copied to pinned memory", of_blocks(simulator, JaxBlock, asked.blocks))
    print(f"machine                         {machine()}, {simulator._device.device_kind}")
    print(f"{asked.sim}, {asked.scene}, {asked.n_env} envs, blocks of {ring} steps, {size / 1e6:.1f} MB")
    for name, milliseconds in rows.items():
        print(f"{name:<31} {spread(milliseconds)} ms a step")


if __name__ == "__main__":
    main()
