"""Start of each command against an empty Python, in turn.

usage: python -m benchmarks.start_up [--repeats 15]
"""

from __future__ import annotations

import subprocess
import sys
import time

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread

COMMANDS = {"gsb-record": "gpusimbench.recorder.cli", "gsb-eval": "gpusimbench.evaluator.cli.eval"}


def _timed(*arguments: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    return time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=15)
    a = p.parse_args()
    times: dict[str, list[float]] = {name: [] for name in ("python -c pass", *COMMANDS)}
    for _ in range(a.repeats):
        times["python -c pass"].append(_timed("-c", "pass"))
        for name, module in COMMANDS.items():
            times[name].append(_timed("-m", module, "--help"))
    print(f"machine                {machine()}")
    for name, seconds in times.items():
        claim = "   claim: under 0.2 s" if name in COMMANDS else ""
        print(f"{name + ' --help' if name in COMMANDS else name:<22} [s] {spread(seconds)}{claim}")


if __name__ == "__main__":
    main()
