"""Files that are evaluated together: each run counts once, and what cannot be read is kept apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gpusimbench.evaluator.inputs.reader import Unreadable, read_run, without_copies
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import DamagedRecording

RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"


@pytest.fixture(scope="module")
def run() -> Run:
    """A shipped run."""
    return read_run(Recording(RECORDINGS / "mujoco-amd-r0.mcap"), 5.0)


def test_the_whole_file_stays(run: Run) -> None:
    """Of a run that is there whole and cut short, keep the whole file, whichever is given first."""
    short = replace(run, path=Path("short.mcap"), status="incomplete", content_hash="")
    for files in ((short, run), (run, short)):
        found = without_copies(files)
        assert found.runs == (run,)
        assert found.unreadable == ()
        assert found.notes == ("short.mcap is a copy of mujoco-amd-r0.mcap; it counts once",)


def test_another_content_is_no_copy(run: Run) -> None:
    """Refuse a second content under the id of a run, and keep it beside the files that could not be read."""
    damaged = Unreadable(Path("damaged.mcap"), DamagedRecording("no recording"))
    changed = replace(run, path=Path("changed.mcap"), content_hash="0" * 64)
    found = without_copies([damaged, run, changed])
    assert found.runs == (run,)
    assert [file.path for file in found.unreadable] == [Path("damaged.mcap"), Path("changed.mcap")]
    assert "the run id of mujoco-amd-r0.mcap and another content" in str(found.unreadable[1].error)
    assert found.notes == ()
