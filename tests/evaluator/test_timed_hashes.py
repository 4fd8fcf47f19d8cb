"""State hashes of the timed phase, which are compared beside a capture, and where nothing was captured."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.audit.replays import compared, distinct, match_of
from gpusimbench.evaluator.audit.verdict import AuditLevel, AuditVerdict, ladder
from gpusimbench.evaluator.cli.diff import main
from gpusimbench.evaluator.compare.counted import compare_bits
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Difference, StepRange
from gpusimbench.evaluator.diff.result import DiffVerdict as Found
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.verdicts import repeats
from gpusimbench.evaluator.results.details import DistinctRuns
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.identity_metrics import hashed_by
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import message_class
from tests.synthetic import Shown, grid, write_recording

_RUN = itertools.count()


def _record(folder: Path, hashes: list[int] | None, *, stride: int = 1, moved: int | None = None) -> Recording:
    """Two environments, eight captured steps, and these hashes of timed steps 100 and 1100, step after step.

    moved  captured step at which a cube is a metre elsewhere
    """
    block = message_class("gsb.v1.FingerprintBlock")(first_step=100, stride=1000, steps=2, env_start=0, envs=2)
    raw: tuple[tuple[str, str, Any], ...] = ()
    if hashes is not None:
        block.hashes.extend(hashes)
        raw = ((topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", block),)

    def at(step: int) -> np.ndarray:
        return grid(2, "float32") + np.float32(step == moved)

    made = write_recording(
        folder, grid(2, "float32"), steps=8, dt=0.01, stride=stride, run=next(_RUN), path_of=lambda _, step: at(step),
        shown=Shown(raw=raw),
    )  # fmt: skip
    return Recording(made)


def _verdict(found: Difference, a: Recording, b: Recording) -> AuditVerdict:
    return ladder(
        [match_of(found, a, b)], lambda: "no test", max_ulps=4, originals=1, compared=compared(found)
    )  # fmt: skip


def test_a_difference_of_the_timed_phase_is_one(tmp_path: Path) -> None:
    """Call nothing bit-identical whose captures agree and whose timed phases do not, and say where."""
    a, b = _record(tmp_path, [1, 2, 3, 4]), _record(tmp_path, [1, 2, 3, 9])
    found = compare(a, b)
    assert (found.verdict, found.bit_identical, found.same_up_to_env_order) == (Found.DIFFERENT, False, False)
    assert (found.first.phase, found.first.step_a, found.first.env_a, found.first.envs) == ("timed", 1100, 1, 1)
    assert (found.first.after_step, found.first.state, found.first.located) == (100, None, False)
    assert (found.compared.hash_phase, found.compared.timed_steps) == ("capture", StepRange(2, 100, 1100))
    assert found.compared.unseen_steps == 1
    verdict = _verdict(found, a, b)
    assert [rung.holds for rung in verdict.rungs] == [False, False, None, None]


def test_equal_timed_phases_are_said_to_be(tmp_path: Path) -> None:
    """Count the hashes of the timed phase among what was compared."""
    a, b = (_record(tmp_path, [1, 2, 3, 4]) for _ in range(2))
    found = compare(a, b)
    assert found.bit_identical
    assert (found.compared.timed_steps, found.notes) == (StepRange(2, 100, 1100), ())
    assert _verdict(found, a, b).level is AuditLevel.BIT_IDENTICAL


def test_an_order_is_one_of_both_phases(tmp_path: Path) -> None:
    """Find environments in another order only where it is the same in capture and timed phase."""
    a, b = _record(tmp_path, [1, 2, 3, 4]), _record(tmp_path, [2, 1, 4, 3])
    assert compare(a, b).same_up_to_env_order
    assert not compare(a, _record(tmp_path, [2, 1, 3, 4])).same_up_to_env_order


def test_a_capture_that_differs_comes_first(tmp_path: Path) -> None:
    """Date a difference of both phases by the capture, and note the other."""
    a, b = _record(tmp_path, [1, 2, 3, 4]), _record(tmp_path, [5, 6, 7, 8], moved=3)
    found = compare(a, b)
    assert (found.first.phase, found.first.step_a) == ("capture", 3)
    assert "state hashes of the timed phase differ: first at its step 100, 2 of 2 pairs of envs" in found.notes


def test_the_text_names_the_phase(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print and draw a difference of the timed phase."""
    a, b = _record(tmp_path, [1, 2, 3, 4]), _record(tmp_path, [1, 2, 3, 9])
    assert main([str(a.path), str(b.path), "--plot", str(tmp_path / "x.svg")]) == 4
    said = capsys.readouterr().out
    assert " ".join(said.split()).startswith(
        "The two recordings are equal at step 100 and differ first at the next state that both recorded, "
        "step 1100 (11 s) of the timed phase, first in env 1; "
    )
    drawn = (tmp_path / "x.svg").read_text()
    assert "first difference: step 1100 of the timed phase" in drawn
    assert 'class="first"' not in drawn


