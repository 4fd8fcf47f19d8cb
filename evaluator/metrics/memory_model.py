"""Memory as a function of the number of environments: a constant and a cost per environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MIN_POINTS = 3
"""Two points lie on a line whatever they are; only a third can disagree."""

HOLDS_WITHIN = 0.10
"""Largest relative residual with which the model is called good."""


@dataclass(frozen=True)
class MemoryModel:
    """bytes = fixed + per_env * N, fitted over a sweep.

    fixed, per_env            [bytes], [bytes per env]
    fixed_se, per_env_se      their standard errors [same units], from the residuals
    n                         numbers of environments that were fitted
    residuals                 (model - measured) / measured at each of them, in that order
    """

    fixed: float
    per_env: float
    fixed_se: float
    per_env_se: float
    n: tuple[int, ...]
    residuals: tuple[float, ...]

    @property
    def largest_residual(self) -> float:
        """Largest relative residual, without its sign."""
        return max(abs(r) for r in self.residuals)

    @property
    def worst_n(self) -> int:
        """The number of environments at which it is."""
        return max(zip(self.residuals, self.n, strict=True), key=lambda pair: abs(pair[0]))[1]

    @property
    def holds(self) -> bool:
        """Whether the model is within HOLDS_WITHIN everywhere; allocators that grow in powers of two break it."""
        return self.largest_residual <= HOLDS_WITHIN

    def at(self, n_env: float) -> float:
        """What the model says of so many environments [bytes]."""
        return self.fixed + self.per_env * n_env


def fit_memory(n_env: Sequence[int], measured: Sequence[float]) -> MemoryModel:
    """Least squares of relative errors.

        minimise  sum_i ((fixed + per_env N_i - M_i) / M_i)^2

    Memory of a sweep spans decades. Unweighted, the largest N alone would decide and the constant be lost; relative
    errors weigh each point alike, and suit allocators whose granules grow with what they hand out. Standard errors,
    with X the rows (1, N_i) / M_i and r the residuals:

        cov = sum r^2 / (n - 2) * inverse(X'X)

    Args:
        n_env: numbers of environments, one a point.
        measured: memory increments M [bytes].

    Raises:
        ValueError: fewer than MIN_POINTS different N, or a point that is not positive and finite.
    """
    if len(n_env) != len(measured):
        raise ValueError(f"{len(n_env)} numbers of environments and {len(measured)} measurements")
    if len(set(n_env)) < MIN_POINTS:
        raise ValueError(f"needs at least {MIN_POINTS} numbers of environments, got {len(set(n_env))}")
    for n, used in zip(n_env, measured, strict=True):
        if n < 1 or not (math.isfinite(used) and used > 0):
            raise ValueError(f"memory must be positive and finite at 1 or more environments: {used} bytes at {n}")
    count, memory = np.array(n_env, dtype=np.float64), np.array(measured, dtype=np.float64)
    design = np.column_stack([1.0 / memory, count / memory])
    size = np.linalg.norm(design, axis=0)  # columns of one size: the fit is as exact as the numbers allow
    q, r = np.linalg.qr(design / size)
    solution = np.linalg.solve(r, q.T @ np.ones(len(count)))
    residuals = (design / size) @ solution - 1.0
    inverse = np.linalg.inv(r)
    variance = float(residuals @ residuals) / (len(count) - 2)
    errors = np.sqrt(variance * (inverse**2).sum(axis=1)) / size
    fixed, per_env = solution / size
    return MemoryModel(
        float(fixed), float(per_env), float(errors[0]), float(errors[1]), tuple(n_env), tuple(residuals.tolist())
    )
