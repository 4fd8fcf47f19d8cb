"""How often gsb-compare raises a false alarm, and what it sees: real runs of MuJoCo C on a machine that others use.

Runs of one configuration, made one after another, are dealt to sets of twelve, and each set to base and head in the
order A B B A. Nothing differs between the two, so every alarm is a false one. Sets do not overlap. What compares them
is `evaluator.compare.compare`, which gsb-compare calls with what it read from files.

    python -m benchmarks.false_alarms                                   the tables, from the runs in false_alarms.csv
    python -m benchmarks.false_alarms --record 1200 --out runs/         records them (under an hour)
    python -m benchmarks.false_alarms --read same=runs/ rk4-base=a/ ...  writes false_alarms.csv from recordings
"""

from __future__ import annotations

import csv
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from benchmarks.arguments import parser
from gpusimbench.evaluator.compare.compare import compare
from gpusimbench.evaluator.compare.finding import DEFAULT_GATES, Settings
from gpusimbench.evaluator.compute.work import HERE
from gpusimbench.evaluator.inputs.reader import FileSet, Reader
from gpusimbench.evaluator.metrics.memory import Checkpoints
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.runs.physics.facts import PhysicsFacts
from gpusimbench.evaluator.runs.positions import Positions
from gpusimbench.evaluator.runs.run import Run as ReadRun
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.provenance import Provenance, Simulation

CSV = Path(__file__).resolve().parent / "false_alarms.csv"
CONFIGURATION = ("--sim", "mujoco", "--scene", "free-fall", "--n-env", "4", "--phases", "timed", "--warmup", "50")
TIMED_STEPS, N_ENV = 400, 4
IN_TURN, IN_A_ROW = "ABBA", "AB"
CHANGES = {"cone": "`cone`: `pyramidal` -> `elliptic`", "rk4": "`integrator`: `implicitfast` -> `RK4`"}
PER_SET = 12
SIMULATED = ((4, 400), (6, 400), (12, 100))
SPREAD_M, SPREADS = 0.02, (1.0, 1.2, 2.0)
CUBES = np.stack(np.meshgrid([0.0, 0.1, 0.2], [0.0, 0.1, 0.2]), axis=-1).reshape(-1, 2)
DEVIATIONS, SLOWER = (0.005, 0.01, 0.02, 0.05, 0.1), (1.0, 1.049, 1.051, 1.1, 1.2, 1.34)


@dataclass(frozen=True)
class Run:
    """One line of the CSV: `arm` is "same", or one of CHANGES with "-base" or "-head"."""

    arm: str
    created_utc: str
    elapsed_s: float
    host_baseline: int
    host_peak: int

    @property
    def fps(self) -> float:
        """Throughput [env-steps/s]."""
        return N_ENV * TIMED_STEPS / self.elapsed_s


Rule = Callable[[Sequence[Run], Sequence[Run]], ExitCode]
PASSED, FAILED, UNDECIDED = ExitCode.OK, ExitCode.GATE_FAILED, ExitCode.NOTHING_COMPARABLE


def record(count: int, folder: Path) -> None:
    """Make runs of one configuration, one after another."""
    command = [sys.executable, "-m", "gpusimbench.recorder.cli", *CONFIGURATION, "--timed-steps", str(TIMED_STEPS)]
    subprocess.run([*command, "--runs", str(count), "--out", str(folder)], check=True)


def read(arms: dict[str, Path]) -> None:
    """Write the CSV from recordings, in the order in which they were made."""
    reader = Reader(5.0, verify=False)
    rows = []
    for arm, folder in arms.items():
        for path in folder.glob("*.mcap"):
            found = reader(path)
            if not isinstance(found, ReadRun) or not found.elapsed_s or not found.host:
                raise SystemExit(f"{path} is no complete run with a timed phase")
            host = found.host
            created = found.provenance.created_utc
            rows.append((created, arm, f"{found.elapsed_s:.9f}", host.baseline, host.peak))
    with CSV.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("created_utc", "arm", "elapsed_s", "host_baseline_bytes", "host_peak_bytes"))
        writer.writerows(sorted(rows))


