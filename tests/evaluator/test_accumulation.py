"""Variability of a sweep, at one number of environments."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.compute.cache import Store
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.results.evaluate import evaluate, evaluate_files
from tests.pages import print_all
from tests.synthetic import grid, write_recording


def sweep(folder: Path, noise: dict[int, float], runs: int = 3) -> list[Path]:
    """Recordings with normal noise [m] of that size on each cube, by number of environments."""
    files = []
    for n_env, size in noise.items():
        for run in range(runs):
            moved = np.random.default_rng([n_env, run]).normal(0.0, size, size=(n_env, 27, 3))
            files.append(write_recording(folder, grid(n_env) + moved, run=run))
    return files


@pytest.mark.slow
def test_noise_of_one_size_stays(tmp_path: Path) -> None:
    """Find the same at each N where the law is the same, though distances of all environments fall."""
    (found,) = evaluate_files(sweep(tmp_path, {4: 0.01, 8: 0.01, 32: 0.01})).accumulation
    assert (found.size, [p.n_env for p in found.points], [p.n_run for p in found.points]) == (4, [4, 8, 32], [3] * 3)
    matched = [p.matched.run_to_run.estimate for p in found.points if p.matched.run_to_run]
    raw = [p.raw.run_to_run.estimate for p in found.points if p.raw and p.raw.run_to_run]
    assert matched == pytest.approx([matched[0]] * 3, rel=0.15)
    assert raw[2] < 0.6 * raw[0]


@pytest.mark.slow
def test_noise_that_grows_is_seen(tmp_path: Path) -> None:
    """Find more at larger N where it is there."""
    (found,) = evaluate_files(sweep(tmp_path, {4: 0.0, 8: 0.001, 16: 0.01})).accumulation
    matched = [p.matched.run_to_run.estimate for p in found.points if p.matched.run_to_run]
    assert matched[0] == 0
    assert 5 < matched[2] / matched[1] < 20


def test_it_is_shown(tmp_path: Path) -> None:
    """Show a row for each N in the terminal and the page, and everything in the document."""
    evaluation = evaluate_files(sweep(tmp_path, {4: 0.01, 40: 0.01}, runs=2))
    stream = io.StringIO()
    print_all(evaluation, stream)
    page = render_html(evaluation, published=False, command="")
    (document,) = to_json(evaluation)["accumulation"]
    for text in (stream.getvalue(), page):
        assert "each run reduced to 4 environments, mean of 5 draws with seed 0" in text
        assert "1080 points a run are more than 1000" in text
    assert [p["n_env"] for p in document["points"]] == [4, 40]
    assert document["points"][1]["raw"] is None


def test_no_sweep_has_none(tmp_path: Path) -> None:
    """Leave it out for one number of environments, for sweeps that captured nothing, and below four environments."""
    assert evaluate_files(sweep(tmp_path, {1: 0.01, 2: 0.01, 4: 0.01})).accumulation == ()
    files = [write_recording(tmp_path, None, n_env=n) for n in (2, 4)]
    assert evaluate_files(files).accumulation == ()


def test_it_is_kept(tmp_path: Path) -> None:
    """Give the same from a store."""
    files = sweep(tmp_path, {4: 0.01, 8: 0.01}, runs=2)
    work = Work(store=Store(tmp_path / "cache"))
    read = [Reader(5.0)(file) for file in files]
    first, second = (to_json(evaluate(read, work=work)) for _ in range(2))
    assert first == second == to_json(evaluate(read))
