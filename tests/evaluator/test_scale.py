"""What docs/scale.md says is what the commands print, what files take, and what the benchmark's sums give."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import tracemalloc
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scale_cost import Plan, Prices, Rates, extrapolate
from benchmarks.scale_runs import record
from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.transport.pair import MATRIX_LIMIT
from tests.conftest import run_python, searched
from tests.synthetic import grid, write_recording
from tests.test_docs import blocks, commands, shell

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "scale.md"

_MIB = 1 << 20
_CUBES = 27

_positive = st.floats(1e-6, 1e6)
_rates = st.builds(Rates, **{f.name: _positive for f in fields(Rates)} | {"certified_points": st.integers(1, 10**6)})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that has the sample recordings, as the page's commands want it."""
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    return tmp_path


def lines(text: str) -> list[str]:
    """Without what a terminal's width or an editor decides."""
    return [line.rstrip() for line in text.strip("\n").splitlines()]


@pytest.mark.alone
@pytest.mark.slow
def test_a_cluster_prints_what_the_page_shows(folder: Path) -> None:
    """Print the table of the page, with a cluster and without."""
    pytest.importorskip("ray")
    (line,) = (c for c in commands(PAGE) if "--ray" in c)
    shown = lines(blocks(PAGE, "text")[0])
    for command in (line, line.replace("--ray local", "")):
        assert lines(shell(command, folder).stdout) == shown


@pytest.mark.slow
def test_tables_of_the_page(folder: Path) -> None:
    """Write tables by the page's commands and print what the page shows of them."""
    pytest.importorskip("polars")
    for line in commands(PAGE):
        if "--ray" not in line:
            shell(line, folder)
    (program,) = blocks(PAGE, "python")
    done = run_python(program, cwd=folder)
    assert lines(done.stdout) == lines(blocks(PAGE, "text")[1])


def _taken(path: Path) -> tuple[int, int]:
    # bytes that stay, and at most
    gc.collect()
    tracemalloc.start()
    read = Reader(1.0)(path)
    gc.collect()
    found = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert isinstance(read, Run)
    assert read.positions
    return found


@pytest.mark.alone
def test_what_is_kept_and_what_is_taken(tmp_path: Path) -> None:
    """Keep and take of a file what the page's formula says, and not much less."""
    noise = np.random.default_rng(0)

    def made(n_env: int, steps: int) -> Path:
        final = grid(n_env, "float32") + noise.normal(size=(n_env, _CUBES, 3)).astype(np.float32)
        return write_recording(tmp_path, final, steps=steps, dt=0.01)

    for n_env in (2, 128):  # loads what has to be loaded
        _taken(made(n_env, 100))
    kept, taken = {}, {}
    cases = ((16, 100), (16, 2500), (128, 100), (1024, 100), (1024, 200))
    for n_env, steps in cases:
        kept[n_env, steps], taken[n_env, steps] = _taken(made(n_env, steps))
        bound = 30_000 + 40 * (steps + 1) + 140 * min(steps + 1, 500) + (12 * _CUBES + 30) * n_env
        assert bound / 3 < kept[n_env, steps] < bound
        assert taken[n_env, steps] < 128 * _MIB + 24 * n_env * steps
    # from 64 environments on, the tree of who left whom is cut off: it grows no more
    per_env = (kept[1024, 100] - kept[128, 100]) / (1024 - 128)
    assert 12 * _CUBES < per_env < 12 * _CUBES + 30
    assert taken[1024, 200] - taken[1024, 100] < 24 * 1024 * 100  # though the file is twice as large


@pytest.mark.slow
def test_environments_of_the_runs_all_differ(tmp_path: Path) -> None:
    """Record runs in which no two environments, and no two runs, are the same, so that nothing is left out."""
    pytest.importorskip("mujoco")
    paths = record(tmp_path, runs=2, n_env=3, steps=10)
    reads = [Reader(0.1)(path) for path in paths]
    histories = [r.histories for r in reads if isinstance(r, Run) and r.histories]
    assert [h.n_distinct for h in histories] == [3, 3]
    assert histories[0].until(11) != histories[1].until(11)


@pytest.mark.slow
def test_the_script_runs() -> None:
    """Measure tiny runs and print every line, each with a number."""
    pytest.importorskip("mujoco")
    pytest.importorskip("polars")
    pytest.importorskip("numba")
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.scale", "--runs", "2", "--n-env", "3", "--steps", "20", "--points", "200",
         "--recordings", "1000", "--shard", "10"], cwd=ROOT, capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": searched(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    measured, extrapolated = _parsed(done.stdout)
    assert len(measured) >= 15
    assert len(extrapolated) >= 15
    size = measured["a run as recorded [MB]"]
    assert extrapolated["files [GB]"][0] == pytest.approx(size, abs=0.5)
    assert measured["packed (gsb-share pack) [MB]"] < size


@given(_rates, st.integers(1, 10**5), st.integers(2, 20), st.integers(1, 512))
def test_sums(rates: Rates, groups: int, runs: int, cores: int) -> None:
    """Add up to the whole, which grows with the groups, and is divided among the cores."""

    def of(plan: Plan) -> dict[str, float]:
        rows = extrapolate(rates, plan, Prices(1.0, 1.0, 1.0), 10)
        return {what.strip(): float(first.replace(",", "")) for what, first, _ in rows if first != "-"}

    found = of(Plan(groups * runs, runs, cores, 1000))
    whole = found["all of it [core h]"]
    parts = [v for what, v in found.items() if what.startswith(("verifying", "reading", "W1", "floors"))]
    assert len(parts) == 5
    assert sum(parts) == pytest.approx(whole, abs=0.3, rel=1e-6)
    assert whole == pytest.approx(groups * rates.group_s(runs) / 3600, abs=0.06, rel=1e-6)
    assert found["cores [$]"] == pytest.approx(whole, abs=0.6, rel=1e-6)
    assert found[f"by the clock on {cores} cores [h]"] == pytest.approx(whole / cores, abs=0.11, rel=1e-6)
    twice = of(Plan(2 * groups * runs, runs, cores, 1000))
    assert twice["all of it [core h]"] == pytest.approx(2 * whole, abs=0.2, rel=1e-6)


def _parsed(text: str) -> tuple[dict[str, float], dict[str, list[float]]]:
    # the lines of the script: what was measured, and what was extrapolated, as recorded and packed
    above, below = text.split("\nextrapolated to ")
    rows = [(row[:50].strip(), row[50:].replace(",", "").split()) for row in above.splitlines() if row[50:].strip()]
    measured = {what: float(values[0]) for what, values in rows if not what.startswith("machine")}
    rows = [(row[:50].strip(), row[50:].replace(",", "").split()) for row in below.splitlines()[2:]]
    found = {what: [float(v) for v in values if v != "-"] for what, values in rows if what}
    return measured, found


def test_the_page_names_limits_that_are() -> None:
    """Name the limits of the code."""
    page = re.sub(r"\s+", " ", PAGE.read_text(encoding="utf-8"))
    from gpusimbench.evaluator.compute.cache import MAX_BYTES
    from gpusimbench.evaluator.metrics.variability import MAX_DISTINCT, SAMPLED_ENVS
    from gpusimbench.evaluator.read.addresses import MAX_FILES

    for said in (
        f"{MATRIX_LIMIT // 10**6} million pairs of points", f"cut down to {MAX_BYTES >> 30} GiB",
        f"at most {MAX_FILES:,} files", f"up to {MAX_DISTINCT}, above", f"which {SAMPLED_ENVS} are drawn",
    ):  # fmt: skip
        assert said in page, said
