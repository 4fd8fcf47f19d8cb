"""What part of a processor the thread takes that samples memory at 100 Hz during a run, with and without GPUs.

usage: python -m benchmarks.memory_sampler [--seconds 10] [--repeats 5]

The main thread sleeps meanwhile, so all CPU time of the process is the sampler's. The floor is a sampler that reads
nothing at the same rate, in turn. CUDA_VISIBLE_DEVICES chooses the GPUs that are read, none if it is empty.
"""

from __future__ import annotations

import time
from typing import Any

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import MEMORY_INTERVAL_S, MemorySampler, Sampler

_READINGS = 500


class Nothing(Sampler[None]):
    """A sampler that wakes up and reads nothing."""

    def _read(self) -> None:
        pass


def share(sampler: Sampler[Any], seconds: int) -> float:
    """CPU time of this process for each second in which the sampler runs [%]."""
    sampler.start()
    began, used = time.perf_counter(), time.process_time()
    time.sleep(seconds)
    used, lasted = time.process_time() - used, time.perf_counter() - began
    sampler.stop()
    sampler.take()
    return 100 * used / lasted


def reading_ms(gpus: Gpus) -> float:
    """A reading of all sources by the clock [ms], without pauses between readings."""
    sampler = MemorySampler(gpus)
    sampler.read_now()  # what is looked up once
    began = time.perf_counter()
    for _ in range(_READINGS):
        sampler.read_now()
    return 1e3 * (time.perf_counter() - began) / _READINGS


def main() -> None:
    """Measure and print."""
    a = parser(__doc__, seconds=10, repeats=5).parse_args()
    ours, floor, each = [], [], []
    with Gpus() as gpus:
        for _ in range(a.repeats):
            ours.append(share(MemorySampler(gpus), a.seconds))
            floor.append(share(Nothing("nothing", MEMORY_INTERVAL_S), a.seconds))
            each.append(reading_ms(gpus))
        print(f"machine                        {machine()}, {len(gpus)} GPUs")
    print(f"sampler, of a processor [%]    {spread(ours, 2)}")
    print(f"floor, of a processor [%]      {spread(floor, 2)}")
    print(f"a reading, without pauses [ms] {spread(each)}")


if __name__ == "__main__":
    main()
