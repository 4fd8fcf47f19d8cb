"""Reproducibility regimes as published, Types 1 to 4, and what other runs of a configuration would be called."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
import numpy.typing as npt

DECIMALS_CM = 2

PRESENT_FROM_CM = 0.005
"""The smallest float64 that does not round to 0.00 cm: `is_present(v)` is v >= this."""

CONFIDENCE = 0.95
MIN_RUNS = 3
"""With two runs there is one pair, and resampling has nothing to choose from."""


class Regime(IntEnum):
    """Published type, by which of the two variabilities is present."""

    PARALLEL_ONLY = 1
    NEITHER = 2
    BOTH = 3
    RUN_TO_RUN_ONLY = 4


REGIME_MEANING: dict[int, str] = {
    1: "Parallel envs of one run differ, and repeated runs agree, rounded to 0.01 cm.",
    2: "Parallel envs of one run agree, and repeated runs agree, rounded to 0.01 cm.",
    3: "Parallel envs of one run differ, and repeated runs differ, rounded to 0.01 cm.",
    4: "Parallel envs of one run agree, and repeated runs differ, rounded to 0.01 cm.",
}


def is_present(variability_cm: float) -> bool:
    """Whether a variability [cm] is nonzero after rounding to 0.01 cm (GPUSimBench definition).

    Raises:
        ValueError: the value is negative or not finite.
    """
    if not (math.isfinite(variability_cm) and variability_cm >= 0.0):
        raise ValueError(f"variability must be finite and not negative, got {variability_cm} cm")
    return round(variability_cm, DECIMALS_CM) > 0.0


def published_regime(parallel_cm: float, run_to_run_cm: float) -> Regime:
    """Regime of a simulator (GPUSimBench definition), an int from 1 to 4.

    A rounded planar distance: "absent" does not mean bit-identical. It belongs to one simulator,
    version, set of switches, GPU and scene, and is to be shown with them.

    Args:
        parallel_cm: parallel variability [cm].
        run_to_run_cm: run-to-run variability [cm].

    Raises:
        ValueError: a value is negative or not finite.
    """
    return {
        (True, False): Regime.PARALLEL_ONLY,
        (False, False): Regime.NEITHER,
        (True, True): Regime.BOTH,
        (False, True): Regime.RUN_TO_RUN_ONLY,
    }[is_present(parallel_cm), is_present(run_to_run_cm)]


class Resampling(Enum):
    """How samples of runs are made of the runs at hand.

    BOOTSTRAP  R runs with replacement, each with probability 1/R (Efron 1979)
    POLYA      the probabilities themselves drawn from Dirichlet(1, ..., 1), then R runs with them: the predictive law
               of the Bayesian bootstrap (Rubin 1981). It also knows that the shares of R runs are not those of all
    HALF       R // 2 runs, at least two, without replacement: the delete-d jackknife (Shao and Wu 1989)
    """

    BOOTSTRAP = "bootstrap"
    POLYA = "polya"
    HALF = "half"


@dataclass(frozen=True)
class RegimeProbabilities:
    """The published regime of a sample of runs, and how it would come out again.

    observed           of the runs at hand
    probabilities      of Types 1, 2, 3, 4 for another sample of as many runs
    decided_by         runs without which the regime is another
    run_differs_below  all runs agree with the first one, so that another run does not with less than this probability,
                       at 95 %; None where not all agree
    agreement          "bits" or "rounding": in what they agree; empty where they do not
    parallel_below     all runs are alike in having parallel variability or none, so that another is not with less than
                       this probability, at 95 %; None where they are not alike
    method, draws, seed    how the probabilities were drawn
    runs, distinct     runs at hand, and how many of them differ in any bit
    """

    observed: Regime
    probabilities: tuple[float, float, float, float]
    decided_by: tuple[int, ...]
    run_differs_below: float | None
    agreement: str
    parallel_below: float | None
    method: Resampling
    draws: int
    seed: int
    runs: int
    distinct: int


def regime_probabilities(
    parallel_cm: npt.ArrayLike,
    run_matrix_cm: npt.ArrayLike,
    classes: npt.ArrayLike,
    *,
    seed: int,
    n_draw: int = 10_000,
    method: Resampling = Resampling.POLYA,
) -> RegimeProbabilities:
    """Probability of each published type, by resampling whole runs.

    With c_r the number of times that run r was drawn, a sample has

        parallel    = sum_r c_r p_r / sum_r c_r
        run to run  = sum_(r != r') c_r c_r' W[r, r'] / sum_(r != r') c_r c_r'

    A run that was drawn twice is at distance zero from itself. That says nothing of the engine and is left out; samples
    of one and the same run are drawn again.

    Where all runs agree, resampling can only give probability one. What that is worth is the bound: if another run
    differed from the first with probability q, then R - 1 runs would all agree with it with (1 - q)^(R - 1), which
    falls below 5 % at q = 1 - 0.05^(1 / (R - 1)), about 3 / (R - 1) (the rule of three; exact: Clopper and
    Pearson 1934). R - 1, since the first run only says what is to be agreed with.

    Args:
        parallel_cm: parallel variability of each run [cm], shape [n_run].
        run_matrix_cm: W1 between runs [cm], shape [n_run, n_run]; symmetric, zero on the diagonal.
        classes: bitwise class of each run, shape [n_run].
        seed: of the draws.
        n_draw: samples to draw, at least 1.
        method: how; by `benchmarks/coverage.py`, the default is the best calibrated one from ten runs on.

    Raises:
        ValueError: fewer than three runs, no draws, shapes that do not agree, a matrix that is no distance matrix,
            values that are negative or not finite.
    """
    parallel, matrix, labels = _checked(parallel_cm, run_matrix_cm, classes)
    if n_draw < 1:
        raise ValueError(f"n_draw must be at least 1, got {n_draw}")
    n_run = len(parallel)
    observed = _regime(parallel, matrix)
    counts = _draw(n_run, n_draw, method, np.random.default_rng(seed))
    types = _types(counts, parallel, matrix)
    without = tuple(_regime(np.delete(parallel, r), np.delete(np.delete(matrix, r, 0), r, 1)) for r in range(n_run))
    agreement = "bits" if (labels == labels[0]).all() else "rounding" if (matrix < PRESENT_FROM_CM).all() else ""
    alike = len(set((parallel >= PRESENT_FROM_CM).tolist())) == 1
    share = [float((types == t).mean()) for t in Regime]
    return RegimeProbabilities(
        observed=observed,
        probabilities=(share[0], share[1], share[2], share[3]),
        decided_by=tuple(r for r, regime in enumerate(without) if regime != observed),
        run_differs_below=upper_bound_of_none(n_run - 1) if agreement else None,
        agreement=agreement,
        parallel_below=upper_bound_of_none(n_run) if alike else None,
        method=method,
        draws=n_draw,
        seed=seed,
        runs=n_run,
        distinct=len(set(labels.tolist())),
    )


def upper_bound_of_none(trials: int) -> float:
    """Upper 95 % bound on the probability of what happened in none of so many trials: 1 - 0.05^(1 / trials)."""
    if trials < 1:
        raise ValueError(f"trials must be at least 1, got {trials}")
    return float(1.0 - (1.0 - CONFIDENCE) ** (1.0 / trials))


def _checked(
    parallel_cm: npt.ArrayLike, run_matrix_cm: npt.ArrayLike, classes: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    parallel = np.asarray(parallel_cm, dtype=np.float64)
    matrix = np.asarray(run_matrix_cm, dtype=np.float64)
    labels = np.asarray(classes, dtype=np.int64)
    n_run = len(parallel) if parallel.ndim == 1 else -1
    if n_run < 0 or matrix.shape != (n_run, n_run) or labels.shape != (n_run,):
        raise ValueError(
            f"shapes must be [n_run], [n_run, n_run], [n_run], got {list(parallel.shape)}, {list(matrix.shape)}, "
            f"{list(labels.shape)}"
        )
    if n_run < MIN_RUNS:
        raise ValueError(f"probabilities of a regime need at least {MIN_RUNS} runs, got {n_run}")
    for values in (parallel, matrix):
        if not np.isfinite(values).all() or (values < 0.0).any():
            raise ValueError("variabilities must be finite and not negative")
    if np.diagonal(matrix).any() or not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise ValueError("run_matrix_cm must be symmetric, with a diagonal of zeros")
    return parallel, matrix, labels


def _regime(parallel: npt.NDArray[np.float64], matrix: npt.NDArray[np.float64]) -> Regime:
    n_run = len(parallel)
    return published_regime(float(parallel.mean()), float(matrix.sum() / (n_run * (n_run - 1))))


def _draw(n_run: int, n_draw: int, method: Resampling, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """How often each run is in each sample, shape [n_draw, n_run]; no sample consists of one run."""
    if method is Resampling.HALF:
        size = max(2, n_run // 2)
        rank = rng.random((n_draw, n_run)).argsort(axis=1).argsort(axis=1)
        return (rank < size).astype(np.float64)
    counts = np.zeros((n_draw, n_run))
    left = np.arange(n_draw)
    while left.size:  # at three runs the Polya urn gives one run alone in 3 of 10 samples, else more rarely
        weights = np.full((left.size, n_run), 1.0 / n_run)
        if method is Resampling.POLYA:
            weights = rng.dirichlet(np.ones(n_run), size=left.size)
        counts[left] = rng.multinomial(n_run, weights)
        left = left[counts[left].max(axis=1) == n_run]
    return counts


def _types(
    counts: npt.NDArray[np.float64], parallel: npt.NDArray[np.float64], matrix: npt.NDArray[np.float64]
) -> npt.NDArray[np.int64]:
    """Published type of each sample, shape [n_draw]."""
    size = counts.sum(axis=1)
    pairs = size**2 - (counts**2).sum(axis=1)
    mean = counts @ parallel / size
    apart = ((counts @ matrix) * counts).sum(axis=1) / pairs
    present = mean >= PRESENT_FROM_CM, apart >= PRESENT_FROM_CM
    return np.asarray(
        np.select(
            [present[0] & ~present[1], ~present[0] & ~present[1], present[0] & present[1]],
            [Regime.PARALLEL_ONLY, Regime.NEITHER, Regime.BOTH],
            Regime.RUN_TO_RUN_ONLY,
        ),
        dtype=np.int64,
    )
