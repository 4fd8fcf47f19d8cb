"""What it costs to write the actions of franka as their generator, against writing them as arrays: A B B A.

usage: python -m benchmarks.action_storage [--n-env 131072] [--steps 54] [--rounds 3] [--expected 1000]

"of the engine": the engine drew the actions on its device, and the recorder has what it held, which is written, or
compared with what the generator draws. "of the recorder": the recorder drew them for the engine. Both ways digest the
same arrays; the content hashes are the same, or the benchmark fails. CPU time is that of all threads.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import machine, spread
from gpusimbench.recorder.capture.actions import ActionWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.schemas.action_generator import JointTargets, Streams

_BLOCK = 18  # steps that the recorder writes at once of 131,072 environments
_DT = 0.01


class _NotDescribed(JointTargets):
    """The same actions, of a class that no description of a generator gives: they are written as arrays."""


@dataclass(frozen=True)
class Cost:
    """Of one step: bytes in the file, CPU time and time [ms]."""

    size: float
    cpu: float
    clock: float


def main() -> None:
    """Measure and print."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--n-env", type=int, default=131072)
    p.add_argument("--steps", type=int, default=3 * _BLOCK)
    p.add_argument("--rounds", type=int, default=3)
    p.add_argument("--expected", type=int, default=1000, help="steps of the capture: large ones draw by compiled code")
    a = p.parse_args()
    drawn = franka().actions
    assert drawn is not None
    streams = Streams.usual(a.n_env)
    held = drawn.draw(0, n_env=a.n_env, first_step=0, n_step=_BLOCK)
    arrays = _NotDescribed(drawn.name, drawn.joints, drawn.lower, drawn.upper)
    workers = Workers(small=False)

    def written(folder: Path, actions: JointTargets, engine: bool) -> tuple[Cost, dict[str, str]]:
        def of_block(envs: range) -> NDArray[np.float32]:
            if not engine:
                return held[:, envs.start : envs.stop]
            return drawn.draw(0, n_env=len(envs), first_step=0, n_step=_BLOCK, streams=streams.of(envs))

        sink = Sink(folder / "run.mcap", compression="none")
        writer = ActionWriter(sink, workers, actions, seed=0, streams=streams, dt=_DT, n_step=a.expected)
        sink.flush()
        before, began, worked = sink.partial.stat().st_size, time.perf_counter(), time.process_time()
        for _ in range(a.steps // _BLOCK):
            writer.write(of_block, lambda envs: held[:, envs] if engine else None, 0)
        clock, cpu = time.perf_counter() - began, time.process_time() - worked
        size = sink.partial.stat().st_size - before
        sink.abandon()
        sink.partial.unlink()
        count = a.steps // _BLOCK * _BLOCK
        return Cost(size / count, cpu / count * 1e3, clock / count * 1e3), sink.digest.digests()

    print(f"machine                       {machine()}")
    print(f"actions                       franka, {a.n_env} envs, {a.steps} steps, {a.rounds} rounds")
    for who, engine in (("of the engine", True), ("of the recorder", False)):
        costs: dict[str, list[Cost]] = {"arrays": [], "generator": []}
        digests = []
        with tempfile.TemporaryDirectory() as name:
            for _ in range(a.rounds):
                for what in ("arrays", "generator", "generator", "arrays"):
                    cost, digest = written(Path(name), arrays if what == "arrays" else drawn, engine)
                    costs[what].append(cost)
                    digests.append(digest)
        assert all(other == digests[0] for other in digests), "the identity is that of the arrays"
        for what, found in costs.items():
            label, of = f"{who}, {what}", "a step"
            rows: tuple[tuple[str, Callable[[Cost], float], int], ...] = (
                ("bytes", lambda c: c.size, 0), ("CPU [ms]", lambda c: c.cpu, 2), ("time [ms]", lambda c: c.clock, 2),
            )  # fmt: skip
            for title, value, digits in rows:
                print(f"{label:26} {title:9} {of} {spread([value(c) for c in found], digits)}")


if __name__ == "__main__":
    main()
