"""How far a command is: nothing for two seconds, then lines with what is left; never on standard output."""

from __future__ import annotations

import io
import sys
import textwrap
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.commands import progress
from gpusimbench.schemas.commands.progress import Progress, Stage, duration, each, moved, received, sizes, stage
from gpusimbench.schemas.text import line, show
from tests.conftest import run_python

ROOT = Path(__file__).resolve().parents[2]


class Clock:
    """A clock that stands still until it is told."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        """The time [s]."""
        return self.now


class Terminal(io.StringIO):
    """What a terminal is sent."""

    def isatty(self) -> bool:
        """It is one."""
        return True


@pytest.fixture
def clock() -> Clock:
    """A clock."""
    return Clock()


def test_lines(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """Say nothing for two seconds, then more and more seldom how far it is."""
    said = []
    with Progress("gsb-x", live=False, clock=clock) as shown, stage("reading", 100) as made:
        for _ in range(100):
            clock.now += 1.0
            made.advance()
            shown.tick()
            said += [(clock.now - 100.0, text) for text in capsys.readouterr().err.splitlines()]
    assert [when for when, _ in said] == [2.0, 12.0, 32.0, 62.0, 92.0]
    assert said[1][1] == "gsb-x: reading: 12 of 100, 12 s so far, about 1 min 28 s left"
    assert capsys.readouterr() == ("", "")


def test_a_short_command(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """Say nothing of what takes less than two seconds."""
    with Progress("gsb-x", live=False, clock=clock) as shown:
        for _ in each([1, 2, 3], "reading"):
            clock.now += 0.6
            shown.tick()
    assert capsys.readouterr() == ("", "")


def test_a_terminal(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw over one line, take it away for what is printed meanwhile, and leave nothing of it at the end."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with Progress("gsb-x", clock=clock) as shown:
        for number in each(["a", "b"], "reading"):
            clock.now += 3.0
            shown.tick()
            show(line(f"read {number}"), error=True)
    drawn = terminal.getvalue()
    assert drawn.split("\r\x1b[K") == [
        "", "gsb-x: reading: 0 of 2, 3 s so far", "read a\n", "gsb-x: reading: 1 of 2, 6 s so far, about 6 s left",
        "read b\n",
    ]  # fmt: skip


def test_weights_and_parts_of_parts(clock: Clock) -> None:
    """Estimate by bytes, also within a file; and say nothing of what is left where nobody knows."""
    with Progress("gsb-x", live=False, clock=clock) as shown, stage("reading", 2, [900.0, 100.0]) as made:
        clock.now += 9.0
        moved(450.0)
        assert shown.stages[-1].words(clock.now) == "reading: 0 of 2, 9 s so far, about 11 s left"
        made.advance()
        assert made.words(clock.now) == "reading: 1 of 2, 9 s so far, about 1 s left"
        with stage("drawing"):
            assert shown.stages[-1].words(clock.now + 5.0) == "drawing, 5 s so far"
        with stage("writing", 1):
            assert shown.stages[-1].words(clock.now + 5.0) == "writing, 5 s so far"
        assert shown.stages == [made]
    moved(1.0)  # of nothing


@pytest.mark.parametrize("weights", [[], [0.0, 0.0, 0.0, 0.0], [1.0], [5.0, 5.0, 5.0, 5.0]])
def test_parts_without_weights_are_equal(weights: list[float]) -> None:
    """Take a part for as long as another where there is no weight for each, or all are nothing."""
    made = Stage("x", 4, 0.0, weights)
    made.advance()
    assert made.share() == 0.25


def test_what_is_not_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    """Pass items and results through where no command is entered."""
    assert list(each([1, 2], "reading")) == [1, 2]
    assert list(received(iter("ab"), "reading", 2)) == ["a", "b"]
    assert progress._present is None
    assert capsys.readouterr() == ("", "")


@given(st.lists(st.floats(0.0, 1e12), max_size=8), st.lists(st.floats(0.0, 1e12), max_size=20), st.integers(0, 12))
def test_a_share_is_a_share(weights: list[float], moves: list[float], total: int) -> None:
    """Keep between nothing and all, grow with each part, whatever is told."""
    made = Stage("x", total, 0.0, weights)
    before = 0.0
    for weight in moves:
        made.move(weight)
        assert before - 1e-9 <= made.share() <= 1.0 + 1e-9
        before = made.share()
        made.advance()
        assert before - 1e-9 <= made.share() <= 1.0 + 1e-9
        before = made.share()
        assert "left" not in made.words(0.0) or "about 0 s left" in made.words(0.0)


@pytest.mark.parametrize(("seconds", "said"), [(0.4, "0 s"), (59.4, "59 s"), (200, "3 min 20 s"), (3900, "1 h 05 min")])
def test_durations(seconds: float, said: str) -> None:
    """Say times as people do."""
    assert duration(seconds) == said


def test_sizes(tmp_path: Path) -> None:
    """Weigh files by their bytes, and all alike where one cannot be."""
    (tmp_path / "a").write_bytes(b"123")
    assert sizes([tmp_path / "a"]) == [3.0]
    assert sizes([tmp_path / "a", tmp_path / "b"]) == []


def test_a_command_that_takes_long() -> None:
    """Write lines on standard error from a thread, and JSON alone on standard output."""
    program = textwrap.dedent("""
        import sys, threading
        from gpusimbench.schemas.commands import progress
        progress.FIRST_S = progress._DRAWN_S = 0.01
        from gpusimbench.evaluator.check import integrity
        examine, drawn = integrity.examine, threading.Event()
        tick = progress.Ticker.tick
        def ticked(self):
            tick(self)
            if self.stages:
                drawn.set()
        progress.Ticker.tick = ticked
        def slow(*given, **named):
            drawn.clear(); assert drawn.wait(300); drawn.clear(); assert drawn.wait(300)
            return examine(*given, **named)
        integrity.examine = slow
        from gpusimbench.evaluator.cli.check import main
        sys.exit(main(sys.argv[1:]))
    """)
    file = ROOT / "recordings" / "mujoco-amd-r0.mcap"
    done = run_python(program, file, "--json", "-", env={"GSB_PROGRESS": "on"})
    assert done.stdout.startswith("{")
    assert done.stderr.splitlines()[0].startswith("gsb-check: checking recordings, ")


def test_the_innermost_stage_is_told(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """Name the stage that is at work, not the stage that it is a part of."""
    with Progress("gsb-x", live=False, clock=clock) as shown, stage("evaluating", 10), stage("reading", 100) as made:
        clock.now += 30.0
        made.advance()
        shown.tick()
    assert capsys.readouterr().err.startswith("gsb-x: reading: 1 of 100")


def test_no_thread_is_left(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the work without telling of it where the system starts no thread."""

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.delenv("GSB_PROGRESS", raising=False)
    monkeypatch.setattr(threading.Thread, "start", refuse)
    with Progress("gsb-x", live=False, clock=clock), stage("reading", 2) as made:
        made.advance()
    assert made.done == 1
