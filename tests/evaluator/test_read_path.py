"""What reading touches: its own blocks, each checked, none copied without need."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import read_path
from gpusimbench import open_recording
from gpusimbench.evaluator.read import state_array
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, decode_state, state_header, state_header_in
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap import chunks
from gpusimbench.schemas.mcap.crc import second
from gpusimbench.schemas.source import MappedFile
from tests.encoded import encode_state
from tests.synthetic import grid, write_recording

N_ENV, STEPS = 192, 260
_BLOCK = 50 * 64 * 27 * 3 * 4


@pytest.fixture(scope="module")
def columns(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of three columns of environments, 16 MB."""
    return write_recording(
        tmp_path_factory.mktemp("columns"), grid(N_ENV, "float32"), steps=STEPS,
        path_of=lambda start, step: start + np.float32(step),
    )  # fmt: skip


@pytest.fixture
def touched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Bytes of each part that is read of a mapped file."""
    sizes: list[int] = []
    original = MappedFile.read

    def read(self: MappedFile, begin: int, end: int) -> memoryview:
        sizes.append(end - begin)
        return original(self, begin, end)

    monkeypatch.setattr(MappedFile, "read", read)
    return sizes


def test_only_the_blocks_that_are_asked_for(columns: Path, touched: list[int]) -> None:
    """Touch of one step one block a column, of one environment the blocks of its column, and for the shape none."""
    recording = open_recording(columns)
    touched.clear()
    states = recording.state("cubes", "position")
    assert states.shape == (STEPS + 1, N_ENV, 27, 3)
    assert sum(touched) < 10_000
    touched.clear()
    assert states.at_step(120)[5, 0, 0] > 119
    assert 3 * _BLOCK < sum(touched) < 3.01 * _BLOCK
    touched.clear()
    assert states[:, 100].shape == (STEPS + 1, 27, 3)
    of_column = (STEPS + 1) / 50 * _BLOCK
    assert of_column < sum(touched) < 1.01 * of_column


def test_in_place_where_one_block_suffices(columns: Path) -> None:
    """Give the file's own bytes, read-only, of a part of one block, and a copy of what lies in several."""
    states = open_recording(columns).state("cubes", "position")
    whole = np.asarray(states)
    for steps, envs in ((slice(51, 101), slice(64, 128)), (slice(60, 70), slice(5, 9)), (slice(0, 1), slice(0, 1))):
        found = states.read(steps, envs, copy=False)
        assert np.array_equal(found, whole[steps, envs])
        assert not found.flags.writeable
        assert not found.flags.owndata
        copied = states.read(steps, envs)
        assert copied.flags.writeable
        assert copied.flags.owndata
    assert states.read(slice(60, 110), slice(5, 9), copy=False).flags.owndata