def test_numbers_between_recorded_states_are_not_known(tmp_path: Path) -> None:
    """Decide nothing of units in the last place where hashes differ at steps whose states were not recorded."""
    a, b = _record(tmp_path, None, stride=8), _record(tmp_path, None, stride=8, moved=3)
    found = compare(a, b)
    assert (found.max_ulp, found.compared.unseen_steps) == (0, 1)
    rung = _verdict(found, a, b).rungs[2]
    assert (rung.level, rung.holds) == (AuditLevel.WITHIN_ULPS, None)
    assert "over 2 recorded steps" in rung.said
    assert "state hashes differ at 1 step of which no state was recorded" in rung.said


def test_a_phase_that_is_not_there_is_named(tmp_path: Path) -> None:
    """Decide nothing of an original of which the replay has not all, and count what was compared."""
    whole, part = _record(tmp_path, [1, 2, 3, 4]), _record(tmp_path, None)
    found = compare(whole, part)
    assert found.bit_identical
    rung = _verdict(found, whole, part).rungs[0]
    assert rung.holds is None
    assert "in every bit; not everything of the original was compared: state hashes of 2 of 2 " in rung.said
    assert distinct([whole], [part]) == (1, 1, 1)


@pytest.fixture(scope="module")
def sweep() -> dict[int, GroupResult]:
    """A shipped sweep of a robot without captured states, by its number of environments."""
    files = (Path(__file__).resolve().parents[2] / "recordings" / "sweeps-h100").glob("mjx-franka-*.mcap")
    return {result.group.key.n_env: result for result in evaluate_files(sorted(files)).results}


def test_runs_without_captured_states_are_compared_by_timed_steps(sweep: dict[int, GroupResult]) -> None:
    """Say of each number of environments whether its runs agree at both ends of the timed phase, and name the steps."""
    counts = {n: result.metrics["distinct_runs"] for n, result in sweep.items()}
    assert {n: (count.value, count.n) for n, count in counts.items()} == {512: (1, 3), 4096: (2, 3), 8192: (3, 3)}
    for count in counts.values():
        details = count.of(DistinctRuns)
        assert (details.timed_steps, details.first_difference_step, details.tree) == ((100, 200), None, None)
    at = "at steps 100 and 200 of the timed phase"
    cells = {n: repeats([result]) for n, result in sweep.items()}
    assert {n: cell.text for n, cell in cells.items()} == {512: "yes, timed", 4096: "no, timed", 8192: "no, timed"}
    assert cells[512].notes == ("all 3 runs", at)
    assert repeats(list(sweep.values())).notes == ("2 of 3 groups", at, "yes with n_env=512")


def test_actions_of_the_timed_phase_tell_environments_apart(sweep: dict[int, GroupResult]) -> None:
    """Ask nothing of environments that got different actions, though no state, and so no action, was captured."""
    envs = sweep[512].metrics["distinct_envs"]
    assert envs.value == Missing("the environments were given different actions, so they differ by design")


def test_two_sets_without_captured_states(sweep: dict[int, GroupResult]) -> None:
    """Compare two sets by the states that their timed phases hashed; of single runs that differ, decide nothing."""
    alike = sweep[512].group.complete
    same = compare_bits(alike[:2], alike[2:])
    assert same is not None
    assert (same.change, same.said[1]) == (Change.SAME, "bit-identical at 2 steps of the timed phase")
    differing = sweep[8192].group.complete
    other = compare_bits(differing[:1], differing[1:2])
    assert other is not None
    assert (other.change, other.missing.split(" (")[0]) == (
        Change.NOT_COMPARED,
        "they differ at step 100 of the timed phase",
    )


@pytest.mark.parametrize("captured", [True, False])
def test_captured_states_come_first(captured: bool, sweep: dict[int, GroupResult]) -> None:
    """Compare runs by timed steps only where none of the group has captured states."""
    first, *others = sweep[512].group.complete
    first = replace(first, histories=first.timed_histories) if captured else first
    compared, timed = hashed_by([first, *others])
    assert (len(compared), timed) == ((1, False) if captured else (3, True))


def test_no_distance_of_zero_is_shown(tmp_path: Path) -> None:
    """Answer "no" alone where bodies of two runs differ in their heights, and W1, which is in the plane, is zero."""
    for run in range(2):
        final = grid(2, "float32")
        final[..., 2] += np.float32(0.01 * run)
        write_recording(tmp_path, final, run=run)
    (result,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).results
    assert result.metrics["w1_run_to_run"].value == 0
    cell = repeats([result])
    assert (cell.text, cell.notes) == ("no", ("2 distinct of 2",))
