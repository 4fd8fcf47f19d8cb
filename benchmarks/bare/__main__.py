"""Do the warm-up and the timed steps of a recording again by a bare loop: python -m benchmarks.bare RECORDING."""

from __future__ import annotations

import gc
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.bare.loop import Loop
from benchmarks.bare.work import Done, Work
from gpusimbench.evaluator.metrics.throughput import frames_per_second


def main() -> None:
    """Step and print."""
    work = Work(Path(sys.argv[1]))
    asked = work.asked
    loop: Loop = import_module(f"benchmarks.bare.{asked.simulator}").Bare(work)
    gc.collect()
    gc.disable()  # as in the timed phase of the recorder
    loop.step(0, asked.warmup)
    rate = frames_per_second(asked.n_env, asked.timed_steps, loop.step(asked.warmup, asked.timed_steps))
    Done(rate, work.same_states(loop.state()), loop.contacts()).show()


if __name__ == "__main__":
    main()
