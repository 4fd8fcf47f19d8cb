"""What `gsb-record --keep failing` costs beside the same steps with nothing recorded, in one process, A B B A.

usage: python -m benchmarks.flight [--sim warp] [--scene inclined-collision] [--n-env 64] [--steps 200] [--rounds 5]
           [--within METRES] [--spread M] [--option NAME=VALUE ...]

Each round steps four times from the same state: bare, kept, kept, bare. Bare steps are one call of the adapter's
``step``, so that nothing but the engine's own graph runs, with one synchronisation at the end. Kept steps go through
the loop of the capture phase, and the states of what fails are written to a file. The ratio is that of the two kept to
the two bare durations. --within makes environments fail, and --spread lets them begin apart [m/s].
"""

from __future__ import annotations

import gc
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.capture.flight import FlightWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.options import parse_options, split_options
from gpusimbench.recorder.run import start
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.recorder.run.flight_phase import fly, watch_of
from gpusimbench.recorder.run.given_actions import prepare
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.treatment import Keep


class Bench:
    """One simulator, stepped again and again from the same state."""

    def __init__(self, c: RunConfiguration) -> None:
        scene = make_scene(c.scene)
        adapter = find_simulator(c.simulator).load()
        options = parse_options(c.simulator, adapter.Options, c.options)
        apply_environment(adapter.environment(options, c.determinism))
        self.configuration = c
        self.simulator: Simulator = adapter(scene, n_env=c.n_env, dt=c.dt, seed=c.seed, options=options)
        self.description: Description = self.simulator.build()
        self.simulator.compile("timed")
        self.simulator.compile("capture")
        first = tuple(np.array(array) for array in self.simulator.state())
        drawn = Initial.parse(c.initial) if c.initial else None
        fields = self.description.fields
        self._begin = first if drawn is None else start.drawn_states(drawn, scene, fields, first, c.seed)
        self.held_bytes = 0
        self.failed = ""

    def bare(self) -> float:
        """Seconds of the steps alone."""
        c = self.configuration
        self.simulator.set_state(self._begin)
        prepare(self.simulator, c, 0, c.steps)
        gc.collect()
        begin = time.perf_counter()
        self.simulator.step(c.steps)
        return time.perf_counter() - begin

    def _prepare(self, first: int, count: int) -> None:
        prepare(self.simulator, self.configuration, first, count)

    def kept(self, folder: Path) -> float:
        """Seconds of the same steps with the last ones held and every failure found."""
        c = self.configuration
        self.simulator.set_state(self._begin)
        watch = watch_of(c, self.description)
        sink = Sink(folder / "kept.mcap", compression="none")
        bits = {bit.bit: bit.name for bit in self.description.overflow_bits}
        writer = FlightWriter(sink, watch, bits, n_env=c.n_env, dt=c.dt)
        flight = self.simulator.flight(watch)
        self.held_bytes = flight.held_bytes
        gc.collect()
        writer.look(flight, flight.failures(), 0)
        begin = time.perf_counter()
        fly(
            flight, 0, c.steps,
            self._prepare,
            lambda failures, last: writer.look(flight, failures, last),
        )  # fmt: skip
        took = time.perf_counter() - begin
        writer.finish(flight)
        self.failed = writer.problem[0] if writer.problem else "none"
        sink.abandon()
        sink.partial.unlink()
        return took


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=64, steps=200, rounds=5)
    p.add_argument("--sim", default="warp")
    p.add_argument("--scene", default="inclined-collision")
    p.add_argument("--within", type=float)
    p.add_argument("--spread", type=float)
    p.add_argument("--option", action="append", default=[])
    a = p.parse_args()
    scene = make_scene(a.scene)
    bench = Bench(
        RunConfiguration(
            a.sim, a.scene, a.n_env, scene.dt, a.steps, options=split_options(a.option), keep=str(Keep(a.within)),
            initial="" if a.spread is None else str(Initial(a.spread)),
        )
    )  # fmt: skip
    ratios, bare, kept = [], [], []
    with tempfile.TemporaryDirectory() as name:
        bench.bare()
        bench.kept(Path(name))  # what is built at the first use is built
        for _ in range(a.rounds):
            durations = [bench.bare(), bench.kept(Path(name)), bench.kept(Path(name)), bench.bare()]
            ratios.append((durations[1] + durations[2]) / (durations[0] + durations[3]))
            bare += [durations[0], durations[3]]
            kept += durations[1:3]
    print(f"machine           {machine()}, {bench.description.device}")
    print(
        f"steps             {a.sim} {' '.join(a.option)}, {a.scene}, {a.n_env} envs, {a.steps} steps, {a.rounds} rounds"
    )
    print(f"kept / bare       {spread(ratios)}")
    print(f"bare step [ms]    {spread([1e3 * t / a.steps for t in bare])}")
    print(f"kept step [ms]    {spread([1e3 * t / a.steps for t in kept])}")
    print(f"held [bytes]      {bench.held_bytes}")
    print(f"failed            {bench.failed}")


if __name__ == "__main__":
    main()
