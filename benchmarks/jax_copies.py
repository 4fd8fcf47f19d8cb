"""Where a captured step of an engine on JAX goes: the loop itself, or the copy of its states to the host.

usage: python -m benchmarks.jax_copies [--sim brax] [--scene inclined-collision] [--n-env 4096] [--blocks 6]
           [--rounds 2] [--option NAME=VALUE ...]

In one process and in turn, each from the state after the warm-up: the timed loop; the loop that keeps states on the
device, with nothing copied; and blocks of that loop as the recorder makes them, two ahead, copied to pageable memory as
JAX does by itself, or to pinned memory as the adapter does. All make the same steps; times are means of a step over the
blocks after the first three. The first copy locks its pages, and the device makes the blocks ahead meanwhile.
`--option ring=N` sets the steps that the device keeps, all of which are copied; a block has as many.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.jax.block import JaxBlock, Rings
from gpusimbench.recorder.simulators.registry import find_simulator

WARMUP = 100
AHEAD = 2
UNTIMED = AHEAD + 1  # blocks: the first copy, and those that the device makes while its pages are locked


class Pageable(JaxBlock):
    """A block whose copies go where JAX puts them by itself."""

    def __init__(self, parts: list[tuple[int, Rings]], split: Any) -> None:
        super().__init__([], split)
        self._parts = parts
        for ring in jax.tree.leaves(parts):
            if isinstance(ring, jax.Array):
                ring.copy_to_host_async()


def of_blocks(simulator: Any, kind: type[JaxBlock], blocks: int) -> float:
    """Seconds of a step, of blocks made AHEAD of those that are waited for, UNTIMED ones before them."""
    ahead: deque[JaxBlock] = deque()
    arrived = []
    for made in range(UNTIMED + blocks + AHEAD - 1):
        if made < UNTIMED + blocks:
            ahead.append(kind([(simulator._ring, recorded(simulator))], simulator._split))
        if made >= AHEAD - 1:
            ahead.popleft().wait()
            arrived.append(time.perf_counter())
    steps: int = blocks * simulator._ring
    return (arrived[-1] - arrived[UNTIMED - 1]) / steps


def of_calls(block: Callable[[], None], steps: int, blocks: int) -> float:
    """Seconds of a step, of blocks made one after another, UNTIMED ones before them."""
    for _ in range(UNTIMED):
        block()
    begin = time.perf_counter()
    for _ in range(blocks):
        block()
    return (time.perf_counter() - begin) / (steps * blocks)


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

    def on_the_device() -> None:
        jax.block_until_ready((recorded(simulator), simulator._state))

    ways: dict[str, Callable[[], float]] = {
        "timed": lambda: of_calls(lambda: simulator.step(ring), ring, asked.blocks),
        "kept on the device": lambda: of_calls(on_the_device, ring, asked.blocks),
        "copied to pageable memory": lambda: of_blocks(simulator, Pageable, asked.blocks),
        "copied to pinned memory": lambda: of_blocks(simulator, JaxBlock, asked.blocks),
    }
    state, step = jax.tree.map(jnp.copy, simulator._state), simulator._step
    for _ in range(asked.rounds):
        for name, measure in ways.items():
            simulator._state, simulator._step = jax.tree.map(jnp.copy, state), step  # a program may reuse its argument
            keep(name, measure())
    print(f"machine                         {machine()}, {simulator._device.device_kind}")
    print(f"{asked.sim}, {asked.scene}, {asked.n_env} envs, blocks of {ring} steps, {size / 1e6:.1f} MB")
    for name, milliseconds in rows.items():
        print(f"{name:<31} {spread(milliseconds)} ms a step")


if __name__ == "__main__":
    main()