def kept() -> list[Run]:
    """The runs of the CSV."""
    with CSV.open(newline="") as stream:
        rows = list(csv.reader(stream))[1:]
    return [Run(arm, created, float(s), int(low), int(high)) for created, arm, s, low, high in rows]


def sets(runs: Sequence[Run], order: str, size: int = PER_SET) -> Iterator[tuple[list[Run], list[Run]]]:
    """Base and head of each set of consecutive runs: dealt in turn, or the first half and the second."""
    for begin in range(0, len(runs) - size + 1, size):
        one = runs[begin : begin + size]
        letters = (order * size)[:size] if order == IN_TURN else "A" * (size // 2) + "B" * (size // 2)
        yield (
            [run for run, letter in zip(one, letters, strict=True) if letter == "A"],
            [run for run, letter in zip(one, letters, strict=True) if letter == "B"],
        )


def gsb_compare(settings: Settings) -> Rule:
    """The exit code of gsb-compare."""
    return lambda base, head: compare(_side(base, "base"), _side(head, "head"), settings, HERE).exit_code


def slower_by_5_percent(base: Sequence[Run], head: Sequence[Run]) -> ExitCode:
    """What many a CI does: the mean of head is slower than that of base by more than 5 %."""
    return FAILED if _mean(head) < 0.95 * _mean(base) else PASSED


def t_test(base: Sequence[Run], head: Sequence[Run]) -> ExitCode:
    """Welch's t-test at 5 %, head slower."""
    found = stats.ttest_ind([run.fps for run in base], [run.fps for run in head], equal_var=False)
    return FAILED if found.pvalue < 0.05 and found.statistic > 0 else PASSED


def slowed(runs: Sequence[Run], factor: float) -> list[Run]:
    """The same runs, had each taken so many times as long."""
    return [Run(r.arm, r.created_utc, r.elapsed_s * factor, r.host_baseline, r.host_peak) for r in runs]


def share(codes: Iterable[ExitCode], code: ExitCode = FAILED) -> str:
    """How many of how many ended with a code, with the 95 % interval of Clopper and Pearson."""
    found = list(codes)
    k, n = found.count(code), len(found)
    low = stats.beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = stats.beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k} of {n}: {k / n:.1%} [{low:.1%} to {high:.1%}]"


def shares(codes: Iterable[ExitCode]) -> str:
    """Per cent that failed, were undecided, and passed."""
    found = Counter(codes)
    return "/".join(f"{100 * found[code] / found.total():.1f}" for code in (FAILED, UNDECIDED, PASSED))


def tables(runs: Sequence[Run]) -> Iterator[str]:
    """Lines of the tables, as docs/false-alarms.md has them."""
    yield from recorded(runs)
    for runs_a_side, count in SIMULATED:
        yield ""
        yield from simulated(runs_a_side, count)
    yield ""
    yield from positions()