def test_threads_change_nothing(columns: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read the same in threads as without, any number of them."""
    found = []
    for least, workers in ((1 << 60, 4), (0, 1), (0, 2), (0, 7)):
        monkeypatch.setattr(state_array, "_THREADED_BYTES", least)
        recording = open_recording(columns)
        recording._container.source.workers = workers
        found.append(np.asarray(recording.state("cubes", "position")))
    assert all(np.array_equal(found[0], other) for other in found[1:])


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_damage_is_found_in_threads(tmp_path: Path, compression: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a field one of whose blocks has a changed bit, whichever thread meets it, and read the others."""
    monkeypatch.setattr(state_array, "_THREADED_BYTES", 0)
    final = np.random.default_rng(0).standard_normal((130, 27, 3))
    path = write_recording(tmp_path, final, steps=70, compression=compression)
    data = bytearray(path.read_bytes())
    container = open_recording(path)._container
    hit = container.chunks[container.messages("/state/cubes/position/000000")[1].chunk]
    data[(hit.begin + hit.end) // 2] ^= 4
    changed = tmp_path / "changed.mcap"
    changed.write_bytes(data)
    states = open_recording(changed).state("cubes", "position")
    with pytest.raises(DamagedRecording, match="damaged|CRC"):
        np.asarray(states)
    with pytest.raises(DamagedRecording, match="damaged|CRC"):  # also when it is asked for again
        np.asarray(states)
    assert states[0].shape == (130, 27, 3)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_each_byte_has_one_crc_when_verified(tmp_path: Path, compression: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute no CRC of a chunk a second time while its content is digested, and refuse bytes changed in between."""
    final = np.random.default_rng(1).standard_normal((130, 27, 3))
    path = write_recording(tmp_path, final, steps=70, compression=compression)
    summed: list[int] = []
    monkeypatch.setattr(
        chunks, "zlib", SimpleNamespace(crc32=lambda data: summed.append(len(data)) or zlib.crc32(data))
    )
    open_recording(path).check_digests()
    recording = open_recording(path)
    container = recording._container
    assert 0 < sum(summed) <= 1.01 * sum(chunk.uncompressed_size for chunk in container.chunks)
    hit = container.chunks[container.messages("/state/cubes/position/000000")[1].chunk]
    verify = container.verify

    def verify_and_change(moved: Callable[[int], None]) -> None:
        verify(moved)
        with path.open("r+b") as stream:
            stream.seek((hit.begin + hit.end) // 2)
            byte = stream.read(1)[0]
            stream.seek(-1, 1)
            stream.write(bytes([byte ^ 4]))

    monkeypatch.setattr(container, "verify", verify_and_change)
    with pytest.raises(DamagedRecording, match=r"damaged|was changed since|state hash"):
        recording.check_digests()
    with pytest.raises(DamagedRecording, match="damaged|CRC"):  # as everywhere else
        np.asarray(open_recording(path).state("cubes", "position"))
    with pytest.raises(DamagedRecording, match="damaged|CRC"):
        np.asarray(recording.state("cubes", "position"))


def test_threads_share_their_memory(columns: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no more threads decode blocks at a time than there is memory for."""
    monkeypatch.setattr(state_array, "_THREADED_BYTES", 0)
    states = open_recording(columns).state("cubes", "position")
    states._container.source.workers = 8
    for memory, workers in ((_BLOCK, 1), (4 * _BLOCK - 1, 3), (100 * _BLOCK, 8)):
        monkeypatch.setattr(state_array, "_THREADS_MEMORY", memory)
        assert states._workers(list(states._parts(0, STEPS + 1, 0, N_ENV)), _BLOCK * 15) == workers


_arrays = st.builds(
    lambda shape, seed: np.random.default_rng(seed).standard_normal(shape, dtype=np.float32),
    st.tuples(*[st.integers(1, 4)] * 4), st.integers(0, 1000),
)  # fmt: skip


@given(_arrays, st.integers(0, 2**20), st.data())
def test_one_crc_serves_for_chunk_and_array(array: Any, first_step: int, data: st.DataObject) -> None:
    """Find any changed bit of a block by its CRC though the array is not read for it, and none in a whole one."""
    content = encode_state(array, first_step=first_step, stride=1, env_start=0, sim_time_ns=0)
    header, decoded = decode_state(content, crc=zlib.crc32(content))
    assert np.array_equal(decoded, array)
    assert header.first_step == first_step
    changed = bytearray(content)
    changed[len(content) - 1 - data.draw(st.integers(0, array.nbytes - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for known in (None, zlib.crc32(changed)):
        with pytest.raises(DamagedRecording, match="fails its CRC"):
            decode_state(bytes(changed), crc=known)


@given(st.binary(), st.binary())
def test_crc_of_the_second_part(first: bytes, other: bytes) -> None:
    """Give the CRC of the second of two parts from those of both and of the first."""
    assert second(zlib.crc32(first + other), zlib.crc32(first), len(other)) == zlib.crc32(other)


@given(_arrays, st.integers(0, 2**40), st.integers(0, 400))
def test_head_of_a_block(array: Any, first_step: int, size: int) -> None:
    """Know a block's small fields from its first bytes, or know that they do not suffice."""
    content = encode_state(array, first_step=first_step, stride=3, env_start=7, sim_time_ns=first_step)
    whole = state_header(content)
    found = state_header_in(memoryview(content)[:size], len(content))
    assert found in (None, whole)
    if array.nbytes > STATE_HEAD_BYTES:
        assert state_header_in(memoryview(content)[:STATE_HEAD_BYTES], len(content)) == whole
    trailing = content + b"\x20\x09"  # env_start once more, behind the array
    assert state_header_in(memoryview(trailing)[: len(content) // 2], len(trailing)) is None


@pytest.mark.parametrize("name", list(read_path.WORK))
def test_the_benchmark_runs(name: str, tmp_path: Path) -> None:
    """Run what the benchmark of the read path measures."""
    path = tmp_path / "small.mcap"
    read_path.write(path, n_env=70, steps=120)
    read_path.WORK[name](path)
