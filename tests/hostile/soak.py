"""Spoil recordings and read them, for as long as you like.

    python -m tests.hostile.soak --minutes 60
    python -m tests.hostile.soak --mutator bombs --count 200 --seed 7

Prints one JSON object: how many of each mutator were refused, incomplete and the same. What breaks a promise is kept
under --keep, and the exit code is 1. The same seed gives the same mutants of the same corpus.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

MEMORY_BYTES = 2 << 30
"""Address space of the process, the interpreter with numpy and scipy among it."""


def main(argv: list[str] | None = None) -> int:
    """Entry point; the exit code is 1 where a promise was broken."""
    p = argparse.ArgumentParser(prog="python -m tests.hostile.soak", description=(__doc__ or "").splitlines()[0])
    p.add_argument("corpus", nargs="*", type=Path, help="good recordings (default: some are made)")
    p.add_argument("--mutator", action="append", metavar="NAME", help="default: all of them")
    p.add_argument("--seed", type=int, help="default: a random one, which is printed")
    p.add_argument("--count", type=int, help="of each mutator (default: until the time is over)")
    p.add_argument("--first", type=int, default=0, metavar="NUMBER", help="mutant of each (default: 0)")
    p.add_argument("--minutes", type=float, default=1.0)
    p.add_argument("--keep", type=Path, metavar="DIR", help="where to keep what breaks a promise")
    p.add_argument("--memory", type=int, default=MEMORY_BYTES, metavar="BYTES", help="address space allowed")
    arguments = p.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads' stacks would count as ours
    resource.setrlimit(resource.RLIMIT_AS, (arguments.memory, arguments.memory))
    seed = random.SystemRandom().randrange(2**32) if arguments.seed is None else arguments.seed
    with tempfile.TemporaryDirectory() as folder:
        from tests.hostile.corpus import make_corpus

        corpus = arguments.corpus or make_corpus(Path(folder))
        first, count = arguments.first, arguments.count
        seconds = 60 * arguments.minutes if count is None else math.inf
        numbers = range(first, sys.maxsize if count is None else first + count)
        found = soak(corpus, arguments.mutator, seed, numbers, seconds, arguments.keep)
    json.dump(found, sys.stdout, indent=1)
    print()
    return 1 if found["broken"] else 0


def soak(
    corpus: list[Path], names: list[str] | None, seed: int, numbers: range, seconds: float, keep: Path | None
) -> dict[str, object]:
    """Spoil and read the mutants of these numbers, until the time is over; what came of it by mutator, and what broke a
    promise."""
    from tests.hostile.mutate import MUTATORS
    from tests.hostile.verdict import Judge

    chosen = names or list(MUTATORS)
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in chosen}
    broken: list[str] = []
    ends = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        judge = Judge(corpus, Path(folder) / "spoiled.mcap")
        for number in numbers:
            if time.monotonic() > ends:
                break
            for place, name in enumerate(chosen):  # which is used in other ways than its neighbours are
                mutant = MUTATORS[name](random.Random(f"{seed} {name} {number}"), judge.corpus)
                try:
                    outcomes[name][judge.read(mutant, number + place)] += 1
                except BaseException as error:
                    if isinstance(error, KeyboardInterrupt):
                        raise
                    broken.append(f"{name} {number}: {type(error).__name__}: {str(error)[:300]}")
                    if keep is not None:
                        keep.mkdir(parents=True, exist_ok=True)
                        shutil.copyfile(judge.path, keep / f"{name}-{seed}-{number}.mcap")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"seed": seed, "outcomes": {n: dict(c) for n, c in outcomes.items()}, "peak_bytes": peak, "broken": broken}


if __name__ == "__main__":
    sys.exit(main())
