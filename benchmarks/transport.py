"""Exact W1 against SciPy, lapx and POT, on the same pairs in one run, in CPU seconds.

usage: python -m benchmarks.transport [--n-env 4096] [--n-item 27] [--peer-pairs 2000] [--runs 10] [--points 432]

Pairs of environments: clouds of one law; clouds that are shifted, each by its own way, by as much as they are wide;
copies of one outcome, perturbed by a centimetre or by a millionth. Peers solve the first pairs only, costs and all, and
must find the same distances. Then whole calls: all pairs of --n-env distinct environments without a matrix; 16 distinct
among them with one; and runs of --points points against each other. Compilation is measured apart.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from benchmarks.arguments import parser
from benchmarks.machine import machine
from gpusimbench.evaluator.metrics.variability import parallel_variability, run_to_run_variability
from gpusimbench.evaluator.transport.small import KERNEL_PAIRS, pairwise_summary, pairwise_wasserstein1

Points = NDArray[np.float64]
Peer = Callable[[Points], float]


def _scipy(distance: Points) -> float:
    return float(distance[linear_sum_assignment(distance)].mean())


def _lapx() -> Peer | None:
    if importlib.util.find_spec("lap") is None:
        print("lapx is not installed: left out")
        return None
    import lap

    return lambda distance: float(lap.lapjv(distance, return_cost=True)[0]) / len(distance)


def _pot() -> Peer:
    import ot

    def solve(distance: Points) -> float:
        n = len(distance)
        largest = distance.max()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return float(ot.emd2(np.ones(n), np.ones(n), distance / largest, numItermax=10**9) * largest / n)

    return solve


def _envs(n_env: int, n_item: int) -> Iterator[tuple[str, Points]]:
    rng = np.random.default_rng(0)
    outcome = rng.uniform(-0.3, 0.3, size=(n_item, 2))
    noise = rng.normal(size=(n_env, n_item, 2))
    yield "clouds of one law", noise
    yield "shifted clouds", noise + rng.normal(size=(n_env, 1, 2))
    yield "copies, 1 cm apart", outcome + 0.01 * noise
    yield "copies, 1 um apart", outcome + 1e-6 * noise


def _timed(work: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    began = time.process_time()
    result = work(*arguments)
    return time.process_time() - began, result


def _peers_beside(name: str, envs: Points, peers: dict[str, Peer], peer_pairs: int) -> None:
    pairs = len(envs) * (len(envs) - 1) // 2
    seconds, matrix = _timed(pairwise_wasserstein1, envs)
    ours = seconds / pairs * 1e6
    print(f"{name + ' [us a pair]':<32} ours {ours:.1f}", end="")
    first, second = (index[:: max(1, pairs // peer_pairs)] for index in np.triu_indices(len(envs), k=1))
    for peer, solve in peers.items():
        took, found = _timed(lambda s: [s(cdist(envs[i], envs[j])) for i, j in zip(first, second, strict=True)], solve)
        np.testing.assert_allclose(found, matrix[first, second], rtol=1e-9)
        each = took / len(first) * 1e6
        claim = " (claim: at least 4)" if peer == "scipy" else ""
        print(f"   {peer} {each:.1f}, ratio {each / ours:.1f}{claim}", end="")
    print()


def _runs_beside(name: str, runs: Points, peers: dict[str, Peer]) -> None:
    seconds, found = _timed(run_to_run_variability, runs)
    first, second = np.triu_indices(len(runs), k=1)
    print(f"{name + ' [s]':<32} ours {seconds:.2f} (claim: under 3)", end="")
    pooled = runs.reshape(len(runs), -1, 2)
    for peer, solve in peers.items():
        took, distance = _timed(lambda s: s(cdist(pooled[0], pooled[1])), solve)
        np.testing.assert_allclose(distance * 100.0, found.matrix_cm[0, 1], rtol=1e-9)
        print(f"   {peer} {took * len(first):.2f} (from one pair)", end="")
    print()


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_item=27, runs=10)
    p.add_argument("--n-env", type=int, default=4096, help="environments of the whole calls")
    p.add_argument("--peer-pairs", type=int, default=2000, help="about how many pairs peers solve")
    p.add_argument("--points", type=int, default=432, help="of a run")
    a = p.parse_args()
    print(f"machine: {machine()}; seconds are of the CPU, all threads together")
    peers = {name: peer for name, peer in (("scipy", _scipy), ("lapx", _lapx()), ("pot", _pot())) if peer is not None}

    few = 2 + int((2 * KERNEL_PAIRS) ** 0.5)
    prepared, _ = _timed(pairwise_wasserstein1, np.random.default_rng(1).normal(size=(few, 1, 2)))
    print(f"{'compiled code made or loaded [s]':<32} {prepared:.1f}")
    for name, envs in _envs(400, a.n_item):
        _peers_beside(name, envs, peers, a.peer_pairs)
    for name, envs in _envs(a.n_env, a.n_item):
        seconds, found = _timed(pairwise_summary, envs)
        what = f"all pairs of {a.n_env}, {name} [s]"
        print(f"{what:<48} {seconds:.1f}   claim: at most 90 for 4096 x 27   mean {found.mean:.6g}")
    rng = np.random.default_rng(2)
    which = rng.integers(0, 16, size=a.n_env)
    few_distinct = rng.normal(size=(16, a.n_item, 2))[which]
    for work in (parallel_variability, pairwise_wasserstein1):
        seconds, _ = _timed(work, few_distinct)
        print(f"{f'16 distinct of {a.n_env}, {work.__name__} [s]':<48} {seconds:.2f}   claim: under 1")
    runs = rng.normal(size=(a.runs, 1, a.points, 2))
    _runs_beside(f"{a.runs} runs of one law", runs, peers)
    _runs_beside(f"{a.runs} shifted runs", runs + 5.0 * rng.normal(size=(a.runs, 1, 1, 2)), peers)


if __name__ == "__main__":
    main()
