"""What one recording of 16 environments costs, and from that what a million would.

CPU seconds of all threads together, not wall time. The runs are made here: MuJoCo's cubes in environments that all
differ (scale_runs.py), every step in float32. Nothing is extrapolated but by multiplying; the prices are assumptions.

usage: python -m benchmarks.scale [--recordings 1000000] [--runs 10] [--cores 64] [--shard 1000] [--core-hour 0.04] ...
"""

from __future__ import annotations

import gc
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.arguments import parser
from benchmarks.machine import machine
from benchmarks.scale_cost import Plan, Prices, Rates, extrapolate
from benchmarks.scale_runs import SHIPPED, record
from benchmarks.transport_large import thrown
from gpusimbench.evaluator.compute.mapping import serial
from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.metrics.variability import MAX_CERTIFIED_POINTS, parallel_variability, run_to_run_variability
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.parquet import parquet_tables
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.results.identity_metrics import identical_steps
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.evaluator.share.copies import pack
from gpusimbench.evaluator.statistics.permutation import floor
from gpusimbench.evaluator.transport.large import certified_wasserstein1

_Result = TypeVar("_Result")

_LEVEL = 1  # of Zstandard: what gsb-share pack takes where nothing is said


def _cpu(function: Callable[..., _Result], *arguments: object) -> tuple[float, _Result]:
    # of the second time: the first pays for imports and cold caches
    function(*arguments)
    began = time.process_time()
    result = function(*arguments)
    return time.process_time() - began, result


def _read(paths: Sequence[Path], sample_time: float) -> list[Run]:
    read = [Reader(sample_time, verify=False)(path) for path in paths]
    found = [r for r in read if isinstance(r, Run) and r.usable]
    if len(found) < len(read):
        raise SystemExit("a run that was just recorded cannot be read")
    return found


def _verify(paths: Sequence[Path]) -> None:
    for path in paths:
        verify(Recording(path))


def _kept(paths: Sequence[Path], sample_time: float) -> float:
    # memory that a run takes once its file is closed, with its part of the group's results
    gc.collect()
    tracemalloc.start()
    reads = _read(paths, sample_time)
    evaluation = evaluate(reads, sample_time=sample_time)
    gc.collect()
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return size / sum(len(result.group.recordings) for result in evaluation.results)


def _pack(paths: Sequence[Path], folder: Path) -> tuple[float, list[Path]]:
    packed = [folder / f"packed-{path.name}" for path in paths]
    began = time.process_time()
    for path, copy in zip(paths, packed, strict=True):
        pack(path, copy, level=_LEVEL)
    return (time.process_time() - began) / len(paths), packed


def _tables(reads: Sequence[Run], sample_time: float) -> tuple[float, float]:
    # bytes of the tables of one group, and of each group more
    sizes = []
    shipped = _read(sorted(SHIPPED.glob("*.mcap")), sample_time)
    for files in (reads, [*reads, *shipped]):
        evaluation = evaluate(files, sample_time=sample_time)
        size = sum(map(len, parquet_tables(evaluation).values()))
        sizes.append((len(evaluation.results), size))
    (one, alone), (more, all_of_them) = sizes
    return alone, (all_of_them - alone) / (more - one)


def _command(paths: Sequence[Path], sample_time: float, folder: Path) -> float:
    # CPU seconds of the whole command on one group, start and tables included
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "gpusimbench.evaluator.cli.eval",
         *map(str, paths), "--sample-time", str(sample_time), "--no-cache",
         "--tables", str(folder / "tables")], check=True, capture_output=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(folder: Path, *, runs: int, n_env: int, steps: int, points: int) -> tuple[Rates, float]:
    """Rates of runs that are recorded in a folder, and the CPU seconds of gsb-eval on all of them as one group."""
    paths = record(folder, runs=runs, n_env=n_env, steps=steps)
    sample_time = min(5.0, steps * Recording(paths[0]).configuration.dt)
    pack_s, packed = _pack(paths, folder)
    recorded, archived = (sum(p.stat().st_size for p in some) for some in (paths, packed))
    verify_s, _ = _cpu(_verify, paths)
    verify_archived_s, _ = _cpu(_verify, packed)
    read_s, reads = _cpu(_read, paths, sample_time)
    read_archived_s, _ = _cpu(_read, packed, sample_time)
    planar = np.stack([run.positions.planar for run in reads if run.positions])
    env_pairs_s, _ = _cpu(lambda: [parallel_variability(run) for run in planar])
    between_s, between = _cpu(run_to_run_variability, planar)
    floor_s, _ = _cpu(floor, planar[0], planar[1], serial)
    certified_wasserstein1(thrown(100, 1), thrown(100, 2))  # compiled
    began = time.process_time()
    certified_wasserstein1(thrown(points, 1), thrown(points, 2))
    certified_s = time.process_time() - began
    same_s, _ = _cpu(lambda: [identical_steps(reads, reads) for _ in range(100)])  # of so many runs on either side
    table, next_group = _tables(reads, sample_time)
    rates = Rates(
        recorded_bytes=recorded / runs,
        archived_bytes=archived / runs,
        pack_s=pack_s,
        verify_s_per_gb=verify_s / recorded * 1e9,
        verify_archived_s=verify_archived_s / runs,
        read_s=read_s / runs,
        read_archived_s=read_archived_s / runs,
        summary_bytes=_kept(paths, sample_time),
        env_pairs_s=env_pairs_s / runs,
        run_pair_s=between_s / between.n_pair,
        floor_s=floor_s,
        certified_s=certified_s,
        certified_points=points,
        pair_of_groups_s=same_s / 100,
        table_bytes=table,
        next_group_bytes=next_group,
    )
    return rates, _command(paths, sample_time, folder)


