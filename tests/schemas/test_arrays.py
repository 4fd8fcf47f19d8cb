"""Archives of arrays: what is read back, and what is refused."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.initial import Given, Initial, initial_words, parse_initial

_KINDS = st.one_of(hnp.floating_dtypes(endianness="<"), hnp.integer_dtypes(endianness="<"), hnp.boolean_dtypes())
_ARRAYS = hnp.arrays(_KINDS, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))


@given(st.dictionaries(st.text("abc/_0", min_size=1), _ARRAYS, max_size=4))
def test_round_trip(given: dict[str, np.ndarray]) -> None:
    """Read back every bit, type and shape; the same arrays are the same bytes, which NumPy reads as well."""
    data = arrays.encode(given)
    assert arrays.encode(given) == data
    with np.load(io.BytesIO(data)) as theirs:
        for found in (arrays.decode("x", data), dict(theirs)):
            assert found.keys() == given.keys()
            for name, array in given.items():
                assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
                assert found[name].tobytes() == array.tobytes()


def test_compressed_by_others(tmp_path: Path) -> None:
    """Read what NumPy writes, compressed and by columns as well."""
    array = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    np.savez_compressed(tmp_path / "a.npz", **{"cubes/position": array})
    found = arrays.decode("a", (tmp_path / "a.npz").read_bytes())
    assert np.array_equal(found["cubes/position"], array)


@given(cut=st.integers(0, 400), flip=st.integers(0, 400), bit=st.integers(0, 7))
def test_damaged(cut: int, flip: int, bit: int) -> None:
    """Refuse bytes that were cut or changed, or read arrays from them, and raise nothing else."""
    whole = bytearray(arrays.encode({"a": np.arange(5.0), "b/c": np.array([1, 2], dtype=np.int32)}))
    whole[flip % len(whole)] ^= 1 << bit
    for data in (bytes(whole), bytes(whole[: cut % len(whole)])):
        try:
            found = arrays.decode("x", data)
        except DamagedRecording as error:
            assert str(error).startswith("x ")
        else:
            assert all(isinstance(array, np.ndarray) for array in found.values())


def _archive(name: str, content: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return stream.getvalue()


def _npy(header: str) -> bytes:
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def test_a_shape_that_is_a_lie() -> None:
    """Give no memory to a shape that the bytes do not have."""
    head = _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}")
    with pytest.raises(DamagedRecording, match="no archive of arrays"):
        arrays.decode("x", _archive("a.npy", head + bytes(80)))


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_size_that_is_a_lie(method: int) -> None:
    """Read no more of an array than the archive's directory says, whatever lies there."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        archive.writestr("a.npy", _npy("{'descr': '|u1', 'fortran_order': False, 'shape': (5000,)}") + bytes(5000))
    data = bytearray(stream.getvalue())
    directory = data.rindex(b"PK\x01\x02")
    data[directory + 24 : directory + 28] = (4000).to_bytes(4, "little")
    with pytest.raises(DamagedRecording, match="no archive of arrays"):
        arrays.decode("x", bytes(data))


def test_a_pickle_is_never_read() -> None:
    """Execute nothing."""
    stream = io.BytesIO()
    np.savez(stream, a=np.array([print], dtype=object))
    with pytest.raises(DamagedRecording, match="of type object"):
        arrays.decode("x", stream.getvalue())
    with pytest.raises(ValueError, match="Object arrays"):
        arrays.encode({"a": np.array([print], dtype=object)})


def test_more_than_is_read() -> None:
    """Refuse an archive that would grow beyond its bound."""
    data = _archive("a.npy", _npy("{'descr': '|u1', 'fortran_order': False, 'shape': (100000,)}") + bytes(100_000))
    assert len(data) < 1000
    with pytest.raises(DamagedRecording, match="more than the 5000 that are read"):
        arrays.decode("x", data, most=5000)


@given(st.binary(min_size=32, max_size=32), st.none() | st.integers(0, 10**12 - 1))
def test_given_initial_states(digest: bytes, step: int | None) -> None:
    """Read back how a run began, as it is written; in words it is short."""
    made = Given(digest.hex(), step)
    assert parse_initial(str(made)) == made
    assert initial_words(str(made)) == str(made)[:-52]
    assert isinstance(parse_initial("random:0.5"), Initial)


@pytest.mark.parametrize("text", ["states:", "states:" + "0" * 63, "snapshot:-1:" + "0" * 64, "snapshot:" + "0" * 64])
def test_no_given_initial_states(text: str) -> None:
    """Refuse what is none."""
    with pytest.raises(ValueError):
        parse_initial(text)
