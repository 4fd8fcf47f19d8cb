"""What says of itself that it is an instrument is evaluated like any other, and ranked against none."""

from __future__ import annotations

from pathlib import Path

import pytest

from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.ranking import Comparison
from tests.synthetic import grid, write_recording, write_sweep

NOTE = "radar and guidelines leave out instruments: control"


def compared(folder: Path) -> Comparison:
    """All recordings of a folder."""
    return evaluate_files(sorted(folder.glob("*.mcap"))).comparison


@pytest.mark.parametrize("swept", [False, True], ids=["groups", "sweeps"])
def test_an_instrument_is_not_ranked(tmp_path: Path, swept: bool) -> None:
    """Compare the two engines without the instrument, which is faster than both, and say so."""
    for name, speed in (("fast", 2.0), ("slow", 1.0), ("control", 9.0)):
        switches = {"instrument": True} if name == "control" else None
        if swept:
            write_sweep(tmp_path, (1, 4, 16), simulator=name, speed=1e4 * speed, switches=switches)
        else:
            write_recording(tmp_path, grid(2), simulator=name, elapsed_s=1 / speed, switches=switches)
    comparison = compared(tmp_path)
    assert {c.figures.name for c in comparison.contenders} == {"fast", "slow"}
    assert all("control" not in (g.pick or "") + (g.evidence or "") for g in comparison.guidelines)
    assert comparison.notes == (NOTE,)


def test_an_engine_and_an_instrument_are_no_comparison(tmp_path: Path) -> None:
    """Draw no radar of one engine beside an instrument, and none of an instrument alone."""
    write_recording(tmp_path, grid(2), simulator="control", switches={"instrument": True})
    assert compared(tmp_path) == Comparison()
    write_recording(tmp_path, grid(2), simulator="engine")
    assert compared(tmp_path) == Comparison(notes=(NOTE,))
