"""Real trials: the same format, or one clear line naming row and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator import open_recording
from recorder.trials import parse_trials
from schemas.errors import UsageError
from tests.conftest import Command
from tests.synthetic import grid, metrics_of, write_recording


def csv(positions: np.ndarray, *, z: bool = False, scale: float = 100.0) -> str:
    """Trials [trial, cube, 2 or 3] in metres as CSV text in centimetres."""
    lines = ["trial,cube,x,y,z" if z else "trial,cube,x,y"]
    for t, trial in enumerate(positions):
        for c, point in enumerate(trial):
            lines.append(f"t{t},{c}," + ",".join(repr(float(v) * scale) for v in point[: 3 if z else 2]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("z", [False, True])
def test_trials_are_a_recording(gsb_record: Command, gsb_eval: Command, tmp_path: Path, z: bool) -> None:
    """Record trials, find them by themselves as the reference, and measure the gap."""
    (tmp_path / "trials.csv").write_text(csv(grid(4) + [0.02, 0.0, 0.0], z=z))
    done = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", "cm", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    path = Path(done.stdout.strip())
    assert path.name.startswith("real-inclined-collision-n4-r0-")
    recording = open_recording(path)
    recording.verify()
    array = recording.state("cubes", "position")
    assert array.shape == (1, 4, 27, 3 if z else 2)
    assert array.steps.tolist() == [1]
    assert np.allclose(array.at_step(1)[..., :2], (grid(4) + [0.02, 0.0, 0.0])[..., :2])
    assert recording.attachment("trials.csv") == (tmp_path / "trials.csv").read_bytes()

    simulated = write_recording(tmp_path, grid(4))
    evaluated = gsb_eval(simulated, path, "--json", "-")
    assert evaluated.returncode == 0, evaluated.stderr
    gap = metrics_of(evaluated.stdout)["w1_real"]
    assert gap["value"] == pytest.approx(2.0, abs=1e-9)
    assert gap["extra"]["measured"] is True


GOOD = csv(grid(2)).splitlines()


def _with(row: int, text: str) -> str:
    lines = list(GOOD)
    lines[row - 1] = text
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the trials file is empty"),
        (GOOD[0], "a header and no rows"),
        (_with(1, "trial,cube,x"), "row 1: column y is missing"),
        (_with(1, "trial,cube,x,y,colour"), "row 1: column 'colour' is not known"),
        (_with(1, "trial,cube,x,x,y"), "row 1: column x appears twice"),
        (_with(5, "t0,3,1.0"), "row 5 has 3 cells, the header has 4"),
        (_with(5, "t0,3,nan,1.0"), "row 5, column x: nan is not a position"),
        (_with(5, "t0,3,1.0,inf"), "row 5, column y: inf is not a position"),
        (_with(5, "t0,3,1.0,abc"), "row 5, column y: 'abc' is not a number"),
        (_with(5, "t0,3.5,1.0,1.0"), "row 5, column cube: '3.5' is not a whole number"),
        (_with(5, "t0,27,1.0,1.0"), "row 5, column cube: 27 is not one of the scene's 27 cubes"),
        (_with(5, ",3,1.0,1.0"), "row 5, column trial: empty"),
        (_with(6, "t0,3,1.0,1.0"), "row 6, column cube: trial t0 has cube 3 already, in row 5"),
        ("\n".join(GOOD[:-1]), "trial t1 (last in row 54), column cube: 26 of 27 cubes; missing: 26"),
    ],
)
def test_bad_rows_are_named(gsb_record: Command, tmp_path: Path, text: str, message: str) -> None:
    """Name row and column in one line, end with 2, write nothing."""
    (tmp_path / "trials.csv").write_text(text)
    done = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", "m", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--sim real needs --trials"),
        (("--trials", "t.csv"), "--sim real needs --unit m or cm"),
        (("--trials", "missing.csv", "--unit", "m"), "cannot read missing.csv"),
        *(
            ((*argument, "--trials", "missing.csv", "--unit", "m"), f"{argument[0]} is for a simulator; --sim real has")
            for argument in (
                ("--n-env", "16"),
                ("--runs", "10"),
                ("--dt", "0.01"),
                ("--steps", "5"),
                ("--option", "a=b"),
                ("--seed", "0"),
                ("--stride", "1"),
                ("--warmup", "100"),
                ("--timed-steps", "9"),
                ("--phases", "timed"),
            )  # fmt: skip
        ),
    ],
)
def test_missing_arguments(gsb_record: Command, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    """Say which argument is missing, or has no meaning here."""
    done = gsb_record("--sim", "real", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr


def test_a_spreadsheet_export_is_read() -> None:
    """Accept a byte order mark, Windows line ends, blank last lines and columns in another order."""
    text = "\ufeffcube,trial,y,x\r\n" + "".join(f"{c},1,2,3\r\n" for c in range(2)) + "\r\n\r\n"
    trials = parse_trials(text, unit="cm", cubes=2)
    assert trials.positions.tolist() == [[[0.03, 0.02], [0.03, 0.02]]]


@given(st.text(max_size=300))
def test_any_text_is_read_or_refused(text: str) -> None:
    """Raise UsageError, never anything else."""
    try:
        parse_trials(text, unit="m", cubes=1)
    except UsageError:
        return


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=9))
def test_numbers_survive(points: list[tuple[float, float]]) -> None:
    """Read back the very numbers that were written."""
    trials = parse_trials(csv(np.array([points]), scale=1.0), unit="m", cubes=len(points))
    assert np.array_equal(trials.positions[0], points)
