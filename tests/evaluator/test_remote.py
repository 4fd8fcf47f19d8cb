"""Recordings elsewhere: the same as on this machine, with a small part of their bytes."""

from __future__ import annotations

import ipaddress
import json
import random
import re
import shutil
import socket
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import fsspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.cli import audit, check, diff, info, share
from gpusimbench.evaluator.cli import eval as evaluation
from gpusimbench.evaluator.read.addresses import expand
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import DamagedRecording, NotARecording, RecordingError, Unreachable
from gpusimbench.schemas.location import Location, redacted, shown, shown_argument
from gpusimbench.schemas.mcap import contents, decompression
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.records import MAGIC
from gpusimbench.schemas.remote import file as remote
from gpusimbench.schemas.remote import web as addresses_of_web
from gpusimbench.schemas.remote.file import Patience, RemoteFile, TooSlow
from tests.conftest import run_python
from tests.forging import copied
from tests.hostile.reading import in_time
from tests.reading import verified
from tests.synthetic import grid, write_recording
from tests.test_docs import ROOT, commands, shell
from tests.web import Web, serving

N_ENV, STEPS = 128, 400


def _paths(start: np.ndarray[Any, Any], step: int) -> np.ndarray[Any, Any]:
    return start + np.float32(0.001) * step


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two runs that have two columns of environments and nine blocks of states each, 17 MB."""
    folder = tmp_path_factory.mktemp("large")
    ends = [grid(N_ENV, "float32"), grid(N_ENV, "float32") + np.float32(0.01)]
    return [
        write_recording(
            folder, end, run=i, run_id=f"run-{i}", steps=STEPS, dt=0.01, path_of=_paths, gpu_bytes=(10**9, 2 * 10**9),
            name=f"run-{i}.mcap",
        )
        for i, end in enumerate(ends)
    ]  # fmt: skip


@pytest.fixture
def web() -> Iterator[Web]:
    """A web server."""
    with serving() as server:
        yield server


@pytest.fixture
def memory() -> Iterator[Any]:
    """The file system memory://, empty."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


def _put(memory: Any, path: Path, name: str = "") -> str:
    memory.pipe(f"/set/{name or path.name}", path.read_bytes())
    return f"memory://set/{name or path.name}"


def _source(recording: Recording) -> RemoteFile:
    source = recording._container.source
    assert isinstance(source, RemoteFile)
    return source


