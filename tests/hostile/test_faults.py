"""Whichever call of a command fails, its earlier result or its new one is there, whole, and nothing beside."""

from __future__ import annotations

import json
import shutil
import sys

import pytest

from tests.conftest import finished

_EVERY = 1 << 30


@pytest.mark.skipif(not (shutil.which("gcc") or shutil.which("cc")), reason="no C compiler to build the shim with")
@pytest.mark.parametrize(
    "most, scenarios",
    [
        pytest.param(2, ("record", "pack", "view"), id="quick"),
        pytest.param(
            _EVERY, ("record", "pack", "unpack", "recover", "viewer", "view"), marks=pytest.mark.slow, id="every"
        ),
        pytest.param(2, ("eval-json", "eval-html", "eval-tables"), marks=pytest.mark.slow, id="results"),
        pytest.param(2, ("eval-figures", "card"), marks=pytest.mark.slow, id="several"),
    ],
)
def test_no_fault_spoils_a_result(most: int, scenarios: tuple[str, ...]) -> None:
    """Make the first and the last call of each kind fail, or every call; all: python -m tests.hostile.faults."""
    names = [word for name in scenarios for word in ("--scenario", name)]
    done = finished([sys.executable, "-m", "tests.hostile.faults", "--most", str(most), *names])
    tried = json.loads(done.stdout[done.stdout.index('{\n "tried"') :])["tried"]
    assert set(tried) == set(scenarios)
    assert all(count >= 10 for count in tried.values())
