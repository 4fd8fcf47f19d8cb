"""Redraws the tables of docs/how-to/evaluate-a-policy.md: one policy, evaluated by two rules among more environments,
and how often intervals hold the true rate, and the mean return.

usage: python docs/make_episodes.py

Records the policy "sweep" of examples/search, which succeeds in 60 % of the episodes by construction, and takes 64
episodes of each recording: the first to finish, or as many of every environment. Then draws flags of environments whose
own rates differ (beta distributed), so that two episodes of an environment are correlated.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page_blocks import redraw

from gpusimbench import open_recording
from gpusimbench.evaluator.episodes.outcome import Outcome, outcome
from gpusimbench.evaluator.episodes.side import Choice, choose, read_side
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.statistics.cases import mean_interval, rate_interval, resampled, wilson

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "how-to" / "evaluate-a-policy.md"
EPISODES = 64
N_ENVS = (1, 4, 16, 64)
SEEDS = 60
DRAWS = 1000
SHAPES = ((64, 1), (8, 4), (16, 4), (64, 4))
CORRELATIONS = (0.0, 0.2, 0.6)
RATE = 0.6

sys.path.insert(0, str(ROOT / "examples" / "search"))


def evaluated(n_env: int, seed: int) -> Outcome:
    """A recording of the policy, evaluated."""
    import search

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        search.record("sweep", path, n_env, EPISODES // n_env, seed)
        episodes = choose(read_side([open_recording(path)]), EPISODES // n_env, "success", At.LAST)
        return outcome(episodes, Choice.GIVEN, "success", At.LAST)


def row(n_env: int) -> str:
    """Rates by both rules, mean over the seeds, and in how many seeds the 95 % interval contains the true rate."""
    import search

    truth = search.TRIES / search.PLACES
    early, ours = [], []
    for seed in range(SEEDS):
        success = evaluated(n_env, 1000 * seed).quantities[0]
        first = success.finish_order.mean
        early.append((first, wilson(round(first * EPISODES), EPISODES)))
        assert isinstance(success.ci95, tuple)
        ours.append((success.mean, success.ci95))
    cells = [str(n_env), str(EPISODES // n_env)]
    for found in (early, ours):
        holds = sum(low <= truth <= high for _, (low, high) in found)
        cells += [f"{100 * np.mean([rate for rate, _ in found]):.1f} %", f"{holds} of {SEEDS}"]
    return f"| {' | '.join(cells)} |"


def table() -> str:
    """The table as Markdown."""
    titles = ("environments", "episodes of each", "first 64 to finish", "interval contains 60 %", "same number of each",
              "interval contains 60 %")  # fmt: skip
    return "\n".join([f"| {' | '.join(titles)} |", "| --- " * len(titles) + "|", *map(row, N_ENVS)])


def held(n_env: int, per_env: int, correlation: float) -> tuple[float, float]:
    """Shares of draws in which our interval, and Wilson's alone, hold the true rate."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(DRAWS):
        spread = 1 / correlation - 1 if correlation else 0.0
        rates = rng.beta(RATE * spread, (1 - RATE) * spread, (n_env, 1)) if correlation else RATE
        flags = rng.random((n_env, per_env)) < rates
        intervals = rate_interval(flags), wilson(int(flags.sum()), flags.size)
        found.append([low <= RATE <= high for low, high in intervals])
    ours, alone = np.mean(found, axis=0)
    return float(ours), float(alone)


def intervals_table() -> str:
    """How often intervals hold the rate, as Markdown."""
    titles = ["environments x episodes", *(f"correlation {one:g}" for one in CORRELATIONS)]
    rows = []
    for n_env, per_env in SHAPES:
        cells = [held(n_env, per_env, correlation) for correlation in CORRELATIONS]
        rows.append(
            [f"{n_env} x {per_env}", *(f"{ours:.0%} ({alone:.0%})".replace("%", " %") for ours, alone in cells)]
        )
    return "\n".join(f"| {' | '.join(row)} |" for row in [titles, ["---"] * len(titles), *rows])


LAWS: dict[str, tuple[Callable[..., NDArray[np.float64]], float]] = {
    "normal": (np.random.Generator.normal, 0.0),
    "exponential": (np.random.Generator.exponential, 1.0),
}
"""Of the mean returns of environments: how to draw them, and their mean."""


def means(values: NDArray[np.float64], cases: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of the values of each set of cases, shape [draw]."""
    drawn: NDArray[np.float64] = values[cases].mean(axis=1)
    return drawn


def held_returns(n_env: int, law: str) -> tuple[float, float]:
    """Shares of draws in which our interval, and plain percentiles, hold the mean return."""
    draw, mean = LAWS[law]
    rng = np.random.default_rng(0)
    found = []
    for seed in range(4 * DRAWS):
        values = draw(rng, size=n_env)
        ours = mean_interval(values, seed=seed)
        assert ours is not None
        drawn = resampled(partial(means, values), n_env, seed=seed)
        plain = np.quantile(drawn, (0.025, 0.975))
        found.append([low <= mean <= high for low, high in (ours, plain)])
    ours, plain = np.mean(found, axis=0)
    return float(ours), float(plain)


def returns_table() -> str:
    """How often intervals hold the mean return, as Markdown."""
    rows = [["environments", *(f"{law} returns" for law in LAWS)], ["---"] * (1 + len(LAWS))]
    for n_env in (8, 16, 32, 64):
        cells = [held_returns(n_env, law) for law in LAWS]
        rows.append([str(n_env), *(f"{ours:.0%} ({plain:.0%})".replace("%", " %") for ours, plain in cells)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Write the tables into the page."""
    redraw(PAGE, {"episodes": table(), "intervals": intervals_table(), "returns": returns_table()})


if __name__ == "__main__":
    main()
