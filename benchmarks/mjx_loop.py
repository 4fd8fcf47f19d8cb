"""What each part of the recorder's timed loop of MJX (jax) costs, against a bare ``jax.lax.scan`` of the same work.

usage: python -m benchmarks.mjx_loop [--scene franka] [--n-env 1024] [--steps 300] [--rounds 3]

All loops run in one process, in turn, from one state after 100 steps of warm-up. Each applies the actions of the same
steps, except the loop without actions, which shows what a peer gains that leaves them out. The first loop is the
floor; the others are ratios to it. Final states are compared with those of the floor, bit for bit.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import MemorySampler
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.jax.block import OVERFLOW
from gpusimbench.recorder.simulators.mjx.physics import MjxOptions
from gpusimbench.recorder.simulators.mjx.simulator import Mjx

WARMUP = 100

Loop = Callable[[Any], Any]
"""Steps a batched mjx.Data, whose memory it may reuse, and returns when the device is done."""


def loops(simulator: Mjx, n_step: int) -> dict[str, Loop]:
    """The loops, compiled, by name."""
    import jax

    physics, scene, n_env = simulator._physics, simulator.scene, simulator.n_env
    assert scene.actions is not None and simulator._draw is not None, "a scene with actions"
    drawn_by, streams = simulator._draw, simulator._drawn_by()
    given = jax.device_put(scene.actions.draw(simulator.seed, n_env=n_env, first_step=WARMUP, n_step=n_step))
    state, no_bits = simulator._state, np.zeros(n_env, np.uint32)
    interval = simulator.timing_interval

    def compiled(function: Callable[..., Any], *arguments: Any) -> Any:
        program = jax.jit(function, donate_argnums=0).lower(state, *arguments).compile()
        return lambda *now: jax.block_until_ready(program(*now))

    def scan(body: Callable[[Any, Any], Any]) -> Callable[..., Any]:
        return lambda data, xs: jax.lax.scan(lambda d, x: (body(d, x), None), data, xs, length=n_step)[0]

    def draw(step: Any) -> Any:
        return drawn_by(step, *streams)

    def counted(data: Any, n: Any) -> Any:
        return jax.lax.fori_loop(0, n, lambda i, d: physics.advance(d, draw(np.uint32(WARMUP) + i)), data)

    def with_bits(carry: Any, step: Any) -> Any:
        data = physics.advance(carry[0], draw(step))
        return data, carry[1] | physics.count(data).get(OVERFLOW, np.uint32(0))

    def scan_with_bits(data: Any, xs: Any) -> Any:
        return jax.lax.scan(lambda c, x: (with_bits(c, x), None), (data, no_bits), xs, length=n_step)[0]

    steps = np.arange(WARMUP, WARMUP + n_step, dtype=np.uint32)
    bare = compiled(scan(physics.advance), given)
    idle = compiled(scan(lambda d, _: physics.advance(d, None)), None)
    drawn = compiled(scan(lambda d, step: physics.advance(d, draw(step))), steps)
    traced = compiled(counted, np.int32(n_step))
    gathered = compiled(scan_with_bits, steps)

    def recorder(parts: int) -> Loop:
        def run(data: Any) -> Any:
            simulator._state, simulator._step = data, np.uint32(WARMUP)
            for first in range(0, n_step, parts):
                simulator.step(min(parts, n_step - first))
            return simulator._state

        return run

    return {
        "scan, actions on the device": lambda d: bare(d, given),
        "without actions": lambda d: idle(d, None),
        "actions drawn in the loop": lambda d: drawn(d, steps),
        "... number of steps traced": lambda d: traced(d, np.int32(n_step)),
        "... overflow bits gathered": lambda d: gathered(d, steps)[0],
        "recorder, one call": recorder(n_step),
        f"recorder, {interval} steps a call": recorder(interval),
    }


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=1024, steps=300, rounds=3)
    p.add_argument("--scene", default="franka")
    a = p.parse_args()
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    simulator = Mjx(make_scene(a.scene), n_env=a.n_env, dt=0.01, seed=0, options=MjxOptions())
    device = simulator.build().device
    import jax

    simulator.compile("timed")
    simulator.step(WARMUP)
    start = jax.device_get(simulator._state)
    variants = loops(simulator, a.steps)
    sampled = list(variants)[-1]
    rates: dict[str, list[float]] = {}
    final: dict[str, bytes] = {}

    def measure(name: str, loop: Loop) -> None:
        data = jax.block_until_ready(jax.device_put(start))
        began = time.perf_counter()
        data = loop(data)
        elapsed_s = time.perf_counter() - began
        rates.setdefault(name, []).append(frames_per_second(a.n_env, a.steps, elapsed_s))
        final[name] = np.asarray(data.qpos).tobytes() + np.asarray(data.qvel).tobytes()

    with Gpus() as gpus:
        for _ in range(a.rounds):
            for name, loop in variants.items():
                measure(name, loop)
            sampler = MemorySampler(gpus)
            sampler.start()
            measure(f"{sampled}, memory sampled", variants[sampled])
            sampler.stop()
    print(f"machine  {machine()}, device {device}")
    print(f"work     {a.scene}, {a.n_env} envs, steps {WARMUP} to {WARMUP + a.steps}, {a.rounds} rounds")
    floor = next(iter(rates))
    print(f"{floor:45} {spread(rates[floor], 0)} env-steps/s")
    for name, found in rates.items():
        ratios = [x / y for x, y in zip(found, rates[floor], strict=True)]
        same = "same final states" if final[name] == final[floor] else "other final states"
        print(f"{name:45} {spread(ratios)}, {same}")


if __name__ == "__main__":
    main()
