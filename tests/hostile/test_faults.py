"""Whichever call of a command fails, its earlier result or its new one is there, whole, and nothing beside."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest


@pytest.mark.skipif(not (shutil.which("gcc") or shutil.which("cc")), reason="no C compiler to build the shim with")
@pytest.mark.parametrize("scenarios", [("record", "pack", "eval-json"), ("eval-html", "card"), ("recover", "viewer")])
def test_no_fault_spoils_a_result(scenarios: tuple[str, ...]) -> None:
    """Make the first and the last call of each kind fail; all of them: python -m tests.hostile.faults."""
    names = [word for name in scenarios for word in ("--scenario", name)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile.faults", "--most", "2", *names], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    tried = json.loads(done.stdout[done.stdout.index('{\n "tried"') :])["tried"]
    assert set(tried) == set(scenarios)
    assert all(count >= 10 for count in tried.values())
