"""Arrays of a recording, lazily: any index gives what numpy gives, from no more blocks than needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import Provenance
from tests.forging import copied
from tests.synthetic import grid, write_recording

_SHAPE = (101, 4, 27, 3)


def _axis(size: int) -> Any:
    return st.one_of(st.integers(-size, size - 1), st.slices(size))


class Opened(NamedTuple):
    """A recording and one of its arrays; short to print."""

    recording: Recording
    whole: Any

    def __repr__(self) -> str:
        return repr(self.recording)


@pytest.fixture(scope="module")
def opened(small: Path) -> Opened:
    """A recording, and its cubes' positions read in whole."""
    recording = open_recording(small)
    return Opened(recording, np.asarray(recording.state("cubes", "position")))


@given(data=st.data())
def test_indexing_equals_numpy(opened: Opened, data: st.DataObject) -> None:
    """Return what numpy returns for integers, slices and ellipses on any axis."""
    recording, whole = opened
    count = data.draw(st.integers(1, 4))
    index: tuple[Any, ...] = tuple(data.draw(_axis(size)) for size in _SHAPE[:count])
    if data.draw(st.booleans()):
        index = (Ellipsis, *index[: 4 - len(index)]) if count < 4 else (*index, Ellipsis)
        index = (Ellipsis,) if len(index) == 1 else index
        if index[0] is Ellipsis:
            index = (Ellipsis, *(data.draw(_axis(size)) for size in _SHAPE[4 - (len(index) - 1) :]))
    read, expected = recording.state("cubes", "position")[index], whole[index]
    assert read.shape == expected.shape
    assert read.tobytes() == expected.tobytes(), index


def test_out_of_bounds(opened: Opened) -> None:
    """Raise IndexError as numpy does."""
    array = opened[0].state("cubes", "position")
    for index in (101, -102, (0, 4), (0, 0, 27), (0, 0, 0, 0, 0)):
        with pytest.raises(IndexError):
            array[index]
    with pytest.raises(KeyError, match="step 101"):
        array.at_step(101)


def test_one_step_reads_one_block(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Decode a single block to read a single step."""
    read: list[Any] = []
    original = Container.read_with_crc
    monkeypatch.setattr(Container, "read_with_crc", lambda self, m: read.append(m) or original(self, m))
    array = open_recording(small).state("cubes", "position")
    read.clear()
    array.at_step(77)
    assert len(read) == 1


def test_unknown_fields_name_the_known_ones(small: Path) -> None:
    """List the recorded fields where another is asked for."""
    with pytest.raises(KeyError, match="cubes/position"):
        open_recording(small).state("robot", "qpos")


def test_a_missing_block_is_damage(tmp_path: Path) -> None:
    """Refuse to fill a gap with anything."""
    path = write_recording(tmp_path, grid(2), steps=200, stride=100)
    data = path.read_bytes()
    # an index that no longer names the last block: its entry becomes another channel's
    forged = data.replace(b"/state/cubes/position/000000", b"/state/cubes/position/000001")
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(forged)
    with pytest.raises(DamagedRecording):
        np.asarray(open_recording(broken).state("cubes", "position"))


def test_an_absurd_configuration_allocates_nothing(tmp_path: Path) -> None:
    """Refuse a recording that announces more environments than its bytes can hold."""
    forged = tmp_path / "forged.mcap"
    _with_provenance(tmp_path, forged, lambda text: text.replace(b'"n_env": 2,', b'"n_env": 16000000,'))
    recording = open_recording(forged)
    with pytest.raises(DamagedRecording, match="more"):
        verify(recording)


def _with_provenance(folder: Path, target: Path, change: Callable[[bytes], bytes]) -> None:
    """A recording whose provenance was changed, with every CRC right."""
    original = Provenance.to_json
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Provenance, "to_json", lambda self: change(original(self).encode()).decode())
        write_recording(folder, grid(2), steps=7, name="changed.mcap").rename(target)


def test_status_and_reason(tmp_path: Path) -> None:
    """Tell complete, failed, invalid and incomplete apart."""
    for status in ("COMPLETE", "FAILED", "INVALID"):
        recording = open_recording(write_recording(tmp_path, grid(1), status=status, reason="because"))
        assert (recording.status, recording.reason) == (status.lower(), "because")
        verify(recording)
    recording = open_recording(write_recording(tmp_path, grid(1), end=False))
    assert recording.status == "incomplete"
    assert recording.content_hash == ""


def test_a_changed_end_is_noticed(tmp_path: Path) -> None:
    """Refuse a file whose status was edited, even if every CRC was made right again."""
    path = write_recording(tmp_path, grid(1), status="INVALID", reason="contacts were dropped")
    forged = tmp_path / "forged.mcap"
    forged.write_bytes(path.read_bytes().replace(b"contacts were dropped", b"contacts were counted"))
    copy = copied(forged, tmp_path / "copy.mcap")  # the official writer makes the CRCs right
    with pytest.raises(DamagedRecording, match="end record was changed"):
        verify(open_recording(copy))


def test_a_changed_number_is_noticed(tmp_path: Path) -> None:
    """Refuse changed provenance, even if every CRC was made right again."""
    path = write_recording(tmp_path, grid(1))
    forged = tmp_path / "forged.mcap"
    forged.write_bytes(path.read_bytes().replace(b'"n_env": 1', b'"n_env": 2'))
    copy = copied(forged, tmp_path / "copy.mcap")
    with pytest.raises(DamagedRecording):
        verify(open_recording(copy))
