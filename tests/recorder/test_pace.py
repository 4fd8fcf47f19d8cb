"""What gsb-record says between the ends of runs: which run, which phase, how long, and what is left."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.recorder.process.launch import Result
from gpusimbench.recorder.run.pace import Pace
from gpusimbench.recorder.sets.progress import BarProgress, LineProgress
from gpusimbench.schemas.errors import ExitCode
from tests.schemas.test_progress import Clock


def _ended(run: int) -> Result:
    return Result(run, "complete", "", None, ExitCode.OK)


def test_the_first_run() -> None:
    """Name the phase, and estimate it by its steps; the timed ones, which nobody counts, by the warm-up."""
    pace = Pace(3, 0, 0.0)
    assert pace.words(4.0) == "run 1/3: starting, 4 s so far"
    pace.update(0, "init", 0, 1, 5.0)
    assert pace.words(9.0) == "run 1/3: building, 4 s so far"
    pace.update(0, "compile", 0, 1, 10.0)
    assert pace.words(40.0) == "run 1/3: compiling, 30 s so far"
    pace.update(0, "warmup", 0, 100, 50.0)
    pace.update(0, "timed", 0, 1000, 55.0)
    assert pace.words(65.0) == "run 1/3: timed steps, 1000 steps, 10 s so far, about 40 s left of this phase"
    assert pace.words(200.0) == "run 1/3: timed steps, 1000 steps, 2 min 25 s so far"
    pace.update(0, "capture", 0, 500, 210.0)
    pace.update(0, "capture", 100, 500, 220.0)
    assert pace.words(220.0) == "run 1/3: capture, 100 of 500 steps, 10 s so far, about 40 s left of this phase"


def test_further_runs() -> None:
    """Estimate all runs by those that have ended."""
    pace = Pace(3, 0, 0.0)
    pace.update(0, "init", 0, 1, 1.0)
    assert pace.left(2.0) is None
    assert pace.finish(0, 60.0) == 60.0
    pace.update(1, "init", 0, 1, 61.0)
    assert pace.words(80.0) == "run 2/3: building, 19 s so far, about 1 min 40 s left for all runs"
    assert pace.finish(1, 120.0) == 60.0
    pace.update(2, "init", 0, 1, 121.0)
    assert pace.words(190.0) == "run 3/3: building, 1 min 09 s so far"  # longer than the others: nobody knows
    pace.finish(2, 200.0)
    assert pace.words(181.0) == ""


def test_runs_at_once() -> None:
    """Share the time that is left among runs on several machines, and take each one's own time."""
    pace = Pace(6, 2, 0.0)
    for run in (2, 3):
        pace.update(run, "init", 0, 1, 0.0)
    assert pace.finish(3, 30.0, 30.0) == 30.0
    pace.update(4, "init", 0, 1, 30.0)
    assert pace.words(40.0).startswith("run 3/6 (and 1 more at once): building, 40 s so far, about ")
    assert pace.left(30.0) == pytest.approx((30.0 * 3 - 30.0) / 2)


@given(
    st.integers(1, 5),
    st.lists(
        st.tuples(
            st.integers(0, 4), st.sampled_from(["init", "compile", "warmup", "timed", "capture", "ending", "end"]),
            st.integers(0, 5), st.integers(0, 5), st.floats(0.0, 100.0),
        )
    ),
)  # fmt: skip
def test_whatever_is_reported(runs: int, reports: list[tuple[int, str, int, int, float]]) -> None:
    """Say something, and nothing below zero, whatever a run's process tells."""
    pace, now = Pace(runs, 0, 0.0), 0.0
    for run, phase, done, of, seconds in reports:
        now += seconds
        if phase == "end":
            pace.finish(run, now)
        else:
            pace.update(run, phase, done, of, now)
        assert "-" not in pace.words(now).replace("warm-up", "")
        assert (pace.left(now) or 0.0) >= 0.0


def test_lines(capsys: pytest.CaptureFixture[str]) -> None:
    """Write a line for the set, then lines on the present run, seldom, and one for its end."""
    clock = Clock()
    with LineProgress("a set", 2, clock=clock) as progress:
        for second in range(1, 16):
            clock.now = 100.0 + second
            progress.update(0, "capture", second, 30)
            progress._ticker.tick()
        progress.finish(_ended(0))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "a set",
        "run 1/2: capture, 2 of 30 steps, 1 s so far, about 14 s left of this phase",
        "run 1/2: capture, 12 of 30 steps, 11 s so far, about 16 s left of this phase",
        "run 1/2 complete in 15.0 s",
    ]


def test_bars(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Draw what is left beside the bars of a terminal, and the lines of ended runs above them."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with BarProgress("a set", 2, 0) as progress:
        progress.update(0, "capture", 1, 30)
        progress.finish(_ended(0), 1000.0)
        progress.update(1, "capture", 1, 30)
        progress._bars.refresh()
    out, err = capsys.readouterr()
    assert out == ""
    assert "run 1/2 complete in 1000.0 s" in err
    assert "about 16 min 40 s left" in err
