"""What a call of fingerprint costs: hashes of float32 arrays beside SHA-256 of the same bytes, in turn.

usage: python -m benchmarks.array_hashes [--numbers 10000,1000000,10000000] [--rounds 9]

A policy of a few layers has 10,000 numbers or more. Where torch is installed and shows a GPU, a tensor on it is hashed
there; the peer is copying the tensor to the host, and SHA-256 there. Both hashes of one tensor, on the GPU and on the
host, are the same.
"""

from __future__ import annotations

import hashlib
import importlib.util
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from gpusimbench.recorder.capture.array_hashes import hashed


def timed(function: Callable[[], Any]) -> float:
    """What it takes by the clock [ms]."""
    begin = time.perf_counter()
    function()
    return (time.perf_counter() - begin) * 1e3


def in_turn(ours: Callable[[], Any], peer: Callable[[], Any], rounds: int) -> tuple[list[float], list[float]]:
    """Times of both, one after the other [ms]; the first of each is not counted."""
    pairs = [(timed(ours), timed(peer)) for _ in range(rounds + 1)][1:]
    return [own for own, _ in pairs], [other for _, other in pairs]


def copied_and_hashed(tensor: Any) -> Any:
    """SHA-256 of a tensor of torch, by way of the host."""
    return hashlib.sha256(tensor.cpu().numpy().data)


def report(what: str, numbers: int, times: tuple[list[float], list[float]]) -> None:
    """Print times, and their ratio round by round."""
    ours, peers = times
    ratio = [own / other for own, other in zip(ours, peers, strict=True)]
    print(f"{what:5} {numbers:>12,}  [ms] {spread(ours, 3)}  of SHA-256: {spread(ratio)}")


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, rounds=9)
    p.add_argument("--numbers", default="10000,1000000,10000000")
    a = p.parse_args()
    print(f"machine  {machine()}")
    for count in map(int, a.numbers.split(",")):
        array = np.random.default_rng(0).normal(size=count).astype(np.float32)
        report("host", count, in_turn(partial(hashed, array, "a"), partial(hashlib.sha256, array.data), a.rounds))
        if importlib.util.find_spec("torch") is None:
            continue
        import torch

        if torch.cuda.is_available():
            tensor = torch.from_numpy(array).cuda()
            assert hashed(tensor, "a") == hashed(array, "a")
            report("GPU", count, in_turn(partial(hashed, tensor, "a"), partial(copied_and_hashed, tensor), a.rounds))


if __name__ == "__main__":
    main()
