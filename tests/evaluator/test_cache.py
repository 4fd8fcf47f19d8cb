"""Results that are kept: the same as computed ones, never those of another file, gone without harm."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.compute import cache as store_module
from gpusimbench.evaluator.compute.cache import (
    Store,
    classes_of,
    code_version,
    decode,
    default_folder,
    encode,
    sources,
)
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs import reader
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable, read_all
from gpusimbench.evaluator.read import addresses
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.json import dump_json
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.runs.run import Run
from tests.conftest import Command
from tests.limits import next_to_no_memory


@dataclass(frozen=True)
class Point:
    """A class that a codec may store."""

    x: float
    names: tuple[str, ...]


class Forbidden:
    """A class that it may not."""


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let files that were just written count as such that are left alone."""
    monkeypatch.setattr(addresses, "_SETTLED_NS", 0)


@pytest.fixture
def unread(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Make opening any recording an error from the call on."""

    def refuse(*_: Any) -> None:
        raise AssertionError("a file was opened")

    return lambda: monkeypatch.setattr(Recording, "__init__", refuse)


def read_one(path: Path, cache: Path, *, sample_time: float = 1.0, verify: bool = True) -> Run | Unreadable:
    """A file as a command reads it."""
    (found,) = read_all([path], Reader(sample_time, verify=verify), Work(store=Store(cache)))
    return found


def double(x: float) -> float:
    """A function with results to keep."""
    CALLS.append(x)
    return 2 * x


CALLS: list[float] = []

_plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
_values = st.recursive(
    _plain | st.builds(Point, st.floats(allow_nan=False), st.lists(st.text()).map(tuple)),
    lambda inner: (
        st.lists(inner) | st.lists(inner).map(tuple) | st.dictionaries(st.text() | st.integers(), inner)
    ),
    max_leaves=10,
)  # fmt: skip


@given(_values)
def test_values_come_back(value: Any) -> None:
    """Give back plain values, lists, tuples, mappings and dataclasses, each as what it was."""
    found = decode(encode(value), Point)
    assert found == value
    assert repr(found) == repr(value)


def test_arrays_come_back_by_bits() -> None:
    """Keep dtype, shape and NaN payloads of arrays, wherever they stand."""
    bits = np.array([0x7FC00001, 0xFFC00000, 0x80000000], dtype=np.uint32).view(np.float32)
    found = decode(encode({"a": [bits, np.zeros((0, 2), dtype=np.int64)]}), dict)
    assert found["a"][0].dtype == np.float32
    assert found["a"][0].tobytes() == bits.tobytes()
    assert found["a"][1].shape == (0, 2)


@pytest.mark.parametrize("value", [Forbidden(), np.array([Forbidden()]), {1, 2}, 1j])
def test_other_things_are_refused(value: Any) -> None:
    """Refuse to write what could not be read back without running code."""
    with pytest.raises(TypeError, match="cannot be stored"):
        encode([value])


def test_the_classes_follow_from_the_hints() -> None:
    """Find what the entries of a run are made of, as deep as they go, and nothing else."""
    found = {name.rpartition(".")[2] for name in classes_of(Run)}
    assert {"Run", "Missing", "Positions", "Histories", "Branch", "Measured", "Check", "Provenance", "Sign"} <= found
    assert set(classes_of(dict[str, tuple[Point, ...] | None]).values()) == {Point}
    assert not classes_of(list[float])


def test_a_document_of_an_older_class_is_refused() -> None:
    """Take a document whose class had other fields for none, not for a value with some of them missing."""
    stream = io.BytesIO()
    tree = json.dumps({"class": f"{Point.__module__}.Point", "of": {"x": 1.0}})
    np.savez(stream, tree=np.frombuffer(tree.encode(), dtype=np.uint8))
    with pytest.raises(ValueError, match=r"not a stored result.*names"):
        decode(stream.getvalue(), Point)


def test_what_is_no_document_is_refused() -> None:
    """Read no pickles, no classes that were not named, and no torn files."""
    document = encode(Point(1.0, ("a",)))
    stream = io.BytesIO()
    np.savez(stream, tree=np.array([Forbidden()], dtype=object))
    for forged in (b"", document[:-30], pickle.dumps(1), stream.getvalue()):
        with pytest.raises(ValueError, match="not a stored result"):
            decode(forged, Point)
    with pytest.raises(ValueError, match="not a stored result"):
        decode(document, float)


def test_a_result_is_computed_once(tmp_path: Path) -> None:
    """Compute each item once, equal ones too, and keep the order; a lost file is computed again."""
    CALLS.clear()
    store = Store(tmp_path / "deep" / "cache")
    work = Work(store=store)
    assert work.map(double, [1.0, 2.0, 1.0]) == [2.0, 4.0, 2.0]
    assert work.map(double, [2.0, 3.0]) == [4.0, 6.0]
    assert CALLS == [1.0, 2.0, 3.0]
    for number, path in enumerate(sorted(tmp_path.rglob("*.result"))):
        content = bytearray(path.read_bytes())
        content[40 + 30 * number] ^= 1
        path.write_bytes(content)
    assert work.map(double, [1.0, 2.0, 3.0]) == [2.0, 4.0, 6.0]
    assert CALLS[3:] == [1.0, 2.0, 3.0]


def test_moved_entries_are_none(tmp_path: Path) -> None:
    """Compute again what an entry of another name would answer."""
    CALLS.clear()
    work = Work(store=Store(tmp_path))
    assert work.map(double, [1.0, 2.0]) == [2.0, 4.0]
    one, other = tmp_path.rglob("*.result")
    contents = one.read_bytes(), other.read_bytes()
    other.write_bytes(contents[0])
    one.write_bytes(contents[1])
    assert work.map(double, [1.0, 2.0]) == [2.0, 4.0]
    assert CALLS == [1.0, 2.0, 1.0, 2.0]


def _npy(shape: tuple[int, ...], data: bytes) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue() + data


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize(("shape", "size"), [((1 << 24,), 1 << 27), ((1 << 40,), 8), ((-1,), 8), ((1 << 62, 4), 8)])
def test_bombs_are_refused_before_they_are_unpacked(shape: tuple[int, ...], size: int, compression: int) -> None:
    """Take no more memory than an entry has bytes, whatever it announces."""
    if compression == zipfile.ZIP_STORED and size > 8:
        return  # it is what it says
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        archive.writestr("0.npy", _npy(shape, bytes(size)))
        archive.writestr("tree.npy", _npy((1,), b'{"a":1}'.ljust(8)))
    with next_to_no_memory(), pytest.raises(ValueError, match="not a stored result"):
        decode(stream.getvalue(), dict)


def test_entries_have_a_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither keep nor read what is larger than an entry may be; nor wait for a pipe in the place of one."""
    store = Store(tmp_path)
    store.put("a" * 64, "x" * 100)
    monkeypatch.setattr(store_module, "_MOST", 100)
    store.put("b" * 64, "x" * 100)
    assert [store.get("a" * 64, str), store.get("b" * 64, str)] == [None, None]
    (path,) = tmp_path.rglob("*.result")
    path.unlink()
    os.mkfifo(path)
    assert store.get("a" * 64, str) is None


@pytest.mark.usefixtures("settled")
def test_a_result_of_another_kind_is_none(tmp_path: Path, small: Path) -> None:
    """Read a file whose entry holds something else, as a version of tomorrow might."""
    store = Store(tmp_path)
    known = reader.KnownFiles(store, Reader(1.0))
    seen = addresses.stamp_of(small)
    assert seen
    store.put(store.key(addresses.Stamp, seen), "hash")
    store.put(known._key("hash", seen), [1, 2])
    assert known.find(small) is None


def test_other_code_finds_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Key results by the version of the code that computed them."""
    store = Store(tmp_path)
    store.put(store.key(double, 1.0), 2.0)
    assert store.get(store.key(double, 1.0), float) == 2.0
    monkeypatch.setattr(store_module, "code_version", lambda: "another")
    assert store.get(store.key(double, 1.0), float) is None


def test_a_line_of_the_code_is_another_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Digest the files that results follow from: those of the package, and each with what stands in it."""
    assert {"evaluator/compute/cache.py", "evaluator/metrics/memory.py", "schemas/topics.py"} <= dict(sources()).keys()
    beside = tmp_path / "evaluator" / "compute" / "cache.py"
    beside.parent.mkdir(parents=True)
    monkeypatch.setattr(store_module, "__file__", str(beside))
    versions = set()
    for text in ("value = 1\n", "value = 2\n"):
        beside.write_text(text)
        versions.add(code_version.__wrapped__())
    assert len(versions) == 2


def test_what_was_used_longest_ago_goes_first(tmp_path: Path) -> None:
    """Hold the store below its limit by deleting what nobody asked for."""
    store = Store(tmp_path)
    for index in range(4):
        store.put(f"{index:064d}", "x" * 1000)
        os.utime(next(p for p in tmp_path.rglob("*.result") if f"{index:062d}" in p.name), ns=(index, index))
    size = sum(p.stat().st_size for p in tmp_path.rglob("*.result"))
    assert store.get(f"{0:064d}", str)  # used now
    store.prune(size // 2)
    assert [bool(store.get(f"{index:064d}", str)) for index in range(4)] == [True, False, False, True]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    """Compute all the same where nothing can be kept."""
    (tmp_path / "file").write_text("in the way")
    assert Work(store=Store(tmp_path / "file" / "cache")).map(double, [4.0]) == [8.0]


@pytest.mark.usefixtures("settled")
def test_a_known_file_is_not_opened(
    tmp_path: Path, small_set: list[Path], unread: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Evaluate a set a second time without opening a file, with the same document to the last digit."""
    work = Work(store=Store(tmp_path))
    before = dump_json(evaluate(read_all(small_set, Reader(1.0), work), sample_time=1.0))
    unread()
    monkeypatch.delattr(Store, "put")  # all that is asked for was kept, and is found
    assert dump_json(evaluate(read_all(small_set, Reader(1.0), work), sample_time=1.0)) == before
    with pytest.raises(AssertionError, match="a file was opened"):
        read_one(small_set[0], tmp_path, sample_time=0.5)


@pytest.mark.usefixtures("settled")
def test_a_changed_file_is_read_again(tmp_path: Path, small: Path) -> None:
    """Find damage in a known file also where its size and its modification time are as before."""
    path = Path(shutil.copy(small, tmp_path / "run.mcap"))
    assert isinstance(read_one(path, tmp_path / "cache"), Run)
    status = path.stat()
    with path.open("r+b") as file:
        file.seek(status.st_size // 2)
        byte = file.read(1)[0]
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 1]))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert isinstance(read_one(path, tmp_path / "cache"), Unreadable)


def test_a_file_just_written_is_not_relied_on(tmp_path: Path, small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep nothing of a file that may change once more within the resolution of the clock."""
    monkeypatch.setattr(addresses, "_SETTLED_NS", 3600 * 10**9)  # however long this machine takes to come to it
    path = Path(shutil.copy(small, tmp_path / "run.mcap"))
    read_one(path, tmp_path / "cache")
    assert not list((tmp_path / "cache").rglob("*.result"))


@pytest.mark.usefixtures("settled")
def test_nothing_is_kept_of_what_was_not_verified(tmp_path: Path, small: Path) -> None:
    """Take no file's word for its content hash."""
    read_one(small, tmp_path, verify=False)
    assert not list(tmp_path.rglob("*.result"))


@pytest.mark.usefixtures("settled")
def test_a_renamed_file_has_its_new_name(tmp_path: Path, small: Path, unread: Callable[[], None]) -> None:
    """Report a known recording under the name that it has now."""
    cache = tmp_path / "cache"
    first = Path(shutil.copy(small, tmp_path / "first.mcap"))
    os.link(first, tmp_path / "second.mcap")
    assert isinstance(read_one(first, cache), Run)
    unread()
    found = read_one(tmp_path / "second.mcap", cache)
    assert isinstance(found, Run)
    assert found.path.name == "second.mcap"


def test_the_command(tmp_path: Path, small_set: list[Path], gsb_eval: Command) -> None:
    """Print the same with a new store, a filled one, a deleted one and none."""
    cache = tmp_path / "cache"
    printed = []
    for arguments in (["--cache", cache], ["--cache", cache], ["--no-cache"]):
        done = gsb_eval(*small_set, "--sample-time", 1, "--json", "-", *arguments, code=0)
        printed.append(done.stdout)
    assert list(cache.rglob("*.result"))
    shutil.rmtree(cache)
    printed.append(gsb_eval(*small_set, "--sample-time", 1, "--json", "-", "--cache", cache).stdout)
    assert len(set(printed)) == 1
    assert json.loads(printed[0])["groups"]


def test_a_file_read_elsewhere_is_not_kept(tmp_path: Path, small_set: list[Path]) -> None:
    """Keep nothing under this machine's stamp that another machine read of a file of that name."""

    def elsewhere(function: Callable[[Any], Any], items: Iterable[Any], /) -> list[Any]:
        return [replace(function(small_set[1]), stamp=addresses.Stamp(1, 2, 3, 4, 5)) for _ in items]

    work = Work(elsewhere, Store(tmp_path))
    assert len(list(read_all([small_set[0]], Reader(1.0), work))) == 1
    assert not list(tmp_path.rglob("*.result"))


def test_what_killed_processes_left_goes(tmp_path: Path) -> None:
    """Delete unfinished files of an hour ago, and leave those of now."""
    (tmp_path / "ab").mkdir()
    old, new = tmp_path / "ab" / ".gsb-old.partial", tmp_path / "ab" / ".gsb-new.partial"
    for path in (old, new):
        path.write_text("")
    os.utime(old, (0, 0))
    Store(tmp_path).prune()
    assert [old.exists(), new.exists()] == [False, True]


def test_a_cache_that_is_no_folder(tmp_path: Path, small: Path, gsb_eval: Command) -> None:
    """Refuse a file where a folder was meant."""
    (tmp_path / "file").write_text("")
    done = gsb_eval(small, "--cache", tmp_path / "file")
    assert (done.returncode, done.stderr) == (
        2,
        f"gsb-eval: --cache must be a folder, and {tmp_path / 'file'} is not one\n",
    )


def test_where_it_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Follow GSB_CACHE, then XDG_CACHE_HOME, then the home folder; do without where there is none."""
    monkeypatch.setenv("GSB_CACHE", "/a")
    assert default_folder() == Path("/a")
    monkeypatch.delenv("GSB_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/b")
    assert default_folder() == Path("/b/gpusimbench")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert default_folder() == Path.home() / ".cache" / "gpusimbench"

    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody)
    assert default_folder() is None
