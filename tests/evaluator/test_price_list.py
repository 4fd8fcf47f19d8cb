"""What determinism costs, from recordings whose speed is known."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import pytest

from evaluator.evaluate import evaluate_files
from evaluator.price_list import Family, Price
from evaluator.report.tables import print_tables
from evaluator.soundness import faults
from tests.synthetic import grid, write_recording

SWITCH = {"exact": True}


def family(tmp_path: Path, **asked: Any) -> Family:
    """A default and a level of half its speed and twice its memory, three runs each."""
    for run in range(3):
        one = {"run": run, "gpu_bytes": (0, 10**9 + run), "elapsed_s": 1.0 + 0.01 * run}
        write_recording(tmp_path, grid(2), **one, switches={"exact": False})
        two = {"run": run, "gpu_bytes": (0, 2 * 10**9 + run), "elapsed_s": 2.0 + 0.02 * run}
        write_recording(tmp_path, grid(2), **{**two, "determinism": "full", "switches": SWITCH, **asked})
    (found,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    return found


def price(found: Family) -> Price:
    """The only one of a family."""
    (one,) = found.prices
    return one


def test_a_known_price(tmp_path: Path) -> None:
    """Find the ratios of speed and memory, with intervals around them, and the switch that makes them."""
    found = family(tmp_path)
    assert found.base is not None
    assert found.base.group.key.determinism == "default"
    one = price(found)
    assert (one.level, one.differs) == ("full", ("exact=True",))
    assert one.speed.ratio == pytest.approx(0.5)
    assert one.memory.ratio == pytest.approx(2.0)
    for cost in (one.speed, one.memory):
        assert cost.ci95 is not None
        assert cost.ratio is not None
        assert cost.ci95[0] < cost.ratio < cost.ci95[1]


def test_invalid_runs_have_no_price(tmp_path: Path) -> None:
    """Give no price for a switch that makes runs INVALID, and say so."""
    one = price(family(tmp_path, status="INVALID", cause="BUFFER", reason="contacts were dropped"))
    assert one.speed.ratio is None
    assert one.speed.why_not == "3 of 3 runs are INVALID (buffer), so it has no price"


def test_refused_runs_say_why(tmp_path: Path) -> None:
    """Join a level that the engine refused to the family that was asked for the same."""
    one = price(family(tmp_path, built=False, status="FAILED", cause="REFUSED", reason="no such mode"))
    assert (one.level, one.speed.why_not) == ("full", "refused: no such mode")


def test_a_variable_may_be_the_switch(tmp_path: Path) -> None:
    """Compare over an environment variable, and tell it once where a switch repeats it."""
    flags = "--deterministic"
    one = price(family(tmp_path, environment={"FLAGS": flags}, switches={"exact": False, "flags": flags}))
    assert one.differs == ("flags=--deterministic",)


def test_other_settings_are_no_family(tmp_path: Path) -> None:
    """Do not price an option, a step or a simulator as a level of determinism."""
    for number, other in enumerate(({"options": {"solver": "b"}}, {"dt": 0.5}, {"simulator": "another"})):
        write_recording(tmp_path, grid(2), determinism="full", **other)
        write_recording(tmp_path, grid(2), run=number)
    assert evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list == ()


def test_no_default_no_price(tmp_path: Path) -> None:
    """Say that nothing stands at the default level."""
    for level in ("a", "b"):
        write_recording(tmp_path, grid(2), determinism=level)
    (found,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    assert found.base is None
    assert {p.speed.why_not for p in found.prices} == {"no group of the same configuration ran at the default level"}


def test_sunk_cubes_are_a_fault(tmp_path: Path) -> None:
    """Tell a group whose cubes went through the floor from one whose cubes lie on it."""
    sunk = grid(2)
    sunk[0, :5, 2] = -1.0
    for number, final in enumerate((grid(2), sunk)):
        write_recording(tmp_path, final, options={"which": number})
    sound, bad = (faults(r) for r in evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)
    assert not sound.sunk
    assert bad.sunk == "2.5 of 27 cubes per env sank"
    assert bad.sunk in str(bad)


def test_prices_in_a_terminal(tmp_path: Path) -> None:
    """Print ratios with intervals, and why a level has none."""
    family(tmp_path)
    for run in range(3):
        write_recording(tmp_path, grid(2), run=run, determinism="bad", status="INVALID", reason="lost contacts",
                        gpu_bytes=(0, 10**9))  # fmt: skip
    stream = io.StringIO()
    print_tables(evaluate_files(sorted(tmp_path.glob("*.mcap"))), stream)
    shown = stream.getvalue()
    assert "what determinism costs" in shown
    assert re.search(r"full +1 of 2 +1 of 3 +0\.5 \[0\.\d+, 0\.\d+\] +2 \[2, 2\]", shown)
    assert "synthetic, bad: no price: 3 of 3 runs are INVALID, so it has no price" in shown
