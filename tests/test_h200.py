"""The recordings that ship under recordings/h200, and what the documents say of them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from evaluator import open_recording
from evaluator.recording import Recording
from tests.conftest import call

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted((ROOT / "recordings" / "h200").glob("*.mcap"))


@pytest.fixture(scope="module")
def tables() -> Any:
    """docs/make_h200.py."""
    spec = importlib.util.spec_from_file_location("make_h200", ROOT / "docs" / "make_h200.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def evaluation(tables: Any) -> Any:
    """Of the whole set."""
    return tables.shipped()


def test_documents_show_what_the_files_say(tables: Any, evaluation: Any) -> None:
    """Hold the tables of both pages to the recordings; make figures redraws them."""
    for path, page in tables.pages(evaluation).items():
        assert path.read_text(encoding="utf-8") == page, f"{path.name}: run make figures"


def test_every_file_is_whole() -> None:
    """Verify every byte of every recording of the set."""
    assert len(FILES) == 207
    for path in FILES:
        recording = open_recording(path)
        recording.verify()
        assert recording.simulation is None or recording.simulation.device == "NVIDIA H200"


def test_the_set_is_small() -> None:
    """Stay below what a clone can be asked to carry."""
    everything = sum(path.stat().st_size for path in (ROOT / "recordings").rglob("*.mcap"))
    assert everything < 60e6


def test_states_of_mjx_agree_where_fingerprints_do() -> None:
    """Find the environments of MJX (jax) equal in their states too, not by their hashes alone."""
    found = [Recording(p) for p in FILES if p.name.startswith("mjx-jax-inclined")]
    assert found
    for recording in found:
        positions = recording.state("cubes", "position")[-1]
        assert (positions == positions[:1]).all()


@pytest.mark.parametrize("name", ["mjx-jax-run-to-run", "newton-xpbd-run-to-run"])
def test_replays_on_another_machine_are_bit_identical(name: str) -> None:
    """Hold the shipped replays against their originals, and see that another machine made them."""
    original = ROOT / "recordings" / "h200" / f"{name}-inclined-collision-n16-r0.mcap"
    replay = ROOT / "recordings" / "replays" / f"{name}-inclined-collision-n16-replayed.mcap"
    done = call("gsb-diff", original, replay)
    assert done.returncode == 0, done.stdout
    assert "BIT-IDENTICAL" in done.stdout
    there, here = (open_recording(path).provenance for path in (original, replay))
    assert there.host["threads"] != here.host["threads"]
    assert there.run_id != here.run_id
