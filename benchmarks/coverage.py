"""Whether the intervals, tests and probabilities hold what they promise: simulated, where the truth is known.

Nothing is timed. Clouds lie on a line, where W1 is the mean difference of the sorted points, so that thousands of sets
of runs can be made; what is tested is the evaluator's own code.

usage: python -m benchmarks.coverage [--replications 300] [--seed 0]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from benchmarks.arguments import parser
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.energy import energy_distance
from gpusimbench.evaluator.statistics.jackknife import jackknife_pair_mean
from gpusimbench.evaluator.statistics.permutation import permutation_floor
from gpusimbench.evaluator.statistics.regimes import (
    Regime,
    Resampling,
    published_regime,
    regime_probabilities,
    upper_bound_of_none,
)
from gpusimbench.schemas.text import bound

RUNS = (3, 5, 10, 20)
LEVEL = 0.05
PERMUTATIONS = 99
RESAMPLES = 400
POINTS = 8  # of a run's cloud
BINS = ("below 20 %", "20 to 40 %", "40 to 60 %", "60 to 80 %", "80 % and more")
ENVS, ITEMS = 6, 5  # of a side of the permutation tests

Generator = np.random.Generator
Matrix = np.ndarray  # distances between runs, [run, run]


@dataclass(frozen=True)
class Law:
    """Where runs come from.

    name    as in the table
    matrix  distances between so many runs
    mean    expected distance of two of them
    """

    name: str
    matrix: Callable[[Generator, int], Matrix]
    mean: float


def clouds(centres: Callable[[Generator, int], np.ndarray]) -> Callable[[Generator, int], Matrix]:
    """Runs of Gaussian clouds around centres that differ from run to run."""

    def matrix(rng: Generator, n_run: int) -> Matrix:
        points = np.sort(centres(rng, n_run)[:, None] + rng.normal(size=(n_run, POINTS)), axis=1)
        distances: Matrix = np.abs(points[:, None] - points[None]).mean(axis=2)
        return distances

    return matrix


def outcomes(share: float) -> Callable[[Generator, int], Matrix]:
    """Runs that are bitwise one of two, a distance of 1 apart; the second with this probability."""

    def matrix(rng: Generator, n_run: int) -> Matrix:
        second = rng.random(n_run) < share
        distances: Matrix = (second[:, None] != second[None]).astype(float)
        return distances

    return matrix


def mean_of(matrix: Callable[[Generator, int], Matrix], rng: Generator) -> float:
    """Expected distance of two runs, of fifty thousand pairs of runs."""
    return float(np.mean([matrix(rng, 2)[0, 1] for _ in range(50_000)]))


def laws(rng: Generator) -> list[Law]:
    """Of the first table."""
    gaussian = clouds(lambda r, n: r.normal(size=n))
    heavy = clouds(lambda r, n: r.standard_t(3, size=n))
    return [
        Law("Gaussian clouds", gaussian, mean_of(gaussian, rng)),
        Law("two outcomes, 1 : 1", outcomes(0.5), 0.5),
        Law("two outcomes, 9 : 1", outcomes(0.1), 0.18),
        Law("heavy tails, t(3)", heavy, mean_of(heavy, rng)),
    ]


def of_pairs(matrix: Matrix) -> tuple[float, float]:
    """The interval that takes pairs of runs for independent."""
    pairs = matrix[np.triu_indices(len(matrix), 1)]
    reach = stdtrit(len(pairs) - 1, 0.975) * pairs.std(ddof=1) / np.sqrt(len(pairs))
    return pairs.mean() - reach, pairs.mean() + reach


def of_bootstrap(matrix: Matrix, rng: Generator) -> tuple[float, float]:
    """Percentiles over resampled runs; a run drawn twice is no pair with itself."""
    n_run = len(matrix)
    counts = rng.multinomial(n_run, np.full(n_run, 1 / n_run), size=RESAMPLES).astype(float)
    counts = counts[counts.max(axis=1) < n_run]
    pairs = n_run**2 - (counts**2).sum(axis=1)
    means = ((counts @ matrix) * counts).sum(axis=1) / pairs
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def interval_rows(replications: int, rng: Generator) -> list[tuple[str, ...]]:
    """Share of intervals that hold the truth, by law and number of runs, of the sets of runs that differ at all."""
    rows = []
    for law in laws(rng):
        for n_run in RUNS:
            hits = np.zeros(3)
            none = 0
            for _ in range(replications):
                matrix = law.matrix(rng, n_run)
                if not matrix.any():
                    none += 1  # the evaluator gives no interval then
                    continue
                found = jackknife_pair_mean(matrix)
                assert not isinstance(found.ci95, Missing)
                ends = (found.ci95, of_pairs(matrix), of_bootstrap(matrix, rng))
                hits += [low <= law.mean <= high for low, high in ends]
            shares = hits / max(replications - none, 1)
            rows.append((law.name, str(n_run), *map(percent, shares), percent(none / replications)))
    return rows


def permutation_rows(replications: int, rng: Generator) -> list[tuple[str, ...]]:
    """How often a permutation test rejects at 5 %, by what the items of an env share and by a true shift."""
    kinds = ("energy, whole envs", "W1, whole envs", "energy, points", "W1, points")
    rows = []
    for name, shared, shift in (
        ("same law, items independent", 0.0, 0.0),
        ("same law, items of an env alike", 1.0, 0.0),
        ("shifted by 1, items of an env alike", 1.0, 1.0),
    ):
        rejected = np.zeros(len(kinds))
        for _ in range(replications):
            envs = rng.normal(size=(2 * ENVS, ITEMS, 2)) + shared * rng.normal(size=(2 * ENVS, 1, 2))
            envs[ENVS:, :, 0] += shift
            points = envs.reshape(-1, 1, 2)
            sides = (envs[:ENVS], envs[ENVS:]), (points[: ENVS * ITEMS], points[ENVS * ITEMS :])
            seed = int(rng.integers(2**31))
            p = [
                test(*side, n_permutation=PERMUTATIONS, seed=seed).p_value
                for side in sides
                for test in (energy_distance, permutation_floor)
            ]
            rejected += np.array(p) <= LEVEL
        rows.append((name, *map(percent, rejected / replications)))
    return rows


def unit_rows(replications: int, rng: Generator) -> list[tuple[str, ...]]:
    """How often two configurations of one law, of several runs each, are called different, by what is exchanged."""
    n_run, n_env, n_item = 5, 4, 3
    rows = []
    for name, of_run in (("runs of one law", 0.0), ("runs that differ as a whole", 1.0)):
        rejected = np.zeros(3)
        for _ in range(replications):
            runs = rng.normal(size=(2 * n_run, n_env, n_item, 2)) + rng.normal(size=(2 * n_run, n_env, 1, 2))
            runs += of_run * rng.normal(size=(2 * n_run, 1, 1, 2))
            seed = int(rng.integers(2**31))
            p = []
            for items in (n_env * n_item, n_item, 1):
                a, b = (side.reshape(-1, items, 2) for side in (runs[:n_run], runs[n_run:]))
                p.append(energy_distance(a, b, n_permutation=PERMUTATIONS, seed=seed).p_value)
            rejected += np.array(p) <= LEVEL
        rows.append((name, *map(percent, rejected / replications)))
    return rows


def regime_laws() -> list[Callable[[Generator, int], tuple[np.ndarray, Matrix]]]:
    """Parallel variability [run] and distances [run, run], in cm: odd runs, and runs at the edge of the rounding."""

    def apart(matrix: Callable[[Generator, int], Matrix]) -> Callable[[Generator, int], tuple[np.ndarray, Matrix]]:
        return lambda rng, n: (np.zeros(n), matrix(rng, n))

    def edge(scale: float, draw: Callable[[Generator, int], np.ndarray]) -> Callable[[Generator, int], Matrix]:
        def matrix(rng: Generator, n_run: int) -> Matrix:
            x = scale * draw(rng, n_run)
            return np.abs(x[:, None] - x[None])

        return matrix

    def odd_parallel(share: float) -> Callable[[Generator, int], tuple[np.ndarray, Matrix]]:
        return lambda rng, n: ((rng.random(n) < share).astype(float), np.zeros((n, n)))

    return [
        *[apart(outcomes(share)) for share in (0.03, 0.1, 0.2, 0.3, 0.5)],
        *[odd_parallel(share) for share in (0.1, 0.3)],
        *[apart(edge(scale, lambda r, n: r.normal(size=n))) for scale in (0.003, 0.004, 0.0044, 0.005, 0.007)],
        apart(edge(0.0025, lambda r, n: r.standard_t(3, size=n))),
    ]


def predictions(
    replications: int, n_run: int, method: Resampling, rng: Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predicted probabilities and what another sample of runs was, both [case, type], and where all runs agreed."""
    predicted, came, agreed = [], [], []
    for law in regime_laws():
        for _ in range(replications):
            parallel, matrix = law(rng, n_run)
            seed = int(rng.integers(2**31))
            classes = np.unique(matrix, axis=0, return_inverse=True)[1].reshape(-1)
            found = regime_probabilities(parallel, matrix, classes, seed=seed, n_draw=RESAMPLES, method=method)
            predicted.append(found.probabilities)
            agreed.append(bool(found.agreement) and found.parallel_below is not None)
            parallel, matrix = law(rng, n_run)
            regime = published_regime(float(parallel.mean()), float(matrix.sum() / (n_run * (n_run - 1))))
            came.append([regime == t for t in Regime])
    return np.array(predicted), np.array(came), np.array(agreed)