def recorded(runs: Sequence[Run]) -> Iterator[str]:
    """Lines of the tables of runs that were made."""
    same = [run for run in runs if run.arm == "same"]
    rules: dict[str, Rule] = {
        "gsb-compare": gsb_compare(Settings()),
        "gsb-compare --threshold 0": gsb_compare(Settings(threshold=0.0)),
        "gsb-compare --threshold 100%": gsb_compare(Settings(threshold=1.0)),
        "gsb-compare --expect-same": gsb_compare(Settings(expect_same=True)),
        "mean slower by 5 %": slower_by_5_percent,
        "t-test at 5 %, slower": t_test,
    }
    spread = np.std(np.log([run.fps for run in same]), ddof=1)
    yield f"{len(same)} runs of one configuration; SD of the logarithm of the throughput {spread:.2f}"
    yield ""
    yield "| nothing differs | in turn, A B B A: false alarms | undecided | one after the other: false alarms |"
    yield "| --- | --- | --- | --- |"
    for name, rule in rules.items():
        turn, row = ([rule(*pair) for pair in sets(same, order)] for order in (IN_TURN, IN_A_ROW))
        cells = " | ".join((share(turn), f"{turn.count(UNDECIDED)}", share(row)))
        yield f"| `{name}` | {cells} |" if name.startswith("gsb") else f"| {name} | {cells} |"
    yield ""
    yield "| head made slower by | 6 runs a side: fails in | undecided | 12 runs a side: fails in | undecided |"
    yield "| --- | --- | --- | --- | --- |"
    for factor in (1.05, 1.1, 1.2, 1.5, 3.0):
        found = [
            [gsb_compare(Settings())(base, slowed(head, factor)) for base, head in sets(same, IN_TURN, size)]
            for size in (PER_SET, 2 * PER_SET)
        ]
        cells = " | ".join(f"{share(codes)} | {codes.count(UNDECIDED)}" for codes in found)
        yield f"| {factor - 1:.0%} | {cells} |"
    changes = [name for name in CHANGES if any(run.arm == f"{name}-base" for run in runs)]
    if changes:
        yield ""
        yield "| change, recorded in turn | runs | throughput of head / base | sets of 6 a side: slower in |"
        yield "| --- | --- | --- | --- |"
        yield from (_real_change(runs, name) for name in changes)


def simulated(runs_a_side: int, count: int) -> Iterator[str]:
    """Lines of the table of so many pairs of sets of runs that never were."""
    size = 2 * runs_a_side
    titles = " | ".join(f"{f - 1:.1%} slower" if f > 1 else "unchanged" for f in SLOWER)
    yield f"| {runs_a_side} runs a side: SD of a run | {titles} |"
    yield f"| --- |{' --- |' * len(SLOWER)}"
    for deviation in DEVIATIONS:
        drawn = list(sets(_simulated(deviation, count * size), IN_TURN, size))
        cells = [shares(gsb_compare(Settings())(base, slowed(head, f)) for base, head in drawn) for f in SLOWER]
        yield f"| {deviation:.1%} | {' | '.join(cells)} |"


def _simulated(deviation: float, count: int) -> list[Run]:
    """Runs that never were: logarithms of a normal law, with no drift, and one amount of memory."""
    noise = np.random.default_rng(0).normal(scale=deviation, size=count)
    return [
        Run(
            "simulated", f"2026-01-01T{i // 3600:02}:{i // 60 % 60:02}:{i % 60:02}Z", float(np.exp(n)), 10**8, 2 * 10**8
        )
        for i, n in enumerate(noise)
    ]


def positions(count: int = 200) -> Iterator[str]:
    """Lines of the table of cubes that end in places drawn at random: what comparing W1 adds to the alarms."""
    every = frozenset({*DEFAULT_GATES, Axis.VARIABILITY})
    rules = {
        "gsb-compare": Settings(),
        "gsb-compare --gate variability": Settings(gates=frozenset({Axis.VARIABILITY})),
        "gsb-compare, default gates and variability": Settings(gates=every),
        "the same, --threshold 0 --outcome 0": Settings(gates=every, threshold=0.0, outcome_cm=0.0),
        "gsb-compare --expect-same": Settings(expect_same=True),
    }
    yield f"| 6 runs a side, cubes drawn | {' | '.join(f'head spread times {f:g}: fails in' for f in SPREADS)} |"
    yield f"| --- |{' --- |' * len(SPREADS)}"
    for name, settings in rules.items():
        cells = []
        for factor in SPREADS:
            rng = np.random.default_rng(0)
            codes = [_compare_placed(rng, number, factor, settings) for number in range(count)]
            cells.append(share(codes))
        yield f"| `{name}` | {' | '.join(cells)} |"