def test_facts_cost_a_small_part(web: Web, large: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Tell of a remote file, from a tenth of its bytes, what is told of the same file here."""
    web.files["a.mcap"] = large[0].read_bytes()
    assert info.main(["--no-verify", "--json", "-", f"{web.address}/a.mcap"]) == 0
    (remote_facts,) = json.loads(capsys.readouterr().out)["files"]
    assert web.sent < large[0].stat().st_size / 10
    assert info.main(["--no-verify", "--json", "-", str(large[0])]) == 0
    (facts,) = json.loads(capsys.readouterr().out)["files"]
    assert remote_facts.pop("file") == f"{web.address}/a.mcap"
    assert facts.pop("file") == str(large[0])
    assert remote_facts.pop("unchecked").keys() >= facts.pop("unchecked").keys()  # of a file elsewhere less is read
    assert remote_facts == facts


@pytest.mark.parametrize("options", [[], ["--no-verify"]])
def test_the_same_metrics(web: Web, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]) -> None:
    """Evaluate a remote set, given by a wildcard, to the same numbers as the local one."""
    ends = (grid(4) + offset for offset in (0, 0.001, 0.002))
    runs = [write_recording(tmp_path, end, run=i, steps=60, gpu_bytes=(1, 2)) for i, end in enumerate(ends)]
    web.files |= {f"set/{path.name}": path.read_bytes() for path in runs}
    documents = []
    for files in ([f"{web.address}/set/*.mcap"], sorted(map(str, runs))):
        assert evaluation.main([*files, "--json", "-", *options]) == 0
        text = capsys.readouterr().out
        for path in runs:
            text = text.replace(f"{web.address}/set/{path.name}", "F").replace(str(path), "F")
        documents.append(json.loads(text))
    assert documents[0] == documents[1]
    assert {path for path, _ in web.requests if path.endswith(".mcap")} == {f"set/{path.name}" for path in runs}


def test_one_step_and_one_env_cost_their_blocks(memory: Any, large: list[Path]) -> None:
    """Read of one step the blocks of that step, and of one environment those of its column."""
    recording = open_recording(_put(memory, large[0]))
    local = np.asarray(open_recording(large[0]).state("cubes", "position"))
    states, source = recording.state("cubes", "position"), _source(recording)
    assert source.fetched < 400_000  # opening has read no block
    block = 50 * 64 * 27 * 3 * 4
    rounding = 2 * remote._BLOCK
    before = source.fetched
    assert np.array_equal(states.at_step(210), local[210])
    assert 2 * block < source.fetched - before < 2 * (block + rounding)
    before = source.fetched
    assert np.array_equal(states[:, 70], local[:, 70])
    of_column = STEPS // 50 * block + block // 50
    assert of_column - block < source.fetched - before < of_column + 9 * rounding
    assert source.fetched < large[0].stat().st_size


def test_one_difference_costs_its_blocks(web: Web, large: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Compare one environment of two remote runs without the blocks of the others."""
    web.files |= {path.name: path.read_bytes() for path in large}
    found = []
    for a, b in ([f"{web.address}/{path.name}" for path in large], map(str, large)):
        assert diff.main([a, b, "--env", "3", "--no-verify", "--json", "-"]) == 4
        document = json.loads(capsys.readouterr().out)
        assert (document["a"].pop("file"), document["b"].pop("file")) == (a, b)
        found.append(document)
    assert found[0] == found[1]
    assert web.sent < 0.75 * sum(path.stat().st_size for path in large)


def test_verified_in_bounded_memory(
    memory: Any, large: list[Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Verify a remote file with a cache that is smaller than the file, and find a bit that was changed."""
    monkeypatch.setattr(remote, "_CACHED_BYTES", 2 << 20)
    recording = verified(_put(memory, large[0]))
    assert len(_source(recording)._blocks) * remote._BLOCK <= 2 << 20
    data = bytearray(large[0].read_bytes())
    data[len(data) // 2] ^= 1
    changed = tmp_path / "changed.mcap"
    changed.write_bytes(data)
    with pytest.raises(DamagedRecording, match="CRC"):
        verify(open_recording(_put(memory, changed)))


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_files_of_other_writers(memory: Any, tmp_path: Path, compression: str) -> None:
    """Read chunks that hold messages of many topics, with and without an index of them, and messages outside of any."""
    from mcap.writer import CompressionType, IndexType

    original = write_recording(tmp_path, grid(3), steps=60)
    whole = np.asarray(open_recording(original).state("cubes", "position"))
    ways: list[dict[str, Any]] = [
        {"chunk_size": 700},
        {"chunk_size": 1 << 20},
        {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
        {"index_types": IndexType.NONE},
        {"use_chunking": False},
        {"use_statistics": False},
        {"use_summary_offsets": False, "repeat_schemas": False, "repeat_channels": False},
    ]
    for number, options in enumerate(ways):
        copy = tmp_path / f"{number}.mcap"
        copied(original, copy, compression=CompressionType[compression.upper()], **options)
        recording = verified(_put(memory, copy))
        assert np.array_equal(np.asarray(recording.state("cubes", "position")), whole), options
        assert recording.events == open_recording(copy).events


def test_cut_short(memory: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: Any) -> None:
    """Read what is left of a file without an end, and say that all of it had to be read; refuse a large one."""
    whole = write_recording(tmp_path, grid(2), end=False)
    recording = open_recording(_put(memory, whole, "part.mcap"))
    assert recording.status == "incomplete"
    assert "memory://set/part.mcap has no index: all of its" in caplog.text
    monkeypatch.setattr(contents, "MAX_WALKED_BYTES", 1000)
    with pytest.raises(DamagedRecording, match="download it"):
        open_recording("memory://set/part.mcap")


def test_a_server_that_gives_no_parts(web: Web, large: list[Path], tmp_path: Path) -> None:
    """Say so where the file is large, after little of it; read a file as a whole that is no larger than a part."""
    web.ranges = False
    web.files["a.mcap"] = large[0].read_bytes()
    with pytest.raises(Unreachable, match="only as a whole; download it"):
        open_recording(f"{web.address}/a.mcap").state("cubes", "position")
    assert web.sent < len(web.files["a.mcap"]) / 2
    small = write_recording(tmp_path, grid(2), steps=5)
    assert small.stat().st_size < remote._BLOCK
    web.files["b.mcap"] = small.read_bytes()
    verify(open_recording(f"{web.address}/b.mcap"))


@pytest.mark.parametrize("status", [203, 226])
def test_a_part_that_a_server_calls_something_else(status: int, web: Web, tmp_path: Path) -> None:
    """Take nothing for a part of the file that the server does not call so: a proxy may have changed it."""
    web.status = status
    web.files["a.mcap"] = write_recording(tmp_path, grid(2)).read_bytes()
    with pytest.raises(Unreachable, match="only as a whole; download it"):
        open_recording(f"{web.address}/a.mcap")


def test_a_connection_that_breaks(web: Web, large: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Name the file and what happened where an answer ends early; nothing is taken for the file's content."""
    web.files["a.mcap"] = large[0].read_bytes()
    recording = open_recording(f"{web.address}/a.mcap")
    states = recording.state("cubes", "position")
    web.cut = 100_000
    with pytest.raises(Unreachable, match=f"cannot read {web.address}/a.mcap: "):
        states.at_step(100)
    web.cut = 10
    assert info.main(["--no-verify", f"{web.address}/a.mcap"]) == 3
    assert f"gsb-info: cannot read {web.address}/a.mcap: " in capsys.readouterr().err


def test_a_file_that_changes(web: Web, large: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Notice that another file took the place of one that is being read, though its bytes look like it."""
    monkeypatch.setattr(remote, "_CONFIRM_S", -1.0)
    web.files["a.mcap"] = large[0].read_bytes()
    recording = open_recording(f"{web.address}/a.mcap")
    states = recording.state("cubes", "position")
    web.files["a.mcap"] = large[1].read_bytes()
    with pytest.raises(DamagedRecording, match="changed while it was read"):
        states.at_step(100)


def test_whoever_reads_on_asks_for_more_at_once(memory: Any) -> None:
    """Double each request of a reader that goes on, up to 4 MiB, and ask for one block again where it jumps."""
    block, data = 64 << 10, np.random.default_rng(0).bytes(17 << 20)
    memory.pipe("/long", data)
    source = RemoteFile(Location("memory://long"))
    fetched = []
    for begin in range(0, 16 << 20, block):
        assert source.read(begin, begin + block) == data[begin : begin + block]
        fetched.append(source.fetched // block)
    assert list(dict.fromkeys(fetched)) == [1, 2, 4, 8, 16, 32, 64, 128, 192, 256]  # blocks behind each request
    assert source.read((17 << 20) - 1, 17 << 20) == data[-1:]
    assert source.fetched == (16 << 20) + block


def test_verify_asks_whether_it_changed(memory: Any, large: list[Path]) -> None:
    """Notice at the end of a verification that the file is another one by now, if not before."""
    recording = open_recording(_put(memory, large[0]))
    _put(memory, large[1], large[0].name)
    with pytest.raises(RecordingError):
        verify(recording)


def test_what_cannot_be_had(web: Web, memory: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Name what is not there, no recording, of no known kind or behind a missing package; exit as for other files."""
    web.files["text.mcap"] = b"not the bytes that you are looking for" * 10
    web.files["empty.mcap"] = b""
    for address, message in (
        (f"{web.address}/none.mcap", "the server answers 404: there is no such file"),
        (f"{web.address}/text.mcap", "is not an MCAP file"),
        (f"{web.address}/empty.mcap", "is not an MCAP file"),
        ("http://127.0.0.1:1/a.mcap", "cannot read http://127.0.0.1:1/a.mcap: "),
        ("memory://nowhere/a.mcap", "there is no such file"),
        ("nonsense://a.mcap", "Protocol not known: nonsense"),
    ):
        assert info.main(["--no-verify", address]) == 3
        found = capsys.readouterr()
        assert message in found.err
        assert found.err.count("\n") == 1
        assert evaluation.main([address]) == 3
        assert message in capsys.readouterr().err
    with pytest.raises(NotARecording, match="not an MCAP file"):
        open_recording(f"{web.address}/text.mcap")
    assert check.main(["memory://nowhere/a.mcap"]) == 3


def test_missing_package() -> None:
    """Name what to install where fsspec is not there."""
    code = (
        "import sys; sys.modules['fsspec'] = None\n"
        "from gpusimbench.evaluator.cli.info import main\n"
        "raise SystemExit(main(['--no-verify', 'https://localhost/a.mcap']))"
    )
    done = run_python(code, code=3)
    assert "pip install 'gpusimbench[remote]'" in done.stderr


def test_local_files_need_no_package(large: list[Path]) -> None:
    """Read a local file without loading anything that reads remote ones."""
    code = (
        "import sys\nfrom gpusimbench.evaluator.cli.info import main\n"
        f"assert main(['--no-verify', {str(large[0])!r}]) == 0\n"
        "assert not {'fsspec', 'aiohttp', 'gpusimbench.schemas.remote'} & set(sys.modules)"
    )
    run_python(code)


def test_secrets_stay_with_the_server(web: Web, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write no password and no signature of an address to any output, good or bad."""
    web.files["a.mcap"] = write_recording(tmp_path, grid(2)).read_bytes()
    host = web.address.removeprefix("http://")
    secret = "pass%20word-of-mine"
    for name, code in (("a.mcap", 0), ("none.mcap", 3)):
        address = f"http://whoever:{secret}@{host}/{name}?X-Amz-Signature={secret}&x='{secret}"
        report, results = tmp_path / f"{name}.html", tmp_path / f"{name}.json"
        for main, arguments in (
            (evaluation.main, [address, "--html", str(report), "--json", str(results)]),
            (check.main, [address]),
            (check.main, [address, "--json", "-"]),
            (info.main, [address]),
            (info.main, ["--no-verify", "--json", "-", address]),
            (diff.main, [address, address, "--no-verify", "--json", "-"]),
            (diff.main, [address, address]),
        ):
            assert main(arguments) in (code, 4)
            found = capsys.readouterr()
            written = [p.read_text() for p in (report / "index.html", results) if p.is_file()]
            assert f"http://{host}/{name}" in "".join((found.out, found.err, *written))
            for text in (found.out, found.err, *written):
                assert "of-mine" not in text
                assert "whoever" not in text
    assert (tmp_path / "a.mcap.html" / "index.html").is_file()


@given(
    st.text("abc/@:?#=&%é\x1b \u202e", max_size=30), st.sampled_from(["https", "s3", "hf", "memory", "HTTP"]), st.text()
)
def test_what_is_shown_of_an_address(path: str, scheme: str, before: str) -> None:
    """Show neither what stands ahead of the host nor what follows the path, and no control character."""
    address = f"{scheme}://user:SECRET@host/{path}?key=SECRET"
    for text in (
        shown(address), str(Location(address)), repr(Location(address)), Location(address).name,
        shown_argument(f"--reference={address}"), shown(f"simplecache::{address}"),
    ):  # fmt: skip
        assert "SECRET" not in text
    assert shown(address).isprintable()
    assert Location(address).name.isprintable()
    assert "SECRET" not in redacted(f"{before} https://user:SECRET@host/a?b=SECRET, {before}").replace(before, "")


@given(st.data())
def test_any_part_is_that_of_the_file(data: st.DataObject) -> None:
    """Give the file's own bytes of any part, whatever was read before, and keep no more than the cache holds."""
    content = random.Random(1).randbytes(300_000)
    system = fsspec.filesystem("memory")
    system.pipe("/parts", content)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(remote, "_BLOCK", 1000)
        patch.setattr(remote, "_CACHED_BYTES", 20_000)
        patch.setattr(remote, "_AHEAD_BYTES", 8000)
        source = RemoteFile(Location("memory://parts"))
        for _ in range(20):
            begin = data.draw(st.integers(0, len(content)))
            end = data.draw(st.integers(begin, min(len(content), begin + 15_000)))
            assert source.read(begin, end) == content[begin:end]
            assert len(source._blocks) <= 20


def test_wildcards(memory: Any, large: list[Path]) -> None:
    """Let an address stand for the files that match it, each once, and say so where there is none."""
    for path in large:
        _put(memory, path)
    addresses = [Location(f"memory:///set/{path.name}") for path in large]
    assert [str(p) for p in expand([Location("memory://set/*.mcap"), addresses[0]])] == [
        str(Location(f"memory://{'/' if str(p).startswith('memory:///') else ''}set/{path.name}"))
        for p, path in zip(expand([Location("memory://set/*.mcap")]), large, strict=True)
    ]
    with pytest.raises(Unreachable, match="no file there has such a name"):
        expand([Location("memory://set/*.txt")])
    with pytest.raises(Unreachable, match="more than the 1 that are read at once"):
        remote.matching(Location("memory://set/*.mcap"), 1)


def test_one_reference(memory: Any, large: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a reference that stands for several recordings, rather than choose one."""
    for path in large:
        _put(memory, path)
    assert evaluation.main([str(large[0]), "--reference", "memory://set/*.mcap", "--no-verify"]) == 2
    assert "--reference is one recording; memory://set/*.mcap stands for 2" in capsys.readouterr().err


def _summary(data: bytes) -> int:
    return int(struct.unpack_from("<Q", data, len(data) - len(MAGIC) - 20)[0])


def _records(data: bytes) -> list[bytes]:
    # of the summary
    records, position = [], _summary(data)
    while position < len(data) - len(MAGIC):
        size = 9 + struct.unpack_from("<Q", data, position + 1)[0]
        records.append(data[position : position + size])
        position += size
    return records


def _resealed(data: bytearray) -> bytes:
    # with the CRC that the summary has now
    begin, crc_at = _summary(data), len(data) - len(MAGIC) - 4
    data[crc_at : crc_at + 4] = struct.pack("<I", zlib.crc32(data[begin:crc_at]))
    return bytes(data)


def test_a_summary_that_lies(memory: Any, tmp_path: Path) -> None:
    """Refuse, or read the same numbers, whatever a summary claims whose CRC is right."""
    rng = random.Random(3)
    source = write_recording(tmp_path, grid(64, "float32"), steps=60, timed_steps=20)
    data, whole = source.read_bytes(), np.asarray(open_recording(source).state("cubes", "position"))
    declared = b"".join(record for record in _records(data) if record[0] in (3, 4))
    begin = _summary(data) + len(declared)  # schemas are long, and nothing is read with them
    refused = 0
    for number in range(200):
        changed = bytearray(data)
        at = rng.randrange(begin, len(data) - 30)
        match number % 3:
            case 0:
                changed[at] ^= 1 << rng.randrange(8)
            case 1:
                changed[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, (2**40).to_bytes(8, "little")])
            case 2:
                changed[at : at + 16] = rng.randbytes(16)
        memory.pipe("/lie", _resealed(changed[: len(data)]))
        try:
            recording = verified("memory://lie")
            assert np.array_equal(np.asarray(recording.state("cubes", "position")), whole)
        except (RecordingError, KeyError):
            refused += 1
    assert refused > 50


def test_what_a_summary_leaves_out(memory: Any, tmp_path: Path) -> None:
    """Notice on verifying that chunks or messages lie in the file that its summary does not know."""
    source = write_recording(tmp_path, grid(64, "float32"), steps=60)
    data = source.read_bytes()
    begin, records = _summary(data), _records(data)
    chunks = [i for i, r in enumerate(records) if r[0] == 8]
    attachments = [i for i, r in enumerate(records) if r[0] == 10]
    (statistics,) = [i for i, r in enumerate(records) if r[0] == 11]
    for left_out, counter in ((chunks[-2], 9 + 8 + 2 + 4 + 4 + 4), (attachments[0], 9 + 8 + 2 + 4)):
        kept = [bytearray(r) for i, r in enumerate(records) if i != left_out]
        at = statistics if statistics < left_out else statistics - 1
        (count,) = struct.unpack_from("<I", kept[at], counter)
        struct.pack_into("<I", kept[at], counter, count - 1)
        if left_out in chunks:
            index_bytes = struct.unpack_from("<Q", records[left_out], 9 + 32 + 4 + 10)[0]
            (messages,) = struct.unpack_from("<Q", kept[at], 9)
            struct.pack_into("<Q", kept[at], 9, messages - (index_bytes - 15) // 16)
        forged = bytearray(data[:begin] + b"".join(kept) + MAGIC)
        memory.pipe("/short", _resealed(forged))
        with pytest.raises(DamagedRecording):
            opened = Container(Location("memory://short"))
            assert opened.indexed
            opened.verify()


def test_no_flipped_bit_passes(memory: Any, tmp_path: Path) -> None:
    """Notice every flipped bit of a remote file: refused on opening, or by verify."""
    data = write_recording(tmp_path, grid(1)).read_bytes()
    rng = random.Random(4)
    passed = []
    for _ in range(200):
        changed = bytearray(data)
        position = rng.randrange(len(data))
        changed[position] ^= 1 << rng.randrange(8)
        memory.pipe("/flipped", bytes(changed))
        try:
            recording = verified("memory://flipped")
        except RecordingError:
            continue
        if recording.status != "incomplete":
            passed.append(position)
    assert not passed


def test_checked_as_a_whole(memory: Any, large: list[Path]) -> None:
    """Examine a remote file as a local one, and leave no copy behind."""
    remote_one, local = examine(_put(memory, large[0])), examine(large[0])
    assert remote_one.problems.kinds() == local.problems.kinds()
    assert remote_one.complete
    assert remote_one.scan.counts == local.scan.counts
    assert str(remote_one.recording.path) == str(remote_one.path) == f"memory://set/{large[0].name}"
    verify(remote_one.recording)


@pytest.mark.slow
def test_commands_of_the_guide(tmp_path: Path) -> None:
    """Run every command that docs/remote.md shows in a console block, in a folder that has the sample recordings."""
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    lines = commands(ROOT / "docs" / "remote.md")
    assert lines
    for line in lines:
        assert shell(line, tmp_path).stdout


@pytest.mark.parametrize(
    ("address", "text", "name"),
    [
        ("s3://bucket/a/run%201.mcap?versionId=3", "s3://bucket/a/run%201.mcap", "run 1.mcap"),
        ("simplecache::s3://bucket/run#3.mcap", "simplecache::s3://bucket/run#3.mcap", "run#3.mcap"),
        ("zip://a.mcap::https://me:x@host/b.zip?x", "zip://a.mcap::https://host/b.zip", "a.mcap"),
        ("https://me:p::w@host:80/a.mcap#x", "https://host:80/a.mcap", "a.mcap"),
        ("hf://datasets/me/set@main/a.mcap", "hf://datasets/me/set@main/a.mcap", "a.mcap"),
    ],
)
def test_names_of_addresses(address: str, text: str, name: str) -> None:
    """Show what tells files apart, and name them without their folder."""
    assert (str(Location(address)), Location(address).name) == (text, name)


def _record(opcode: int, content: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _with(data: bytes, *, beside: bytes = b"", behind: bytes = b"", instead: bytes | None = None) -> bytes:
    # records beside the chunks, behind the summary's, or instead of those; sizes and CRCs are right
    begin = _summary(data)
    section = (data[begin : len(data) - len(MAGIC) - 29] if instead is None else instead) + behind
    head = data[: begin - 13] + beside
    end = head + _record(15, struct.pack("<I", zlib.crc32(head)))
    footer = _record(2, struct.pack("<QQI", len(end), 0, 0))
    return _resealed(bytearray(end + section + footer + MAGIC))


@pytest.mark.parametrize(
    "more",
    [
        {"beside": bytes(9)},
        {"beside": _record(2, bytes(20))},
        {"beside": _record(15, bytes(4))},
        {"beside": _record(4, struct.pack("<HHI", 1, 0, 2) + b"/Z" + bytes(8))},
        {"beside": _record(3, struct.pack("<HI", 60000, 1) + b"x" + bytes(8))},
        {"behind": b"\5"},
        {"behind": bytes(8)},
        {"behind": bytes(9)},
        {"behind": _record(2, bytes(20))},
        {"behind": _record(7, bytes(6))},
    ],
)
def test_nothing_that_a_walk_would_trip_over(memory: Any, tmp_path: Path, more: dict[str, bytes]) -> None:
    """Refuse what a file holds beside its records, though its summary and all CRCs are right."""
    data = write_recording(tmp_path, grid(4)).read_bytes()
    memory.pipe("/good", _with(data))
    recording = verified("memory://good")
    assert recording._container.indexed
    memory.pipe("/bad", _with(data, **more))
    with pytest.raises(DamagedRecording):
        verify(open_recording("memory://bad"))


def test_indexes_that_are_never_read(memory: Any, tmp_path: Path) -> None:
    """Refuse a false index of a chunk's only message, which is found without it."""
    data = write_recording(tmp_path, grid(4)).read_bytes()
    places = [struct.unpack_from("<Q", r, 9 + 32 + 4 + 2)[0] for r in _records(data) if r[0] == 8]
    for at, value in ((9 + 6 + 8, 2**40), (9 + 6, 7), (9 + 2, 0)):
        changed = bytearray(data)
        changed[places[-1] + at : places[-1] + at + 4] = (value & 0xFFFFFFFF or value >> 32).to_bytes(4, "little")
        memory.pipe("/index", _with(bytes(changed)))
        opened = Container(Location("memory://index"))
        assert opened.indexed
        with pytest.raises(DamagedRecording, match="index"):
            opened.verify()


@pytest.mark.slow
def test_memory_of_a_summary(memory: Any) -> None:
    """Take a summary of 60,000 declarations in little memory, and refuse lists that no file has room for."""
    head = MAGIC + _record(1, struct.pack("<I", 6) + b"gsb.v1" + bytes(4))
    data = head + _record(15, bytes(4)) + _record(2, struct.pack("<QQI", len(head) + 13, 0, 0)) + MAGIC
    schema = _record(3, struct.pack("<HII", 1, 0, 0) + bytes(4))
    memory.pipe("/many", _with(data, instead=schema * 60_000))
    tracemalloc.start()
    with pytest.raises(DamagedRecording, match="cut short"):  # without statistics it is walked
        open_recording("memory://many")
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    listed = b"".join(struct.pack("<HQ", i, len(head) + 49 + i) for i in range(1000))
    chunk = struct.pack("<QQQQI", 0, 0, len(head), 49, len(listed)) + listed + struct.pack("<QIQQ", 15_000, 0, 0, 0)
    memory.pipe("/lists", _with(data, beside=bytes(9 + 15_100), instead=_record(8, chunk)))
    with pytest.raises(DamagedRecording, match="lists impossible messages"):
        open_recording("memory://lists")


def test_records_that_are_too_long(memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a long record of a remote file before it is read."""
    path = write_recording(tmp_path, grid(4))
    address = _put(memory, path)
    monkeypatch.setattr(contents, "MAX_HEADER_BYTES", 3)
    with pytest.raises(DamagedRecording, match="more than the 3 that are read from elsewhere"):
        open_recording(address)
    monkeypatch.undo()
    monkeypatch.setattr(decompression, "MAX_BYTES", 100)
    with pytest.raises(DamagedRecording, match="more than the 100 that are read from elsewhere"):
        verify(open_recording(address))


def test_no_more_than_was_asked_for(web: Web, large: list[Path]) -> None:
    """Refuse an answer that is packed or longer than the part, after no more bytes than the part has."""
    web.files["a.mcap"] = large[0].read_bytes()
    web.packed = True
    with pytest.raises(Unreachable, match="the server packs its answers"):
        open_recording(f"{web.address}/a.mcap")
    web.packed, web.more = False, 200 << 20
    with pytest.raises(Unreachable, match="more than the [0-9]+ bytes that it was asked for"):
        open_recording(f"{web.address}/a.mcap")
    assert web.sent < 1 << 20  # no answer was taken to its end
    web.more = 0
    open_recording(f"{web.address}/a.mcap").state("cubes", "position").at_step(3)


@pytest.mark.parametrize(
    "address",
    [
        "https://user:SECRET@h.example/x.json",
        "https://user:pa/SECRET@h.example/x",
        "https://user:SECRET#x@h.example/",
        "https://user:SECRET?x@h.example/",
        "https://h.example/x?X-Amz-Signature=SECRET",
        "https://h.example/x?e=a@SECRET",
    ],
)
def test_addresses_where_paths_are_meant(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refuse an address in place of a path as wrong usage, make no folder of it, and tell none of its secrets."""
    monkeypatch.chdir(tmp_path)
    file = "none.mcap"
    cases: list[tuple[Any, list[str]]] = [
        (share.main, ["pack", address]), (share.main, ["recover", address]),
        (share.main, ["pack", file, "--out", address]),
        (audit.main, [address]), (audit.main, [file, "--out", address]), (check.main, [file, "--rules", address]),
        (diff.main, [file, "--env", address]), (diff.main, [file, "--plot", address]),
        *((evaluation.main, [file, option, address]) for option in ("--json", "--html", "--tables", "--cache")),
        *((main, [file, "--json", address]) for main in (audit.main, check.main, diff.main, info.main)),
    ]  # fmt: skip
    for main, arguments in cases:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
        found = capsys.readouterr()
        assert "SECRET" not in found.out + found.err
        assert not list(tmp_path.iterdir())
    assert "SECRET" not in shown(address) + redacted(f"cannot read {address}: no") + shown_argument(address)


def test_a_list_of_files_that_does_not_end(web: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read a page that lists files up to its limit, in as many pieces as it comes in, and nothing beyond."""
    web.files["d/x.mcap"] = b"content"
    size = len('<a href="x.mcap">x.mcap</a>')
    monkeypatch.setattr(addresses_of_web, "_AT_ONCE", 10)
    monkeypatch.setattr(addresses_of_web, "_MOST_LISTED", size)
    assert expand([Location(f"{web.address}/d/*.mcap")]) == [Location(f"{web.address}/d/x.mcap")]
    monkeypatch.setattr(addresses_of_web, "_MOST_LISTED", size - 1)
    with pytest.raises(Unreachable, match="the server lists more than"):
        expand([Location(f"{web.address}/d/*.mcap")])


def test_wildcards_of_the_path_alone(web: Web, tmp_path: Path) -> None:
    """Look for wildcards in the path, after the name itself, and keep the query and the archive of what is found."""
    web.files["d/x.mcap"] = b"content"
    for query in ("?sig=ab*cd", "?f[0]=1"):
        address = Location(f"{web.address}/d/x.mcap{query}")
        assert expand([address]) == [address]
        assert not web.requests
    assert expand([Location(f"{web.address}/d/*.mcap?token=T")]) == [Location(f"{web.address}/d/x.mcap?token=T")]
    six = Location("http://[::1]:1/x.mcap")
    assert expand([six]) == [six]
    for name in ("br[1].mcap", "sp ace.mcap"):
        (tmp_path / name).write_bytes(b"content")
    literal = Location(f"file://{tmp_path}/br[1].mcap")
    assert expand([literal]) == [literal]
    assert RemoteFile(Location(f"file://{tmp_path}/sp%20ace.mcap")).read(0, 7) == b"content"
    with zipfile.ZipFile(tmp_path / "z.zip", "w") as archive:
        archive.write(tmp_path / "br[1].mcap", "a.mcap")
    (found,) = expand([Location(f"zip://*.mcap::file://{tmp_path}/z.zip")])
    assert found == Location(f"zip://a.mcap::file://{tmp_path}/z.zip")
    assert isinstance(found, Location)
    assert RemoteFile(found).read(0, 7) == b"content"


_QUICK = {"_ANSWER_S": 0.2, "_FILE_S": 0.4, "_LEAST_RATE": 1 << 20}


@pytest.mark.parametrize("slow", [{"silent": True}, {"silent": "parts"}, {"drip_s": 0.02}])
def test_a_slow_server(
    web: Web, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], slow: dict[str, Any]
) -> None:
    """Give up a server that is silent, or sends a byte now and then, with the exit code of what cannot be read."""
    for name, value in _QUICK.items():
        monkeypatch.setattr(remote, name, value)
    web.files["a.mcap"] = write_recording(tmp_path, grid(2)).read_bytes()
    # whichever comes first, where the machine is busy
    message = (
        r"(no answer within 0\.[12]\d* s|after 0\.4 s of waiting, what comes is slower than 1048576 bytes a second)"
    )
    for name, value in slow.items():
        setattr(web, name, value)
    for options in ([], ["--no-verify"]):
        assert info.main([*options, f"{web.address}/a.mcap"]) == 3
        found = capsys.readouterr()
        assert re.search(f"cannot read {web.address}/a.mcap: {message}", found.err)
        assert found.err.count("\n") == 1


def test_patience_is_for_all_of_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for many answers that are each in time only as long as their bytes are worth it, then ask no more."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr("gpusimbench.schemas.remote.file.time", SimpleNamespace(monotonic=lambda: clock.now))

    def answer() -> bytes:
        clock.now += 30
        return b"x"

    patience = Patience(answer_s=100, file_s=100, rate=1e6)
    for _ in range(4):
        assert patience.call(answer, 1) == b"x"
        clock.now += 1000  # of computing
    with pytest.raises(TooSlow, match="after 100 s of waiting, what comes is slower than 1000000 bytes a second"):
        patience.call(answer, 1)
    assert clock.now == 4 * 1030
    generous = Patience(answer_s=100, file_s=100, rate=0.02)  # 50 s for each byte
    for _ in range(20):
        assert generous.call(answer, 1) == b"x"
    with pytest.raises(ZeroDivisionError):
        generous.call(lambda: 1 // 0, 1)


def test_patience_counts_what_is_asked_at_once_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for eight answers at the same time as long as for one of them."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr("gpusimbench.schemas.remote.file.time", SimpleNamespace(monotonic=lambda: clock.now))
    patience = Patience(answer_s=100, file_s=100, rate=1e6)
    together = Barrier(8, action=lambda: setattr(clock, "now", 60.0))
    with ThreadPoolExecutor(8) as pool:
        done = [pool.submit(patience.call, together.wait, 0) for _ in range(8)]
        assert {one.result() for one in done} == set(range(8))
    assert patience.limit(0) == 40


@pytest.mark.parametrize("size", [10**15, (1 << 63) - 1])
def test_an_absurd_size(web: Web, size: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a file that is announced with more bytes than any has, as one that cannot be read, in every command."""
    web.files["a.mcap"], web.says = MAGIC, size
    for main in (info.main, check.main, evaluation.main):
        assert main([f"{web.address}/a.mcap"]) == 3
        assert "at most 17592186044416 are read" in " ".join("".join(capsys.readouterr()).split())


def test_no_room_for_a_copy(
    web: Web, large: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Call a file that does not fit beside others one that cannot be read."""
    web.files["a.mcap"] = large[0].read_bytes()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 9, 1))
    assert check.main([f"{web.address}/a.mcap"]) == 3
    assert "set TMPDIR to a folder with more" in " ".join("".join(capsys.readouterr()).split())


def test_redirections_stay_on_the_server(web: Web, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Follow a server to another path of its own; ask no other port of this machine for anything."""
    data = write_recording(tmp_path, grid(2)).read_bytes()
    web.files["a.mcap"] = data
    web.redirects["here.mcap"] = "/a.mcap"
    verify(open_recording(f"{web.address}/here.mcap"))
    with serving() as other:
        other.files["a.mcap"] = data
        port = other.address.rpartition(":")[2]
        for target in (f"{other.address}/a.mcap", f"http://localhost:{port}/a.mcap", f"http://[::1]:{port}/a.mcap"):
            web.redirects["there.mcap"] = f"{target}?secret=SECRET"
            for options in ([], ["--no-verify"]):
                assert info.main([*options, f"{web.address}/there.mcap"]) == 3
                assert f"sends the reader to {target}, which is another server" in (said := capsys.readouterr().err)
                assert "SECRET" not in said
        web.redirects["list/"] = f"{other.address}/"
        with pytest.raises(Unreachable, match="another server"):
            expand([Location(f"{web.address}/list/*.mcap")])
        web.redirects["there.zip"] = f"{other.address}/a.zip"
        with pytest.raises(Unreachable, match="another server"):
            open_recording(f"zip://a.mcap::{web.address}/there.zip")
        assert not other.requests


@pytest.mark.parametrize(
    ("begin", "end", "same"),
    [
        ("http://a.example/x", "http://a.example:80/y", True),
        ("http://a.example/x", "https://a.example/x", True),
        ("https://a.example/x", "https://a.example:443/x", True),
        ("https://a.example/x", "http://a.example/x", False),
        ("http://a.example:8000/x", "https://a.example:8001/x", False),
        ("http://127.0.0.1:8000/x", "http://127.0.0.1:8001/x", False),
        ("http://127.0.0.1:8000/x", "http://localhost:8000/x", False),
        ("https://a.example/x", "ftp://a.example/x", False),
    ],
)
def test_what_one_server_is(begin: str, end: str, same: bool) -> None:
    """Call scheme, host and port a server, and its encrypted self the same."""
    assert addresses_of_web.same_server(urlsplit(begin), urlsplit(end)) is same


@pytest.mark.parametrize(
    ("address", "public"),
    [
        ("8.8.8.8", True), ("2001:4860:4860::8888", True), ("127.0.0.1", False), ("10.1.2.3", False),
        ("192.168.0.1", False), ("172.16.0.1", False), ("169.254.169.254", False), ("100.64.0.1", False),
        ("0.0.0.0", False), ("224.0.0.1", False), ("::1", False), ("fe80::1", False), ("fd00::1", False),
        ("::ffff:127.0.0.1", False), ("::ffff:8.8.8.8", True), ("2002:7f00:1::", False),
    ],
)  # fmt: skip
def test_what_a_public_address_is(address: str, public: bool) -> None:
    """Call public what the whole internet reaches: no loopback, no private network, no cloud's metadata."""
    assert addresses_of_web.is_public(ipaddress.ip_address(address)) is public


def test_a_public_server_may_send_to_another_public_one(web: Web, tmp_path: Path, monkeypatch: Any) -> None:
    """Follow a hub to its store, as long as both are public and the store is encrypted; never to a private address."""
    web.files["a.mcap"] = write_recording(tmp_path, grid(2)).read_bytes()
    monkeypatch.setattr(addresses_of_web, "is_public", lambda address: not str(address).startswith("10."))
    followed = "annot connect to|ssl|SSL"
    for target, message in (
        (f"https://localhost:{web.address.rpartition(':')[2]}/a.mcap", followed),
        (f"http://localhost:{web.address.rpartition(':')[2]}/a.mcap", "another server"),
        ("https://10.0.0.1/a.mcap", "another server"),
    ):
        web.redirects["b.mcap"] = target
        with pytest.raises(Unreachable, match=message):
            open_recording(f"{web.address}/b.mcap")


def test_a_server_that_is_not_there_is_said_in_words() -> None:
    """Name host, port and the reason of the system, and no class of a library."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))  # and does not listen
        place = f"127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(Unreachable, match=f": cannot connect to {place}: Connection refused$"):
            open_recording(f"http://{place}/a.mcap")


def test_how_long_a_request_is_waited_for(memory: Any, tmp_path: Path) -> None:
    """Wait 30 s for an answer, and 1 s more for each 32 KiB of it, as docs/remote.md says."""
    patience = RemoteFile(Location(_put(memory, write_recording(tmp_path, grid(2)))))._patience
    assert patience.limit(0) == 30.0
    assert patience.limit(7 << 15) == 37.0


def test_escapes_are_part_of_a_name(memory: Any) -> None:
    """Take %20 for a space in addresses of local files alone: elsewhere it names another file."""
    memory.pipe("/set/a b.mcap", b"content")
    with pytest.raises(Unreachable, match="no such file"):
        RemoteFile(Location("memory://set/a%20b.mcap"))


def test_long_texts_are_redacted_in_time() -> None:
    """Look through a megabyte without an address, as a stranger's file may put into an error, and leave none out."""
    words = "a" * 1_000_000
    with in_time():
        assert redacted(words) == words
    assert redacted(f"{words}://user:secret@host/x?key") == f"{words}://host/x"
