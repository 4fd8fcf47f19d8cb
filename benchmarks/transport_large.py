"""Certified W1 of 30,000 and 110,592 points against its claims, and against exact solvers where those fit in memory.

CPU seconds, not wall time: nothing here runs on more than one thread. The floor of a case is one search for the nearest
neighbour of each point in the other set, by scipy's kd-tree.

usage: python -m benchmarks.transport_large [--peer-points 5000]
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.arguments import parser
from benchmarks.machine import machine

N_ITEM = 27
N_ENV = 4096
Floats = npt.NDArray[np.float64]


def thrown(n: int, seed: int, law: int = 5) -> Floats:
    """Places [cm] of cubes thrown over a board of 60 x 60 cm, shape [n, 2].

    Each of 27 cubes has a place that it mostly comes to rest near, more or less precisely; a quarter roll anywhere, and
    what would leave the board stays at its edge.
    """
    of_law, draw = np.random.default_rng(law), np.random.default_rng(seed)
    rest, width = of_law.uniform(-14, 14, (N_ITEM, 2)), of_law.uniform(0.8, 5, N_ITEM)
    shape = (-(-n // N_ITEM), N_ITEM, 2)
    near = rest + width[:, None] * draw.standard_normal(shape)
    points = np.where(draw.random(shape[:2])[..., None] < 0.25, draw.uniform(-30, 30, shape), near)
    return np.clip(points, -30, 30).reshape(-1, 2)[:n]


def uniform(n: int, seed: int) -> Floats:
    """Places [cm] anywhere on the board, shape [n, 2]."""
    return np.random.default_rng(seed).uniform(-30, 30, (n, 2))


def normal(n: int, seed: int) -> Floats:
    """Places [cm] of one round cluster, shape [n, 2]."""
    return 10 * np.random.default_rng(seed).standard_normal((n, 2))


def repeated(n: int, seed: int) -> Floats:
    """Places [cm] of environments that come in 500 kinds, shape [n, 2]."""
    draw = np.random.default_rng(seed)
    kinds = thrown(500 * N_ITEM, seed).reshape(500, -1)
    return kinds[draw.integers(0, 500, -(-n // N_ITEM))].reshape(-1, 2)[:n]


def _timed(function: Callable[..., Any], *arguments: Any, **options: Any) -> tuple[Any, float]:
    began = time.process_time()
    result = function(*arguments, **options)
    return result, time.process_time() - began


def _nearest(a: Floats, b: Floats) -> None:
    from scipy.spatial import KDTree

    KDTree(b).query(a)


def _exact(a: Floats, b: Floats) -> float:
    from gpusimbench.evaluator.transport.pair import mean_assignment_distance
    from gpusimbench.evaluator.transport.points import distance_matrix

    return mean_assignment_distance(distance_matrix(a, b))


def main() -> None:
    """Measure and print."""
    p = parser(__doc__)
    p.add_argument("--peer-points", type=int, default=2000, help="points where the exact solvers run too")
    a = p.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"] = cache  # so that compiling is measured, not found done
        from gpusimbench.evaluator.transport.large import certified_wasserstein1
        from gpusimbench.evaluator.transport.pair import wasserstein1

        _, compiling = _timed(certified_wasserstein1, thrown(100, 1), thrown(100, 2))
        print(f"machine                    {machine()}")
        print(f"importing and compiling    {compiling:.1f} CPU s, once")
        whole = N_ENV * N_ITEM
        print("\ncase                            points  low [cm]   high [cm]  gap [cm]  gap    CPU s  / floor   claim")
        for name, law, n, shift, options, claim in (
            ("thrown, shifted (5, 3) cm", thrown, 30_000, (5, 3), {"relative": 0, "absolute": 1e-3}, "1e-3 cm in 60 s"),
            ("thrown, one law", thrown, whole, (0, 0), {}, "1 % in 120 s"),
            ("thrown, shifted 4 cm", thrown, whole, (4, 0), {}, "1 % in 120 s"),
            ("uniform, one law", uniform, whole, (0, 0), {}, ""),
            ("normal, one law", normal, whole, (0, 0), {}, ""),
            ("500 kinds of env, one law", repeated, whole, (0, 0), {}, ""),
            ("500 kinds of env, shifted 4 cm", repeated, whole, (4, 0), {}, ""),
        ):
            one, other = law(n, 1), law(n, 2) + np.array(shift)
            bounds, seconds = _timed(certified_wasserstein1, one, other, **options)
            _, floor = _timed(_nearest, one, other)
            gap = bounds.high - bounds.low
            print(
                f"{name:31} {n:6d}  {bounds.low:9.6f}  {bounds.high:9.6f}  {gap:8.6f}  {gap / bounds.high:5.2%}"
                f"  {seconds:5.1f}  {seconds / floor:7.0f}   {claim}"
            )
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"\npeak memory so far         {peak:.0f} MiB; a matrix of {whole} x {whole} has {8 * whole**2 / 2**20:.0f}"
        )
        n = a.peer_points
        print(f"\n{n} points, CPU s           certified 1 %  certified 1e-6   POT   scipy   POT / 1e-6   scipy / 1e-6")
        for name, shift in (("one law", (0, 0)), ("shifted 4 cm", (4, 0))):
            one, other = thrown(n, 1), thrown(n, 2) + np.array(shift)
            loose, loosely = _timed(certified_wasserstein1, one, other)
            tight, tightly = _timed(certified_wasserstein1, one, other, relative=1e-6)
            simplex, by_pot = _timed(wasserstein1, one, other)
            value, by_scipy = _timed(_exact, one, other)
            for bounds in (loose, tight):
                for found in (simplex.value, value):
                    if not bounds.low <= found * (1 + 1e-9) or not found * (1 - 1e-9) <= bounds.high:
                        raise SystemExit(f"{found} is not within {bounds}")
            print(
                f"{name:24} {loosely:15.2f}  {tightly:14.2f}  {by_pot:4.1f}  {by_scipy:6.1f}"
                f"  {by_pot / tightly:11.1f}  {by_scipy / tightly:13.1f}"
            )


if __name__ == "__main__":
    main()
