"""Groups whose runs captured for different lengths of time, and engines that never repeat themselves."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.identity import Branch, SplitTree, distinct_over_time
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.results.details import BetweenEnvs, BetweenRuns, Changed, Equality
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.state_hashes import Histories, side_by_side
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import message_class
from tests.pages import rows_of, tables_of, text_of
from tests.synthetic import Shown, grid, write_recording


def moved(by: float, n_env: int = 2) -> np.ndarray:
    """The grid, all of it some metres along y."""
    return grid(n_env) + [0.0, by, 0.0]


def test_a_short_run_is_left_out_by_name(tmp_path: Path) -> None:
    """Compute with the others what a run does not reach, and name the run and its file in text, JSON and HTML."""
    there = {"path_of": lambda *_: grid(2)}
    files = [write_recording(tmp_path, moved(y), run=run, **there) for run, y in enumerate((0.0, 0.03))]
    files.append(write_recording(tmp_path, grid(2), run=2, steps=3, name="cut.mcap", **there))
    found = evaluate_files(files)
    metrics = found.results[0].metrics
    assert metrics["w1_run_to_run"].value == pytest.approx(3.0)
    assert metrics["w1_run_to_run"].n == 1
    assert metrics["w1_parallel"].value == 0
    assert metrics["regime_published"].value == 4
    assert metrics["left_board"].value == 0
    assert metrics["equality_runs"].of(Equality).text == "different"
    assert metrics["distinct_runs"].value == 2
    assert metrics["distinct_runs"].n == 3
    note = "run 2 (cut.mcap) left out of W1, equality, published type and bodies off the board"
    notes = to_json(found)["groups"][0]["notes"]
    assert any(one.startswith(note) for one in notes)
    bits = "run 2 (cut.mcap) captured up to step 3 and others up to step 5: bits of two runs are compared at the steps "
    assert f"{bits}that both captured" in notes
    assert note in text_of(found)
    assert "step 5 (5 s) was not recorded" in text_of(found)
    assert note in render_html(found, published=False, command="")


def test_matrices_name_the_runs_that_are_in_them(tmp_path: Path) -> None:
    """Label the rows of a matrix by the runs that were compared, where the first is left out."""
    files = [write_recording(tmp_path, grid(2), run=0, steps=3)]
    files += [write_recording(tmp_path, moved(y), run=run) for run, y in enumerate((0.0, 0.03), start=1)]
    metrics = evaluate_files(files).results[0].metrics
    assert metrics["w1_run_to_run"].of(BetweenRuns).run_indices == (1, 2)
    assert metrics["w1_run_to_run"].of(BetweenRuns).classes == (0, 1)
    assert metrics["w1_parallel"].of(BetweenEnvs).matrix_of == 1


def test_positions_that_are_no_numbers_are_not_left_out(tmp_path: Path) -> None:
    """Let a run that blew up speak against its group, by name, and not disappear from the mean."""
    wild = grid(2)
    wild[0, 0, 0] = np.nan
    files = [write_recording(tmp_path, final, run=run) for run, final in enumerate((grid(2), wild))]
    why_not = why_missing(evaluate_files(files).results[0].metrics["w1_parallel"].value)
    assert why_not.startswith("run 1 (")
    assert why_not.endswith("positions at the sample step are not finite")


def _run(hashes: list[int]) -> Histories:
    branch = SplitTree((Branch(0, None, 0, 1, 1, (0,)),), 0, 0, 0)
    digests = np.array([[value, 0] for value in hashes], dtype=np.uint64).reshape(-1, 2)
    counts = np.ones(len(hashes), dtype=np.int64)
    return Histories(np.arange(len(hashes)), digests, np.zeros(1, dtype=np.int64), counts, counts, None, branch)


@given(st.lists(st.lists(st.integers(0, 1), min_size=1, max_size=4), min_size=1, max_size=5))
def test_runs_are_distinct_exactly_where_a_common_step_tells_them_apart(captured: list[list[int]]) -> None:
    """Put no two runs into one class that differ at a step that both captured, nor apart needlessly."""
    both = side_by_side([_run(hashes) for hashes in captured])
    classes = distinct_over_time(both[1]).classes
    for one, other in itertools.combinations(range(len(captured)), 2):
        differ = any(a != b for a, b in zip(captured[one], captured[other], strict=False))
        if differ or len(captured[one]) == len(captured[other]):
            assert differ == (classes[one] != classes[other])
    longest = {tuple(run) for run in captured if not any(_goes_on(run, other) for other in captured)}
    assert classes.max() + 1 == len(longest), "a run that ends early adds no class of its own"


def _goes_on(run: list[int], other: list[int]) -> bool:
    return len(other) > len(run) and other[: len(run)] == run


def _bits(folder: Path, run: int, hashes: list[int], final: np.ndarray) -> Path:
    block = message_class("gsb.v1.FingerprintBlock")(first_step=5, stride=1, steps=1, env_start=0, envs=2)
    block.hashes.extend(hashes)
    raw: tuple[tuple[str, str, Any], ...] = ((topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", block),)
    return write_recording(folder, final, run=run, shown=Shown(raw=raw))


def _changes(folder: Path, finals: list[np.ndarray]) -> tuple[GroupResult, str]:
    found = evaluate_files([_bits(folder, run, [1, 2], final) for run, final in enumerate(finals)])
    return found.results[0], text_of(found)


def test_a_capture_that_changes_what_repeats_itself(tmp_path: Path) -> None:
    """Blame the capture where all runs are bit-identical and the timed phase is not."""
    result, text = _changes(tmp_path, [grid(2)] * 3)
    metric = result.metrics["capture_changes_states"]
    assert (metric.value, metric.n) == (3, 3)
    assert "runs changed by capturing" in text
    assert "| 3 of 3 |" in text
    assert any("in 3 of 3 runs, although the runs are bit-identical" in note for note in result.notes)


@pytest.mark.parametrize(
    ("finals", "why"),
    [
        ([moved(0.0), moved(0.01)], "2 of 2 runs are distinct, so they may differ anyway"),
        ([moved(0.0)], "nothing shows that runs repeat themselves (needs at least two complete runs)"),
    ],
)
def test_noise_of_an_engine_is_not_blamed_on_the_capture(tmp_path: Path, finals: list[np.ndarray], why: str) -> None:
    """Say that it cannot be told where runs differ anyway, or where there is one run."""
    result, text = _changes(tmp_path, finals)
    metric = result.metrics["capture_changes_states"]
    assert why in metric.value.reason
    assert why in text
    assert metric.details == Changed(differ=len(finals), of=len(finals))
    assert "| runs changed by capturing" not in text


def test_rounding_and_bits_have_words_of_their_own(tmp_path: Path) -> None:
    """Call three runs of two histories within 0.01 cm, never bit-identical, and equal ones bit-identical."""
    other = grid(2)
    other[0, 0, 0] += 1e-9
    found = evaluate_files([write_recording(tmp_path, one, run=r) for r, one in enumerate((grid(2), grid(2), other))])
    text, page = text_of(found), render_html(found, published=False, command="")
    (bits,) = rows_of(tables_of(found)["variability"]).values()
    assert bits["distinct runs"].text == "2 of 3"
    for said in (text, page):
        assert "all 3 runs within 0.01 cm, 2 distinct" in said
        assert "another run differs by 0.01 cm with a probability below 78 % (95 % confidence)" in said
        assert "all 3 runs bit-identical" not in said
    alike = evaluate_files([write_recording(tmp_path, grid(2), run=r, simulator="same") for r in range(3)])
    assert "all 3 runs bit-identical" in text_of(alike)
    assert "another run differs in some bit with a probability below 78 % (95 % confidence)" in text_of(alike)


def test_runs_without_a_common_step_are_not_compared() -> None:
    """Give nothing where runs captured other steps, and the digests of all steps where they share one."""
    one = _run([1, 2, 3])
    assert side_by_side([one, replace(one, steps=one.steps + 3)]) is None
    both = side_by_side([one, replace(one, steps=one.steps + 2)])
    assert both is not None and both[0].tolist() == [0, 1, 2, 3, 4]
