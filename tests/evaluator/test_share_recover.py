"""Recovering: whatever is whole in a file that was cut anywhere, and nothing that was not there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from psutil import Process

from gpusimbench import open_recording
from gpusimbench.evaluator.share.copies import recover
from gpusimbench.schemas.errors import DamagedRecording, FailedCrc, RecordingError, UsageError
from gpusimbench.schemas.mcap.records import MAGIC
from tests.conftest import call, wait_for
from tests.evaluator.test_share_pack import contents, share
from tests.synthetic import grid, write_recording

STEPS = 120


@pytest.fixture(scope="module", params=["none", pytest.param("zstd", marks=pytest.mark.slow)])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 130 environments, three columns of blocks, all positions telling their step."""
    return write_recording(
        tmp_path_factory.mktemp("whole"), grid(130), steps=STEPS, dt=0.01, name="a.mcap", compression=request.param,
        path_of=lambda start, step: start + step,
    )  # fmt: skip


@settings(max_examples=40)
@given(fraction=st.floats(0, 1))
@example(fraction=1.0)
@example(fraction=0.9999)
def test_cut_anywhere(whole: Path, tmp_path_factory: pytest.TempPathFactory, fraction: float) -> None:
    """Give the beginning of what was there in order, as a file that other readers open, and account for every byte."""
    folder = tmp_path_factory.mktemp("cut")
    data = whole.read_bytes()[: round(fraction * whole.stat().st_size)]
    (folder / "a.mcap.partial").write_bytes(data)
    if len(data) == whole.stat().st_size:
        with pytest.raises(UsageError, match="nothing to recover"):
            recover(folder / "a.mcap.partial", folder / "out.mcap")
        return
    try:
        done = recover(folder / "a.mcap.partial", folder / "out.mcap")
    except RecordingError as error:
        assert len(data) < 10_000  # cut before its provenance
        assert "a.mcap.partial" in str(error)
        assert not (folder / "out.mcap").exists()
        return
    assert not done.damage
    assert 0 <= done.lost_bytes <= len(data)
    messages, attachments, metadata = contents(done.path)
    all_messages, all_attachments, all_metadata = contents(whole)
    assert messages == all_messages[: len(messages)]
    assert attachments == all_attachments[: len(attachments)]
    assert metadata == all_metadata[: len(metadata)]
    assert sum(s.messages for s in done.streams) == len(messages)
    assert done.status == ("complete" if len(messages) == len(all_messages) else "incomplete")
    _check_states(done, folder)


def _check_states(done: Any, folder: Path) -> None:
    recording = open_recording(done.path)
    assert recording.status == done.status
    if not recording.fields:
        return
    states = recording.state("cubes", "position")
    found = np.asarray(states)
    expected = {s.name: s.last_step for s in done.streams}.get("state cubes/position")
    assert (int(states.steps[-1]) if len(states) else None) == expected
    moved = found - found[:1] if len(found) else found
    rows = min(len(found), STEPS)
    assert np.allclose(moved[1:rows], np.arange(1, rows)[:, None, None, None])


def test_every_last_bytes(whole: Path, tmp_path: Path) -> None:
    """Find the end record wherever behind it the file was cut, and check the content against it."""
    data = whole.read_bytes()
    cut = tmp_path / "a.mcap.partial"
    cut.write_bytes(data[: len(data) - len(MAGIC)])
    assert open_recording(cut).status == "incomplete"
    done = recover(cut, tmp_path / "out.mcap")
    assert (done.status, done.reason) == ("complete", "")
    assert open_recording(done.path).content_hash == open_recording(whole).content_hash


def test_a_finished_file_without_an_end_is_incomplete(whole: Path, tmp_path: Path) -> None:
    """Stay incomplete for our tools though the container is whole, and be left alone the second time."""
    cut = tmp_path / "a.mcap.partial"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    done = recover(cut, tmp_path / "a.mcap")
    assert open_recording(done.path).status == "incomplete"
    with pytest.raises(UsageError, match="whole file"):
        recover(done.path, tmp_path / "again.mcap")
    assert call("gsb-eval", done.path).returncode == 3
    packed = share("pack", done.path, "--out", tmp_path / "packed", code=3)
    assert "has no end record" in packed.stderr


def test_zeros_at_the_end_are_no_records(whole: Path, tmp_path: Path) -> None:
    """Leave out what a file system that lost power fills a file up with, be it in the middle of a chunk."""
    half = whole.read_bytes()[: whole.stat().st_size // 2]
    for name, data in (("plain", half), ("filled", half + bytes(5000)), ("full", half + bytes(len(half)))):
        (tmp_path / name).write_bytes(data)
    plain = recover(tmp_path / "plain", tmp_path / "plain.mcap")
    for name in ("filled", "full"):
        other = recover(tmp_path / name, tmp_path / f"{name}.mcap")
        assert contents(other.path) == contents(plain.path)
        assert other.streams == plain.streams
        assert other.lost_bytes > plain.lost_bytes


@pytest.mark.parametrize("cut", [False, True])
def test_damage_ends_what_is_recovered(whole: Path, tmp_path: Path, cut: bool) -> None:
    """Stop at a chunk that was changed, say so, and end with another code: later records were there, and are lost."""
    data = bytearray(whole.read_bytes()[: -1000 if cut else None])
    data[len(data) // 2] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    done = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert done.damage
    assert done.status == "incomplete"
    assert done.lost_bytes > len(data) // 3
    messages, all_messages = contents(done.path)[0], contents(whole)[0]
    assert messages == all_messages[: len(messages)]
    command = share("recover", tmp_path / "bad.mcap", code=3)
    assert "behind damage" in command.stdout
    assert " ".join(FailedCrc.advice.split()) in " ".join(command.stdout.split())
    assert contents(tmp_path / "bad.recovered.mcap") == contents(done.path)


def test_no_name_is_taken(whole: Path, tmp_path: Path) -> None:
    """Overwrite nothing, and leave no file behind where nothing can be recovered."""
    cut = tmp_path / "a.mcap.partial"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        recover(cut, tmp_path / "mine")
    assert (tmp_path / "mine").read_text() == "mine"
    cut.write_bytes(whole.read_bytes()[:60])
    with pytest.raises(DamagedRecording, match="nothing can be said"):
        recover(cut, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_a_killed_run(tmp_path: Path) -> None:
    """Recover what SIGKILL leaves of a real run, with every block that it had written."""
    process = subprocess.Popen(
        [sys.executable, "-m", "gpusimbench.recorder.cli",
         "--sim", "mujoco", "--n-env", "8", "--steps", "100000", "--runs", "1",
         "--phases", "capture", "--out", str(tmp_path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_for(lambda: any(p.stat().st_size > 3_000_000 for p in tmp_path.glob("*.partial")))
        for child in Process(process.pid).children(recursive=True):
            child.kill()
        process.wait(300)  # for the end of its run, which may be within a write still
    finally:
        process.kill()
        process.wait()
    (partial,) = tmp_path.glob("*.partial")
    done = share("recover", partial, code=0)
    assert "incomplete: no end record" in done.stdout
    (path,) = tmp_path.glob("*.recovered.mcap")
    states, before = open_recording(path).state("cubes", "position"), open_recording(partial).state("cubes", "position")
    assert len(states) > 100
    assert np.array_equal(np.asarray(states), np.asarray(before))
    assert f"state cubes/position  whole up to step {states.steps[-1]}" in done.stdout
