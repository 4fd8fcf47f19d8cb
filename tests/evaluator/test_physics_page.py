"""What docs/physics.md and docs/physics/checks.md say is what the code and the shipped recordings say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gpusimbench.evaluator.runs.physics.facts import Check
from tests.scripts import drawn, script

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "physics.md"


@pytest.fixture(scope="module")
def making() -> Any:
    """docs/make_physics.py."""
    return script("make_physics")


def test_the_page_explains_every_check() -> None:
    """Name each check by its key in the table of checks."""
    page = PAGE.read_text(encoding="utf-8")
    assert [check.key for check in Check if f"`{check.key}`" not in page] == []


@pytest.mark.slow
def test_the_page_shows_what_the_recordings_say(making: Any) -> None:
    """Hold the table to the shipped recordings; make figures redraws it."""
    assert making.at_the_end(making.shipped()) == drawn(making.PAGE, "shipped"), "run make figures"