def report(rates: Rates, command_s: float, runs: int) -> str:
    """What was measured, a line each."""
    rows = (
        ("a run as recorded [MB]", f"{rates.recorded_bytes / 1e6:.2f}"),
        ("  packed (gsb-share pack) [MB]", f"{rates.archived_bytes / 1e6:.2f}"),
        ("  packing it [CPU s]", f"{rates.pack_s:.3f}"),
        ("verifying, as recorded [CPU s / GB]", f"{rates.verify_s_per_gb:.2f}"),
        ("  verifying a run as recorded [CPU s]", f"{rates.verify_s_per_gb * rates.recorded_bytes / 1e9:.3f}"),
        ("  verifying a packed run [CPU s]", f"{rates.verify_archived_s:.3f}"),
        ("reading a run, not verified [CPU s]", f"{rates.read_s:.3f}"),
        ("  reading a packed run [CPU s]", f"{rates.read_archived_s:.3f}"),
        ("kept of a run in memory [kB]", f"{rates.summary_bytes / 1e3:.0f}"),
        ("W1, pairs of environments of a run [CPU s]", f"{rates.env_pairs_s:.4f}"),
        ("W1, a pair of runs [CPU s]", f"{rates.run_pair_s:.4f}"),
        ("floors of a group [CPU s]", f"{rates.floor_s:.3f}"),
        (f"W1, a certified pair of {rates.certified_points:,} points [CPU s]", f"{rates.certified_s:.1f}"),
        ("two groups compared by bits [CPU us]", f"{rates.pair_of_groups_s * 1e6:.0f}"),
        ("tables of an evaluation of one group [kB]", f"{rates.table_bytes / 1e3:.1f}"),
        ("  of each further group [kB]", f"{rates.next_group_bytes / 1e3:.1f}"),
        (f"a group of {runs} runs, sum of the parts [CPU s]", f"{rates.group_s(runs):.2f}"),
        ("  gsb-eval on it, start and tables included", f"{command_s:.2f}"),
    )
    return "\n".join(f"{what:<50} {value:>14}" for what, value in rows)


def main() -> None:
    """Measure, extrapolate and print."""
    p = parser(__doc__, n_env=16, steps=500, cores=64)
    p.add_argument("--recordings", type=int, default=1_000_000, help="to extrapolate to")
    p.add_argument("--runs", type=int, default=10, help="of a group; so many are made and measured")
    p.add_argument("--points", type=int, default=110_592, help="of the certified pair")
    p.add_argument("--shard", type=int, default=1000, help="groups of one gsb-eval")
    p.add_argument("--core-hour", type=float, default=Prices.core_hour, help="assumed price [$]")
    p.add_argument("--gb-month", type=float, default=Prices.gb_month, help="assumed price [$]")
    p.add_argument("--gb-egress", type=float, default=Prices.gb_egress, help="assumed price [$]")
    a = p.parse_args()
    if min(a.recordings, a.n_env, a.steps, a.points, a.cores, a.shard) < 1 or a.runs < 2:
        p.error("counts are at least 1, and runs at least 2")
    with tempfile.TemporaryDirectory() as folder:
        rates, command_s = measure(Path(folder), runs=a.runs, n_env=a.n_env, steps=a.steps, points=a.points)
    plan = Plan(a.recordings, a.runs, a.cores, a.shard)
    prices = Prices(a.core_hour, a.gb_month, a.gb_egress)
    print(f"machine: {machine()}")
    print(f"measured on {a.runs} runs of {a.n_env} envs, {a.steps} steps\n")
    print(report(rates, command_s, a.runs))
    print(
        f"\nextrapolated to {plan.recordings:,} recordings in {plan.groups:,} groups; assumed: ${prices.core_hour:g}"
        f" a core hour, ${prices.gb_month:g} a GB and month, ${prices.gb_egress:g} a GB sent out\n"
    )
    print(f"{'':<50} {'as recorded':>14} {'packed':>14}")
    for what, *both in extrapolate(
        rates, plan, prices, min(MAX_CERTIFIED_POINTS // a.points, a.runs * (a.runs - 1) // 2)
    ):
        print(f"{what:<50} {both[0]:>14} {both[1]:>14}")


if __name__ == "__main__":
    main()
