"""The page on friction in Madrona: its tables are those of the script and of the recordings that ship."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from tests.conftest import run_python

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """docs/make_friction.py."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module("make_friction")
    finally:
        sys.path.remove(str(ROOT / "docs"))


def test_the_page_is_as_the_script_draws_it(script: ModuleType) -> None:
    """Hold both tables to the formulas and to the recordings; make figures redraws them."""
    page = script.PAGE.read_text(encoding="utf-8")
    tables = {
        "rules": script.markdown(script.rules_table()),
        "measured": script.markdown(script.measured_table(script.shipped())),
    }
    assert script.with_tables(page, tables) == page


def test_the_recordings_are_whole_and_small(script: ModuleType) -> None:
    """Verify each, name the engine that was changed, and keep them together below 1 MB."""
    files = script.shipped()
    names = [script.measured(path)[0].partition(",")[0] for path in files]
    assert names == ["madrona MODIFIED", "madrona", "sapien"]
    for path in files:
        recording = open_recording(path)
        verify(recording)
        assert recording.status == "complete"
        assert not recording.provenance.software["recorder"]["modified"]
    assert sum(path.stat().st_size for path in files) < 1e6


def test_what_the_page_concludes(script: ModuleType) -> None:
    """Coulomb brakes all masses alike; the recorded Madrona by the square of the mass, the changed one alike."""
    coulomb = script.FRICTION * script.GRAVITY
    found = dict(map(script.measured, script.shipped()))
    changed, madrona, sapien = found.values()
    assert sapien == pytest.approx(coulomb, rel=0.01)
    assert changed == pytest.approx(1.14 * coulomb, rel=0.01)
    formula = np.array([script.by_rule(list(script.RULES.values())[2], mass) for mass in script.MASSES])
    assert (madrona[:3] < 0.02).all()
    ratios = madrona[3:] / formula[3:]
    assert ratios == pytest.approx([1.35, 1.30, 1.14, 0.89], abs=0.06)


def test_a_corner_of_a_cube_is_four_times_as_easy_to_move(script: ModuleType) -> None:
    """The generalised inverse mass from the inertia of a solid cube, by its definition."""
    mass, edge = 0.7, 0.3
    inverse_inertia = np.eye(3) * 6 / (mass * edge**2)
    for corner in ((1, 1, -1), (-1, 1, -1), (1, -1, -1), (-1, -1, -1)):
        arm = np.cross(np.array(corner) * edge / 2, (1.0, 0.0, 0.0))
        assert 1 / mass + arm @ inverse_inertia @ arm == pytest.approx(script._CORNER / mass)


def test_a_recording_of_another_scene_is_refused() -> None:
    """Say which file it is."""
    path = "recordings/mujoco-amd-r0.mcap"
    done = run_python(f"import runpy, sys; sys.argv[1:] = [{path!r}]; runpy.run_path('docs/make_friction.py', "
                      "run_name='__main__')", cwd=ROOT, code=1)  # fmt: skip
    assert f"{path} is no recording of sliding-blocks" in done.stderr
