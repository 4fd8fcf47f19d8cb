"""The way of a recording's data to the disk while it is being written."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import RecordingWriter, open_recording, verify
from gpusimbench.recorder.capture import sink, state_work
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.fields import array_field


class Struck(BaseException):
    """What a handler of a signal raises."""


def record(path: Path, numbers: int = 75) -> None:
    """A recording of 3 MB, in blocks of 50 states of 19 KB; with more numbers, larger ones."""
    rng = np.random.default_rng(0)
    fields = (array_field("seen", "float32", (numbers,)),)
    with RecordingWriter(
        path, simulator="mine", version="1", scene="toss", n_env=64, dt=0.1, steps=149, fields=fields
    ) as log:
        for _ in range(3):
            log.append(rng.standard_normal((50, 64, numbers, 1), dtype=np.float32))


@pytest.mark.parametrize("fails", [False, True])
def test_data_begin_their_way_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    """Ask the system to write whole pages, one behind the other; where it refuses, the last flush writes them."""
    asked, advise = [], os.posix_fadvise

    def noted(descriptor: int, begin: int, size: int, advice: int) -> None:
        asked.append((begin, begin + size, os.fstat(descriptor).st_size))
        advise(-1 if fails else descriptor, begin, size, advice)  # OSError of a file that is not open

    monkeypatch.setattr(sink, "_WRITEBACK_BYTES", 512 << 10)
    monkeypatch.setattr(os, "posix_fadvise", noted)
    record(tmp_path / "a.mcap")
    assert asked[0][0] == 0
    assert [begin for begin, _, _ in asked[1:]] == [end for _, end, _ in asked[:-1]]
    assert all(end - begin >= 512 << 10 and end % 4096 == 0 and end <= size for begin, end, size in asked)
    verify(open_recording(tmp_path / "a.mcap"))


def test_small_recordings_need_no_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask for nothing where the last flush is short anyway."""
    asked: list[int] = []
    monkeypatch.setattr(os, "posix_fadvise", lambda *_: asked.append(1))
    record(tmp_path / "a.mcap")
    assert not asked


def test_no_thread_is_left(tmp_path: Path) -> None:
    """End the threads of a recording with the recording."""
    before = set(threading.enumerate())
    record(tmp_path / "a.mcap", numbers=300)  # so that threads share the work
    assert set(threading.enumerate()) <= before


def test_what_is_no_error_gives_no_good_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the file without an end where something else than an error, such as what a handler of SIGALRM raises,
    strikes between digests and bytes: they would not be of the same states."""
    blocks, made = state_work.state_parts, []

    def struck(*arguments: Any, **named: Any) -> Any:
        made.append(1)
        if len(made) == 3:
            raise Struck
        return blocks(*arguments, **named)

    monkeypatch.setattr(state_work, "state_parts", struck)
    with pytest.raises(DataLost, match=r"writing stopped: Struck; what was written is in .*partial"):
        record(tmp_path / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.partial"]
    assert open_recording(tmp_path / "a.mcap.partial").status == "incomplete"