def regime_rows(replications: int, rng: Generator) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Scores of each method, and how often what the default one predicted came."""
    scores, calibration = [], []
    for n_run in RUNS:
        brier, error = [], []
        for method in Resampling:
            predicted, came, agreed = predictions(replications, n_run, method, rng)
            brier.append(f"{((predicted - came) ** 2).sum(axis=1)[~agreed].mean():.2f}")
            # types that no run at hand showed are predicted with 0 and say nothing of the scale
            known = (predicted > 0) & ~agreed[:, None]
            bins = np.minimum((predicted * len(BINS)).astype(int), len(BINS) - 1)
            inside = [known & (bins == i) for i in range(len(BINS))]
            gaps = [abs(predicted[i].sum() - came[i].sum()) for i in inside]
            error.append(percent(sum(gaps) / known.sum()))
            if method is Resampling.POLYA:
                cells = [
                    f"{percent(predicted[i].mean())} -> {percent(came[i].mean())}" if i.any() else "" for i in inside
                ]
                top = predicted[agreed].argmax(axis=1)
                kept = came[agreed][np.arange(len(top)), top].mean()
                calibration.append((str(n_run), *cells, percent(kept)))
        scores.append((str(n_run), *brier, *error))
    return scores, calibration


def bound_rows(replications: int, rng: Generator) -> list[tuple[str, ...]]:
    """How often all runs agree and another differs with more than the bound says: the worst of many laws."""
    rows = []
    cases = [*[(share, 1 - share) for share in np.linspace(0.02, 0.5, 25)], *[(1 / k,) * k for k in range(3, 31)]]
    for n_run in RUNS:
        worst = {n_run - 1: 0.0, n_run: 0.0}
        for shares in cases:
            weights = np.array(shares)
            ends = rng.choice(len(weights), p=weights / weights.sum(), size=(20 * replications, n_run))
            agree = (ends == ends[:, :1]).all(axis=1)
            differs = 1 - weights[ends[:, 0]]
            for trials in worst:
                wrong = float((agree & (differs > upper_bound_of_none(trials))).mean())
                worst[trials] = max(worst[trials], wrong)
        rows.append((str(n_run), bound(upper_bound_of_none(n_run - 1)), *map(percent, worst.values())))
    return rows


def percent(share: float) -> str:
    """In whole percent."""
    return f"{100 * share:.0f} %"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """As Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)) + "\n"


