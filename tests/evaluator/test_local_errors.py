"""Local errors: of simulated tosses that are set to measured states again and again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpusimbench.evaluator.metrics.tosses import Motion, at_rows, local_errors
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.group_metrics import W1_REAL
from gpusimbench.evaluator.results.toss_metrics import TOSS_LOCAL_METRICS, TOSS_LOCAL_POSITION, TOSS_POSITION
from gpusimbench.evaluator.runs.toss_motion import errors_of, local_errors_of, measured_tosses
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.initial import GIVEN
from tests.conftest import Command, call, recorded
from tests.evaluator.test_toss_errors import CUBE, DT, flight


def test_known_errors() -> None:
    """Measure a shift and a turn at the ends of predictions, over the measured rows of each toss, and nothing else."""
    measured = flight()
    counts = np.array([20, 12, 5])
    ends = at_rows(measured, np.array([5, 10, 15]))
    shift = np.zeros_like(ends.position)
    shift[..., 0] = np.array([0.001, 0.002, 0.003])[:, None]
    turned = Rotation.from_rotvec([0.1, 0, 0]) * Rotation.from_quat(np.roll(ends.orientation, -1, -1).reshape(-1, 4))
    moved = replace(
        ends,
        position=ends.position + shift,
        orientation=np.roll(turned.as_quat(), 1, axis=-1).reshape(ends.orientation.shape),
    )
    found = local_errors(moved, measured, counts, CUBE, DT, 5)
    np.testing.assert_allclose(found.position, [0.002, 0.0015, np.nan])  # the third has no row 5
    np.testing.assert_allclose(found.rotation, [0.1, 0.1, np.nan])


def test_the_floor_is_of_free_flight() -> None:
    """Find no floor in exact flight, whose velocities are means over the interval before; noise of one row counts at
    that row and at the one after, and what is near the table does not."""
    exact = flight()
    # as it is measured: the mean velocity over the interval before a row
    seen = replace(exact, linear_velocity=exact.linear_velocity + [0, 0, 9.81 * DT / 2])
    counts = np.array([20, 20, 20])

    def floor(measured: Motion, rows: int) -> tuple[float, float, int]:
        ends = at_rows(measured, np.arange(rows, 20, rows))
        found = local_errors(ends, measured, counts, CUBE, DT, rows).floor
        return found.position, found.rotation, found.tosses

    for rows in (1, 5, 19):
        assert floor(seen, rows) == (pytest.approx(0, abs=1e-12), pytest.approx(0, abs=1e-7), 3)
    noisy = replace(seen, position=seen.position.copy())
    noisy.position[10, :, 0] += 0.019
    assert floor(noisy, 1)[0] == pytest.approx(2 * 0.019 / 19)
    assert floor(noisy, 10)[0] == pytest.approx(0.019)
    low = replace(seen, position=seen.position - [0, 0, 20.0])
    assert floor(low, 1)[2] == 0
    grazing = replace(seen, position=seen.position.copy())
    grazing.position[10, 0, 2] = 0.0  # of one toss: what begins or ends there, or passes, is left out
    assert floor(grazing, 1)[0] == pytest.approx(0, abs=1e-12)
    assert floor(grazing, 19)[2] == 2


_POSITION = "teacher/cubes/position"
_SHARED = ("--scene", "cube-toss", "--runs", "1", "--phases", "capture", "--no-view", "--sim", "mujoco")


@pytest.fixture(scope="module")
def reference() -> Path:
    """The synthetic tosses."""
    (path,) = recorded("--sim", "real", "--scene", "cube-toss")
    return path


@pytest.fixture(scope="module")
def runs() -> dict[str, Path]:
    """The same tosses simulated: set every 1, 10, 100 rows, with a cone that the truth does not have, and not set."""
    found = {str(k): recorded(*_SHARED, "--intervene", f"teacher@{k}") for k in (1, 10, 100)}
    found["pyramidal"] = recorded(*_SHARED, "--intervene", "teacher@10", "--option", "cone=pyramidal")
    found["fine"] = recorded(
        *_SHARED, "--intervene", "teacher@40", "--dt", str(1 / 148 / 4), "--stride", "4"
    )  # fmt: skip
    found["free"] = recorded(
        "--scene", "cube-toss", "--runs", "1", "--phases", "capture", "--no-view", "--sim", "mujoco"
    )
    return {name: path for name, (path,) in found.items()}


@pytest.fixture(scope="module")
def evaluation(reference: Path, runs: dict[str, Path]) -> Evaluation:
    """All of them."""
    return evaluate_files([reference, *runs.values()], sample_time=441 / 148)


def test_local_errors(evaluation: Evaluation, runs: dict[str, Path]) -> None:
    """Find errors that grow with the rows between settings, and are larger with a wrong cone at either step."""
    names = {str(path): name for name, path in runs.items()}
    found = {names[str(r.group.recordings[0].path)]: r for r in evaluation.results}
    error = {name: known(r.metrics[TOSS_LOCAL_POSITION.name].value) for name, r in found.items()}
    assert error.pop("free") is None
    assert max(error["fine"] or 9, error["10"] or 9) < (error["pyramidal"] or 0)
    assert (error["1"] or 9) < (error["10"] or 9) < (error["100"] or 0)
    for name, rows in (("1", 1), ("10", 10), ("fine", 10), ("100", 100)):
        for metric in TOSS_LOCAL_METRICS:
            estimate = found[name].metrics[metric.name]
            details = estimate.of(OverTosses)
            assert details.rows == rows
            assert estimate.n == details.tosses == len(details.per_toss)
            assert estimate.ci95[0] < (known(estimate.value) or 0) < estimate.ci95[1]
            floor = details.tracking_floor
            assert (floor is None) == (rows == 100)
            assert floor is None or 0 < floor < (known(estimate.value) or 0)
    assert found["10"].metrics[TOSS_LOCAL_POSITION.name].n == 48
    assert 0 < found["100"].metrics[TOSS_LOCAL_POSITION.name].n < 48  # tosses of more than 100 rows


def test_set_states_are_no_merit(evaluation: Evaluation) -> None:
    """Give a run that is set to the reference no distance to it, no error of whole tosses and no check of mechanics."""
    for result in evaluation.results:
        taught = bool(result.group.key.told["intervention"])
        whole, w1 = (result.metrics[metric.name].value for metric in (TOSS_POSITION, W1_REAL))
        assert isinstance(whole, Missing) == taught
        assert isinstance(w1, Missing) == taught
        if taught:
            assert "it has local errors" in whole.reason
            assert "set to the reference's states" in w1.reason
            assert not any(result.fidelity.of(verdict) for verdict in (CheckVerdict.BROKEN, CheckVerdict.HELD))
        # a label says how often, and no digest of what follows from that
        assert "states:" not in result.label
        assert (result.group.key.told["intervention"] in result.label) or not taught


def test_outputs(reference: Path, runs: dict[str, Path], gsb_eval: Command) -> None:
    """Show the errors, the rows and the floor, with whole tosses and without them."""
    both = gsb_eval(reference, runs["10"], runs["free"], "--all").stdout
    assert "Errors against synthetic tosses" in both
    alone = gsb_eval(reference, runs["10"], runs["1"], "--all").stdout
    assert "Errors against synthetic tosses" not in alone
    for shown in (both, alone):
        assert "Local errors against synthetic tosses" in shown
    short = gsb_eval(reference, runs["10"]).stdout
    assert "cm after 10 rows" in short
    record = json.loads(gsb_eval(reference, runs["10"], "--json", "-").stdout)
    metric = record["groups"][0]["metrics"]["toss_local_position"]
    assert metric["extra"]["rows"] == 10
    assert metric["extra"]["tosses"] == metric["n"] == 48
    assert "k = 10" in metric["method"]
    several = gsb_eval(reference, runs["10"], runs["free"]).stdout
    assert "that only gsb-probe needs" not in several


def test_whole_files(runs: dict[str, Path]) -> None:
    """Find nothing wrong with a recording whose capture stopped at every row."""
    call("gsb-check", runs["1"], runs["fine"], "--rules", "integrity-1", code=ExitCode.OK)


def test_why_not(reference: Path, runs: dict[str, Path]) -> None:
    """Say why there are no local errors."""
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    free = local_errors_of(Recording(runs["free"]), measured)
    assert "record with --intervene teacher@STEPS" in free.reason
    (late,) = recorded(*_SHARED, "--intervene", "teacher@400")
    found = local_errors_of(Recording(late), measured)
    assert "the longest toss has" in found.reason
    (short,) = recorded(*_SHARED, "--intervene", "teacher@10", "--steps", "40")
    found = local_errors_of(Recording(short), measured)
    assert "it ends after row 40" in found.reason
    whole = errors_of(Recording(runs["10"]), measured)
    assert isinstance(whole, Missing)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda given: {}, "does not have the states that it was set to"),
        (lambda given: {**given, "teacher/first": given["teacher/first"].astype(float)}, "does not have the states"),
        (
            lambda given: {**given, "teacher/first": given["teacher/first"] - (np.arange(49) == 48)},
            "is not among the states",
        ),
        (lambda given: {**given, "teacher/first": given["teacher/first"] + 9**9}, "another shape"),
        (lambda given: {**given, _POSITION: given[_POSITION][:, :, :2]}, "another shape"),
        (lambda given: {**given, _POSITION: np.roll(given[_POSITION], -1, axis=0)}, "another position"),
        (lambda given: {**given, _POSITION: given[_POSITION] * np.nan}, "another position"),
    ],
    ids=["none", "floats", "too few", "beyond", "flat", "a row ahead", "nan"],
)
def test_set_to_something_else(
    change: Callable[[dict[str, Any]], dict[str, Any]], said: str, reference: Path, runs: dict[str, Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Give no local errors of a run that was set to other states than the measured ones, such as later rows."""
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    recording = Recording(runs["10"])
    changed = arrays.encode(change(arrays.decode(GIVEN, recording.attachment(GIVEN) or b"")))
    monkeypatch.setattr(recording, "attachment", lambda name: changed)
    found = local_errors_of(recording, measured)
    assert said in found.reason
    monkeypatch.setattr(recording, "attachment", lambda name: b"PK")
    found = local_errors_of(recording, measured)
    assert "no archive of arrays" in found.reason
