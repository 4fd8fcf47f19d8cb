"""Real trials: the same format, or one clear line naming row and column."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.positions import sample_positions
from gpusimbench.recorder.cli import main
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.trials.real import parse_trials
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trial_units import extent_of, unit_doubt
from tests.conftest import Command
from tests.reading import verified
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
    recording = verified(path)
    array = recording.state("cubes", "position")
    assert array.shape == (1, 4, 27, 3 if z else 2)
    assert array.steps.tolist() == [1]
    assert np.allclose(array.at_step(1)[..., :2], (grid(4) + [0.02, 0.0, 0.0])[..., :2])
    assert recording.attachment("trials.csv") == (tmp_path / "trials.csv").read_bytes()

    # at another time there are no positions, even where it is nearest to the step that was measured
    dt = recording.configuration.dt
    for share in (0.9, 1.1):
        missing = sample_positions(recording, share * dt)
        assert isinstance(missing, Missing) and missing.reason.startswith("the trials were measured at ")

    simulated = write_recording(tmp_path, grid(4))
    evaluated = gsb_eval(simulated, path, "--json", "-", code=0)
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
        (_with(1, "time,q1,q2"), "positions or joint angles over time: see docs/how-to/real-trials.md"),
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
            ((*argument, "--trials", "missing.csv", "--unit", "m"), f"{argument[0]} is for a simulator; --sim real")
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
    done = gsb_record("--sim", "real", *arguments, cwd=tmp_path, code=2)
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


@pytest.mark.parametrize(
    ("scale", "unit", "message"),
    [
        (100.0, "m", "trial t0 (and 1 more of 2): half of its bodies lie 31 m or more beside the board: m cannot be"),
        (100.0, "m", "its unit; cm would fit"),
        (1.0, "cm", "its 27 bodies with edges of 0.02 m lie within 0.004 m by 0.002 m: cm cannot be its unit; m would"),
        (1000.0, "m", "m cannot be its unit; mm would fit"),
    ],
)
def test_the_wrong_unit_is_refused(gsb_record: Command, tmp_path: Path, scale: float, unit: str, message: str) -> None:
    """Name the first trial, what is odd, and the unit that would fit; end with 2 and write nothing."""
    (tmp_path / "trials.csv").write_text(csv(grid(2), scale=scale))
    done = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", unit, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


def test_one_trial_in_another_unit_is_named(gsb_record: Command, tmp_path: Path) -> None:
    """Find one trial of four that somebody measured in metres."""
    final = grid(4)
    final[2] /= 100
    (tmp_path / "trials.csv").write_text(csv(final))
    done = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", "cm", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "trial t2: its 27 bodies" in done.stderr


def test_a_wide_outcome_is_recorded_with_a_warning(gsb_record: Command, gsb_eval: Command, tmp_path: Path) -> None:
    """Warn of cubes half of which are a little beside the board, on recording and on evaluating, and compare them."""
    (tmp_path / "trials.csv").write_text(csv(grid(2) + [0.4, 0.0, 0.0]))
    done = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", "cm", "--out", tmp_path / "out")
    assert done.returncode == 0
    said = "trial t0 (and 1 more of 2): half of its bodies lie 0.1 m or more beside the board: cm may not be its unit"
    assert f"warning: {tmp_path / 'trials.csv'}: {said}" in done.stderr
    found = gsb_eval(write_recording(tmp_path, grid(2)), done.stdout.strip(), "--json", "-")
    assert metrics_of(found.stdout)["w1_real"]["value"] == pytest.approx(40.0)
    assert said in found.stdout


@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall"])
@given(st.floats(0.3, 3.0), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_factor_of_a_hundred_is_always_found(scene: str, spread: float, x: float, y: float) -> None:
    """Accept what lies about the scene, and neither a hundredth nor a hundredfold of it."""
    described = json.loads(make_scene(scene).to_json())
    extent = extent_of(described, "cubes")
    middle = np.array([0.3, 0.0])
    trial = ((grid(1)[..., :2] - middle) * min(spread, 1.4) + (middle if extent.what == "the board" else 0.0)) + [
        x * 0.2, y * 0.2,
    ]  # fmt: skip
    assert unit_doubt(trial, "m", ["a"], extent) is None
    for factor, unit in ((100.0, "m"), (0.01, "cm")):
        doubt = unit_doubt(trial * factor, unit, ["a"], extent)
        assert doubt.wrong or factor > 1


def test_a_recording_in_the_wrong_unit_is_no_reference(
    gsb_record: Command, gsb_eval: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refuse trials that an older recorder took in the wrong unit, with the reason in place of 3,000 cm."""
    (tmp_path / "trials.csv").write_text(csv(grid(2), scale=100.0))
    monkeypatch.setattr("gpusimbench.recorder.trials.real.unit_doubt", lambda *_: None)
    text = ["--sim", "real", "--trials", str(tmp_path / "trials.csv"), "--unit", "m", "--out", str(tmp_path / "out")]
    assert main(text) == 0
    (path,) = (tmp_path / "out").glob("*.mcap")
    done = gsb_eval(write_recording(tmp_path, grid(2)), path, "--json", "-")
    metric = metrics_of(done.stdout)["w1_real"]
    assert metric["value"] is None
    assert "cannot be used: trial t0 (and 1 more of 2): half of its bodies lie 31 m" in metric["value_missing"]
    assert "cm would fit" in metric["value_missing"]
