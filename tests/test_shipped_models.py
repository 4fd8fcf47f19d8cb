"""The recordings of model files that ship, and what the documents beside them say."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from tests.scripts import script

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"
SMALL = {"ant": 2.2e6, "humanoid": 1.5e6}
"""Folders, and what their recordings may take together [bytes]."""


@pytest.fixture(scope="module")
def models() -> ModuleType:
    """docs/make_models.py."""
    return script("make_models")


@pytest.mark.parametrize("folder", SMALL)
def test_the_table_is_that_of_the_files(models: ModuleType, folder: str) -> None:
    """Hold the table to the recordings; make figures redraws it."""
    assert list(models.TIMES) == list(SMALL)
    assert models.page(folder).read_text(encoding="utf-8") == models.drawn(folder)


@pytest.mark.parametrize("folder", SMALL)
def test_the_recordings_are_whole_and_small(models: ModuleType, folder: str) -> None:
    """Verify each, of the recorder as it is in the history; the model's licence lies beside them."""
    runs = models.runs(folder)
    for run in runs:
        verify(run)
        assert run.status == "complete"
        assert not run.provenance.software["recorder"]["modified"]
        given = [word for word in run.provenance.argv if word.startswith("/")]
        assert not given or (folder, run.simulation.device) == ("ant", "NVIDIA H100 80GB HBM3")
    assert sum(run.path.stat().st_size for run in runs) < SMALL[folder]
    assert "Copyright" in (RECORDINGS / folder / "LICENSE").read_text(encoding="utf-8")


def test_what_the_humanoid_shows(models: ModuleType) -> None:
    """The MuJoCo family stays within 9 um through the landing; in PhysX the knees give way."""
    reference, *others = models.runs("humanoid")
    for run in others:
        largest, bodies = models.off(run, reference)
        assert bodies
        family = run.configuration.simulator in ("warp", "newton", "mjx")
        assert (largest[-1] < 9e-6) == family, run.path.name
    heights = {run.configuration.simulator: _height(run) for run in (reference, *others)}
    step = 13  # 0.39 s
    assert heights["mujoco"][step] == pytest.approx(1.14, abs=0.005)
    assert heights["physx"][step] == pytest.approx(0.85, abs=0.005)


def _height(run: Recording) -> np.ndarray:
    # of the torso of environment 0, at each recorded step [m]
    return np.asarray(run.state("bodies", "position")[:])[:, 0, 0, 2]
