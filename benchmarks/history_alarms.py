"""How often gsb-compare --history raises a false alarm, and what it sees.

Points in time have six runs each; the throughput of 20 configurations is searched at once, as a CI has them: each takes
a twentieth of the chance of a false alarm. How much drawn runs differ is taken from the recordings that ship. They are
searched by `statistics.change_points`, and the first sets by the whole of `compare.history` too, which has to mark the
same. The real runs are those of `false_alarms.csv`: one configuration, made one after another on a machine on which
other jobs came and went; they pass through `compare.history`.

    python -m benchmarks.history_alarms         the tables of docs/false-alarms.md
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from benchmarks.false_alarms import Run, kept, read_run
from gpusimbench.evaluator.compare.finding import Change, Settings
from gpusimbench.evaluator.compare.history.history import History, trace
from gpusimbench.evaluator.compare.history.series import Point, Points
from gpusimbench.evaluator.compute.work import HERE
from gpusimbench.evaluator.inputs.reader import Reader, read_all
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.runs.groups import group
from gpusimbench.evaluator.runs.run import Run as ReadRun
from gpusimbench.evaluator.statistics.change_points import change_points

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
RUNS, CONFIGURATIONS = 6, 20
FEWEST = 4
LENGTHS, SLOWER = (10, 20, 40), (1.05, 1.1, 1.2)
SETS, CHECKED, SHUFFLES = 1000, 20, 20
SEED = 0

Times = NDArray[np.float64]


def deviations() -> list[float]:
    """SD of the logarithm of the throughput, of every configuration with three runs in the sets that the document's
    simulations were made for: recordings/*.mcap, recordings/h200 and recordings/protocol-h200."""
    reader = Reader(5.0, verify=False)
    shipped = [
        *RECORDINGS.glob("*.mcap"),
        *(RECORDINGS / "h200").glob("*.mcap"),
        *(RECORDINGS / "protocol-h200").glob("*.mcap"),
    ]
    files = list(read_all(sorted(shipped), reader, HERE))
    assert FPS.values is not None
    found = []
    for one in group([file for file in files if isinstance(file, ReadRun)]):
        values = [value for value in FPS.values(GroupRuns(one.complete)) if not isinstance(value, Missing)]
        if len(values) >= 3:
            found.append(float(np.std(np.log(values), ddof=1)))
    return sorted(found)


def traced(times: Times, *, settings: Settings) -> History:
    """What the history says of one configuration, of elapsed times [s], shape [point, run]."""
    points = []
    for index, row in enumerate(times):
        runs = tuple(
            read_run(Run("drawn", f"2026-01-01T{index:02}:{r:02}:00Z", float(s), 10**8, 2 * 10**8), f"{index}-{r}")
            for r, s in enumerate(row)
        )
        points.append(Point(f"v{index}", runs[0].provenance.created_utc, runs))
    return trace(Points(tuple(points), ()), settings, HERE)


def one_of(configurations: int) -> Settings:
    """What a configuration may take of the chance of a false alarm beside others."""
    return Settings(alpha=0.05 / configurations)


def changed(history: History) -> list[int]:
    """Points at which a change that counts is marked."""
    return sorted(event.point for event in history.events if event.change is not Change.SMALL)


def marked(times: Times, settings: Settings) -> list[int]:
    """The same, without the detour by way of runs: `traced` has to agree."""
    found = change_points(-np.log(times).mean(axis=1), settings.alpha)
    return [one.index for one in found if abs(one.difference) > np.log1p(settings.threshold)]


def check(quartiles: list[float]) -> None:
    """Whether both ways mark the same points."""
    rng = np.random.default_rng(SEED)
    for index in range(CHECKED):
        times = drawn(rng, LENGTHS[index % len(LENGTHS)], quartiles[index % len(quartiles)])
        times[len(times) // 2 :] *= SLOWER[index % 2 + 1]
        settings = one_of(CONFIGURATIONS)
        if marked(times, settings) != changed(traced(times, settings=settings)):
            raise SystemExit("the search of points and the history do not mark the same points")


def drawn(rng: np.random.Generator, points: int, deviation: float, session: float = 0.0) -> Times:
    """Elapsed times [s], shape [point, run]: what differs between runs, and what a session has in common."""
    noise = rng.normal(scale=deviation, size=(points, RUNS)) + rng.normal(scale=session, size=(points, 1))
    return np.asarray(np.exp(noise))


def share(found: Iterable[bool]) -> str:
    """How many of how many, with the 95 % interval of Clopper and Pearson."""
    told = list(found)
    k, n = sum(told), len(told)
    low = stats.beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = stats.beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k} of {n}: {k / n:.1%} [{low:.1%} to {high:.1%}]"


def tables() -> Iterator[str]:
    """Lines of the tables."""
    known = deviations()
    quartiles = [float(np.quantile(known, q)) for q in (0.25, 0.5, 0.75)]
    yield (
        f"{len(known)} configurations of the shipped recordings; SD of the logarithm of the throughput: quartiles "
        f"{', '.join(f'{q:.1%}' for q in quartiles)}"
    )
    check(quartiles)
    yield ""
    yield from false_alarms(quartiles)
    yield ""
    yield from other_laws()
    yield ""
    yield from recorded()
    yield ""
    yield from power(quartiles)


def false_alarms(quartiles: list[float]) -> Iterator[str]:
    """Histories of 20 configurations in which nothing changes: whether any change is marked in any of them."""
    yield f"| nothing changes, {CONFIGURATIONS} configurations | {' | '.join(f'{n} points' for n in LENGTHS)} |"
    yield f"| --- |{' --- |' * len(LENGTHS)}"
    rows = [(f"runs differ by {q:.1%}", q, 0.0) for q in quartiles]
    rows.append((f"runs by {quartiles[1]:.1%}, sessions by {quartiles[1]:.1%} too", quartiles[1], quartiles[1]))
    for title, deviation, session in rows:
        cells = []
        for length in LENGTHS:
            rng = np.random.default_rng(SEED)
            cells.append(
                share(
                    any(
                        marked(drawn(rng, length, deviation, session), one_of(CONFIGURATIONS))
                        for _ in range(CONFIGURATIONS)
                    )
                    for _ in range(SETS)
                )
            )
        yield f"| {title} | {' | '.join(cells)} |"


def other_laws() -> Iterator[str]:
    """Curves in which nothing changes, of independent points that are not normal: whether any change is marked."""
    laws: dict[str, Callable[[np.random.Generator, int], Times]] = {
        "normal": lambda rng, points: rng.standard_normal(points),
        "heavy tails, t(3)": lambda rng, points: rng.standard_t(3, points),
        "one of two values, in 3 and in 7 of 10 points": lambda rng, points: (rng.random(points) < 0.3).astype(float),
    }
    yield f"| nothing changes, one curve | {' | '.join(f'{n} points' for n in (FEWEST, *LENGTHS))} |"
    yield f"| --- |{' --- |' * (1 + len(LENGTHS))}"
    for title, law in laws.items():
        rng = np.random.default_rng(SEED)
        rates = [np.mean([bool(change_points(law(rng, n), 0.05)) for _ in range(SETS)]) for n in (FEWEST, *LENGTHS)]
        yield f"| {title} | {' | '.join(f'{rate:.0%}' for rate in rates)} |"


def recorded() -> Iterator[str]:
    """Real runs, one after another, as histories that do not overlap: nothing changed but the machine's other jobs."""
    runs = [run for run in kept() if run.arm == "same"]
    times = np.array([run.elapsed_s for run in runs])
    rng = np.random.default_rng(SEED)
    points = times[: len(times) // RUNS * RUNS].reshape(-1, RUNS)
    yield "| real runs, a busy machine, nothing changes | histories with a mark | the same, points shuffled |"
    yield "| --- | --- | --- |"
    for length in LENGTHS:
        made = [bool(changed(traced(one, settings=one_of(1)))) for one in _histories(points, length)]
        mixed = [
            bool(changed(traced(one, settings=one_of(1))))
            for _ in range(SHUFFLES)
            for one in _histories(rng.permutation(points), length)
        ]
        yield f"| {length} points | {share(made)} | {sum(mixed)} of {len(mixed)}: {np.mean(mixed):.1%} |"


def _histories(points: Times, length: int) -> list[Times]:
    """Histories that do not overlap, shape [point, run] each."""
    return [points[begin : begin + length] for begin in range(0, len(points) - length + 1, length)]


def power(quartiles: list[float]) -> Iterator[str]:
    """A configuration of 20 that becomes slower at one point: in how many histories that very point is marked."""
    titles = " | ".join(f"runs differ by {q:.1%}" for q in quartiles)
    yield f"| slower by {'/'.join(f'{f - 1:.0%}' for f in SLOWER)} | {titles} |"
    yield f"| --- |{' --- |' * len(quartiles)}"
    for length in LENGTHS:
        for where, at in (("newest", length - 1), ("third newest", length - 3), ("middle", length // 2)):
            cells = ["/".join(f"{_power(length, at, q, f):.0%}" for f in SLOWER) for q in quartiles]
            yield f"| {length} points, from the {where} on | {' | '.join(cells)} |"


def _power(length: int, at: int, deviation: float, factor: float) -> float:
    """In which share of the sets the point is marked from which on runs take so many times as long."""
    rng = np.random.default_rng(SEED)
    found = 0
    for _ in range(SETS):
        times = drawn(rng, length, deviation)
        times[at:] *= factor
        found += at in marked(times, one_of(CONFIGURATIONS))
    return found / SETS


def main() -> None:
    """Print the tables."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print("\n".join(tables()), flush=True)


if __name__ == "__main__":
    main()
