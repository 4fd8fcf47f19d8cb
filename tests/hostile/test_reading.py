"""Thousands of spoiled recordings: each is refused, reads as incomplete, or says exactly what the original said."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.hostile.mutate import MUTATORS, Promise
from tests.hostile.soak import MEMORY_BYTES
from tests.test_docs import ROOT, commands, shell

COUNT = 100
"""Of each mutator. A soak of hours (python -m tests.hostile.soak) has other seeds."""

_FEW = 10
"""The first of them, which `make test` tries; the slow test tries the others."""

_ALWAYS_SAME = {"other_layout"}


def test_there_are_enough() -> None:
    """Spoil 2000 files or more."""
    assert COUNT * len(MUTATORS) >= 2000


@pytest.mark.parametrize(
    "numbers", [range(_FEW), pytest.param(range(_FEW, COUNT), marks=pytest.mark.slow)], ids=["few", "others"]
)
def test_spoiled_recordings(numbers: range, corpus: list[Path], tmp_path: Path) -> None:
    """Keep every promise on the files that every mutator spoils, in one process of 2 GiB of address space."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile.soak", *map(str, corpus), "--seed", "0",
         "--first", str(numbers.start), "--count", str(len(numbers)), "--keep", str(tmp_path),
         "--memory", str(MEMORY_BYTES)],
        capture_output=True, text=True, timeout=1200,
    )  # fmt: skip
    assert done.stdout, f"it died of {done.returncode}: {done.stderr[-2000:]}"
    found = json.loads(done.stdout)
    assert not found["broken"]
    assert done.returncode == 0
    outcomes = found["outcomes"]
    assert outcomes.keys() == MUTATORS.keys()
    assert {name: sum(of.values()) for name, of in outcomes.items()} == dict.fromkeys(MUTATORS, len(numbers))
    for mutator, of in outcomes.items():
        if mutator in _ALWAYS_SAME:
            assert set(of) == {"the same"}, mutator
        else:
            assert of.keys() & {"refused", "incomplete"}, f"nothing was noticed of {mutator}: was anything spoiled?"


def test_the_judge_can_fail(corpus: list[Path], tmp_path: Path) -> None:
    """Call it broken where another recording stands for the original, or a good one is said to be no change."""
    from tests.hostile.mutate import Mutant
    from tests.hostile.verdict import Broken, Judge

    judge = Judge(corpus[:2], tmp_path / "x.mcap")
    stranger = corpus[-1].read_bytes()
    with pytest.raises(Broken, match="not the original's"):
        judge.read(Mutant(stranger, 0), 0)
    with pytest.raises(Broken, match="accepted, and not the original's: content_hash, reason, status"):
        judge.read(Mutant(corpus[0].read_bytes()[:-1], 0, Promise.SAME), 0)


@pytest.mark.slow
def test_the_commands_of_the_page() -> None:
    """Run what docs/strangers.md shows."""
    lines = commands(ROOT / "docs" / "strangers.md")
    assert lines
    for line in lines:
        assert not json.loads(shell(line, ROOT).stdout)["broken"]


def test_the_page_tells_how_much_is_tried() -> None:
    """Let docs/strangers.md and the tests have the same numbers."""
    page = (ROOT / "docs" / "strangers.md").read_text(encoding="utf-8")
    assert f"in {len(MUTATORS)} ways" in page
    assert f"CI tries {COUNT * len(MUTATORS)} files" in page
    assert MEMORY_BYTES == 2 << 30