def _compare_placed(rng: np.random.Generator, number: int, factor: float, settings: Settings) -> ExitCode:
    """Twelve runs in turn, whose cubes lie around one place by a shift of the run and of the environment."""
    sides: tuple[list[ReadRun], list[ReadRun]] = ([], [])
    for index, letter in enumerate((IN_TURN * PER_SET)[:PER_SET]):
        head = letter == "B"
        scale = SPREAD_M * (factor if head else 1.0)
        placed = CUBES + rng.normal(scale=scale, size=(1, 1, 2)) + rng.normal(scale=scale, size=(N_ENV, len(CUBES), 2))
        run = Run("placed", f"2026-01-01T00:00:{index:02}Z", float(np.exp(rng.normal(scale=0.01))), 10**8, 2 * 10**8)
        sides[head].append(read_run(run, f"{number}-{index:04d}", placed))
    base, head_side = (FileSet(tuple(side)) for side in sides)
    return compare(base, head_side, settings, HERE).exit_code


def _real_change(runs: Sequence[Run], name: str) -> str:
    base, head = ([run for run in runs if run.arm == f"{name}-{side}"] for side in ("base", "head"))
    whole = compare(_side(base, "base"), _side(head, "head"), Settings(), HERE).findings[0]
    half = PER_SET // 2
    seen = [
        gsb_compare(Settings())(base[begin : begin + half], head[begin : begin + half])
        for begin in range(0, min(len(base), len(head)) - half + 1, half)
    ]
    low, high = whole.ci95 or (0.0, 0.0)
    found = f"{whole.ratio:.3f} [{low:.3f} to {high:.3f}]"
    return f"| {CHANGES[name]} | {len(base)} and {len(head)} | {found} | {share(seen)} |"


def _mean(runs: Sequence[Run]) -> float:
    return float(np.mean([run.fps for run in runs]))


def _side(runs: Sequence[Run], name: str) -> FileSet:
    return FileSet(tuple(read_run(run, f"{name}-{index:04d}") for index, run in enumerate(runs)))


def read_run(run: Run, run_id: str, placed: NDArray[np.float64] | None = None) -> ReadRun:
    """What the reader would have made of the run's recording."""
    configuration = RunConfiguration(
        "mujoco",
        "free-fall",
        N_ENV,
        0.01,
        500,
        warmup=50,
        timed_steps=TIMED_STEPS,
        phases=("timed",) if placed is None else ("timed", "capture"),
    )
    # runs of one second are in the order of their ids
    provenance = Provenance(run_id, run.created_utc, (), configuration, host={"cpu": "one", "usable_threads": 2})
    simulation = Simulation(
        version="4.0.0", device="cpu", options={}, switches={}, deviations=(), fields=(), scene={"sha256": "one"}
    )
    none = Missing("no states were captured")
    return ReadRun(
        Path(f"{run_id}.mcap"), "complete", "", "", run_id, provenance, simulation, elapsed_s=run.elapsed_s,
        timed_steps=TIMED_STEPS, host=Checkpoints(baseline=run.host_baseline, peak=run.host_peak), stalled_s=0.0,
        positions=none if placed is None else Positions(placed, None, 5.0),
        physics=PhysicsFacts("free-fall", N_ENV, (), none),
    )  # fmt: skip


def main() -> None:
    """Record, read, or print the tables."""
    p = parser(__doc__)
    p.add_argument("--record", type=int, metavar="N", help="make N runs")
    p.add_argument("--out", type=Path, default=Path("false-alarms"), metavar="DIR", help="of --record")
    p.add_argument("--read", nargs="+", metavar="ARM=DIR", help="write the CSV from the recordings of folders")
    arguments = p.parse_args()
    if arguments.record:
        record(arguments.record, arguments.out)
    elif arguments.read:
        read({arm: Path(folder) for arm, folder in (part.split("=", 1) for part in arguments.read)})
    else:
        print("\n".join(tables(kept())))


if __name__ == "__main__":
    main()