def main() -> None:
    """Simulate and print."""
    p = parser(__doc__)
    p.add_argument("--replications", type=int, default=300, help="sets of runs for each row (default: %(default)s)")
    p.add_argument("--seed", type=int, default=0, help="of everything that is drawn (default: %(default)s)")
    a = p.parse_args()
    if a.replications < 20:
        p.error("--replications must be at least 20: fewer leave rows without a case")
    rng = np.random.default_rng(a.seed)
    print(f"Seed {a.seed}, {a.replications} replications: a share of 95 % is known to "
          f"{100 * 1.96 * np.sqrt(0.95 * 0.05 / a.replications):.1f} %.\n")  # fmt: skip
    print("Intervals of 95 % for the mean distance of two runs: how many hold it\n")
    columns = ("law", "runs", "jackknife over runs", "pairs as independent", "bootstrap over runs", "no interval")
    print(table(columns, interval_rows(a.replications, rng)))
    print("Permutation tests at 5 %: how many reject\n")
    head = ("law", "energy, whole envs", "W1, whole envs", "energy, points", "W1, points")
    print(table(head, permutation_rows(a.replications, rng)))
    print("Two configurations of one law, 5 runs each, at 5 %: how many are called different by the energy distance\n")
    exchanged = ("law", "whole runs exchanged", "whole envs exchanged", "points exchanged")
    print(table(exchanged, unit_rows(a.replications, rng)))
    scores, calibration = regime_rows(max(a.replications // 5, 1), rng)
    print("Probabilities of regimes where runs do not all agree: Brier score, and mean error of the scale\n")
    names = [m.value for m in Resampling]
    print(table(("runs", *[f"{n}, score" for n in names], *[f"{n}, error" for n in names]), scores))
    print("Probabilities of regimes by the default, polya: predicted -> came\n")
    print(table(("runs", *BINS, "all agreed: came again"), calibration))
    print("Bound where all runs agree: how often it is wrong, for the law that is worst\n")
    print(table(("runs", "bound", "wrong, R - 1 trials", "wrong, R trials"), bound_rows(a.replications, rng)))


if __name__ == "__main__":
    main()
