"""How much of a file is read: the numbers of docs/strangers.md are the code's, and each bound is exact."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any

import fsspec
import numpy as np
import pytest
import zstandard

from gpusimbench import open_recording
from gpusimbench.evaluator.check.integrity import scan
from gpusimbench.evaluator.read import addresses, messages
from gpusimbench.schemas import (
    arrays,
    checks,
    configuration,
    imported,
    model_files,
    provenance,
    tosses,
)
from gpusimbench.schemas import messages as types
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.fields import StateField, body_field
from gpusimbench.schemas.mcap import chunks, contents, declarations, decompression, index, reader, records
from gpusimbench.schemas.remote import file as remote
from gpusimbench.schemas.remote import web
from gpusimbench.schemas.view import geometry
from tests.schemas.test_view_geometry import GOOD, changed
from tests.synthetic import grid, write_recording

PAGE = Path(__file__).parents[2] / "docs" / "strangers.md"


def _bytes(size: int) -> str:
    for shift, unit in ((40, "TiB"), (30, "GiB"), (20, "MiB"), (10, "KiB")):
        if size >= 1 << shift:
            assert size % (1 << shift) == 0
            return f"{size >> shift} {unit}"
    raise AssertionError(size)


def _told() -> dict[str, str]:
    # the table of the page: what, and its bound
    page = PAGE.read_text(encoding="utf-8")
    section = page.split("\n## Bounds\n")[1].strip().split("\n\n")[0]
    return {row[0]: row[1] for row in (line.strip("| ").split(" | ") for line in section.splitlines()[2:])}


BOUNDS: dict[str, str] = {
    "a chunk, decompressed": (
        f"{_bytes(decompression.MAX_BYTES)}; {decompression._MOST_PER_BYTE['zstd']:,} bytes a byte of zstd, "
        f"{decompression._MOST_PER_BYTE['lz4']} a byte of LZ4; exactly what it announces, in one frame"
    ),
    "chunks kept decompressed": (
        f"{chunks._CACHED_CHUNKS}, or {_bytes(chunks._CACHED_BYTES)}, whichever is less; at least the last one"
    ),
    "an attachment": _bytes(reader.MAX_ATTACHMENT_BYTES),
    "attachments": f"{contents.MAX_ATTACHMENTS}",
    "the JSON documents of a file together": f"{_bytes(checks.MAX_JSON_BYTES)}, {checks.MAX_JSON_VALUES:,} values",
    "JSON": f"{checks.MAX_DEPTH} levels deep, {checks.MAX_JSON_TEXT:,} characters a text",
    "schemas and channels of a file together": (
        f"{_bytes(declarations.MAX_DECLARED_BYTES)}, {declarations.MAX_DECLARED_TEXTS:,} texts of metadata; "
        f"{_bytes(declarations.MAX_CHANNEL_BYTES)} a channel"
    ),
    "records of metadata, records of the summary that `gsb-check` reads": (
        f"{scan.MAX_METADATA:,}, {scan.MAX_SUMMARY_RECORDS:,}"
    ),
    "messages": f"{contents.most_messages(0):,}, and one more for every {contents._LEAST_MESSAGE} bytes of the file",
    "messages of a topic that are kept as objects; of events and of gaps in the data": (
        f"{messages.MAX_MESSAGES:,}; {messages.MAX_NOTES:,}"
    ),
    "the end record": _bytes(messages.MAX_END_BYTES),
    "messages out of order": f"{_bytes(reader._HELD_BYTES)} that wait for earlier messages",
    "names of topics, types and attachments": f"{records._MAX_NAME} characters",
    "state fields": f"{provenance.MAX_FIELDS}",
    "environments, steps": f"2^{configuration.MAX_ENVS.bit_length() - 1}, 2^{checks.MAX_COUNT.bit_length() - 1}",
    "environments in a view, a definition of its types": (f"{configuration.MAX_VIEW}, {_bytes(types._LARGEST_SCHEMA)}"),
    "bodies, shapes and triangles of a view": (
        f"{geometry.MAX_LINKS}, {geometry.MAX_SHAPES}, {geometry.MAX_TRIANGLES:,}; {geometry._JOINTS} joints a body; "
        f"no length beyond {geometry._FAR_M:.0f} m"
    ),
    "arrays of an attachment": (
        f"{arrays.MAX_ARRAYS}, together {_bytes(arrays.MAX_BYTES)}; of an imported model {_bytes(imported.MAX_BYTES)} "
        f"and {imported._MOST_NAMES:,} names a list"
    ),
    "files of a model; their archive, decompressed": (
        f"{model_files.MAX_FILES}, together {_bytes(model_files.MAX_BYTES)}; {_bytes(model_files.MAX_ARCHIVE_BYTES)}"
    ),
    "the summary of a remote file": (
        f"{_bytes(index.MAX_SUMMARY_BYTES)}; 65,536 schemas and channels, and as many message indexes per chunk"
    ),
    "one record of a remote file": (
        f"header {_bytes(contents.MAX_HEADER_BYTES)}; a chunk as stored {_bytes(decompression.MAX_BYTES)}; "
        f"its message indexes {_bytes(contents.MAX_INDEX_BYTES)}"
    ),
    "data of a remote file kept in memory": _bytes(remote._CACHED_BYTES),
    "a remote file": _bytes(remote._MOST_BYTES),
    "a remote file without an index": f"{_bytes(contents.MAX_WALKED_BYTES)}, then refused",
    "a web page that lists files": _bytes(web._MOST_LISTED),
    "files that match an address with wildcards": f"{addresses.MAX_FILES:,}",
}


@pytest.mark.parametrize("what", BOUNDS)
def test_the_page_tells_the_bound(what: str) -> None:
    """Let docs/strangers.md and the code have the same numbers."""
    assert _told()[what] == BOUNDS[what]


def _many(count: int) -> dict[str, Any]:
    # arrays, by name
    return {f"{i}": np.zeros(1) for i in range(count)}


def _unpacked(path: Path, sizes: list[int]) -> Path:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for number, size in enumerate(sizes):
            archive.writestr(f"{number}.xml", "<mujoco/>".ljust(size))
    return model_files.unpack(stream.getvalue(), Path(tempfile.mkdtemp(dir=path.parent)))


def _plain(archive: bytes) -> bytes:
    return model_files.plain(model_files.COMPRESSED, zstandard.compress(archive))


def _model(folder: Path) -> Path:
    (folder / "part.xml").write_text("<mujoco/>")
    (folder / "model.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    return folder / "model.xml"


def _geometry(bodies: int, shapes: int) -> dict[str, Any]:
    sphere = {"shape": {"kind": "sphere", "radius": 1}}
    return {
        "bodies": [{"name": f"{i}", "parent": 0, "shapes": [sphere] * (shapes if i == 0 else 0)} for i in range(bodies)]
    }


def _robot(links: int) -> dict[str, Any]:
    return {"robot": {"links": [{"name": f"{i}", "parent": f"{i - 1}" if i else ""} for i in range(links)]}}


def _simulation(fields: int) -> list[dict[str, Any]]:
    told = [asdict(body_field(f"g{i}", "position", "float32", ("a",))) for i in range(fields)]
    return list(json.loads(json.dumps(told)))


FOUR = changed("meshes.0.triangles", [0, 1, 2] * 4)


def _attachments(path: Path) -> int:
    return len(open_recording(path)._container.attachment_names())


def _remote(path: Path) -> str:
    fsspec.filesystem("memory").pipe("/bounds/a.mcap", path.read_bytes())
    return "memory://bounds/a.mcap"


def _summary_bytes(path: Path) -> int:
    # from where the footer says that the summary begins to the footer: 8 bytes of magic and 29 of the footer are behind
    data = path.read_bytes()
    return len(data) - 37 - int.from_bytes(data[-28:-20], "little")


READ: dict[str, tuple[ModuleType, str, int | Callable[[Path], int], Callable[[Path], object]]] = {
    "attachments": (contents, "MAX_ATTACHMENTS", _attachments, open_recording),
    "fields": (provenance, "MAX_FIELDS", 3, lambda _: provenance._fields(_simulation(3))),
    "arrays": (arrays, "MAX_ARRAYS", 3, lambda _: arrays.decode("a", arrays.encode(_many(3)))),
    "files of an archive": (model_files, "MAX_FILES", 3, lambda p: _unpacked(p, [9, 9, 9])),
    "bytes of an archive": (model_files, "MAX_BYTES", 30, lambda p: _unpacked(p, [10, 20])),
    "files of a model": (model_files, "MAX_FILES", 2, lambda p: model_files.pack(_model(p.parent))),
    "bytes of a model": (model_files, "MAX_BYTES", 52, lambda p: model_files.pack(_model(p.parent))),
    "bytes of an archive, decompressed": (model_files, "MAX_ARCHIVE_BYTES", 9, lambda _: _plain(b"123456789")),
    "names": (imported, "_MOST_NAMES", 2, lambda _: imported._texts({"a": np.array(["b", "c"])}, "a")),
    "bodies": (geometry, "MAX_LINKS", 3, lambda _: geometry.look_of({}, _geometry(3, 0))),
    "shapes": (geometry, "MAX_SHAPES", 3, lambda _: geometry.look_of({}, _geometry(1, 3))),
    "triangles": (geometry, "MAX_TRIANGLES", 4, lambda _: geometry.look_of({}, FOUR)),
    "joints": (geometry, "_JOINTS", 2, lambda _: geometry.look_of({}, GOOD)),
    "links": (geometry, "MAX_LINKS", 3, lambda _: geometry.links_of(_robot(3))),
    "a remote file": (remote, "_MOST_BYTES", lambda p: p.stat().st_size, lambda p: open_recording(_remote(p))),
    "the summary": (index, "MAX_SUMMARY_BYTES", _summary_bytes, lambda p: open_recording(_remote(p))),
    "environments": (configuration, "MAX_ENVS", 2, lambda p: open_recording(p).configuration),
}  # fmt: skip


@pytest.mark.parametrize("what", READ)
def test_what_is_as_large_as_the_bound_is_read(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read what is exactly as large as the bound, and refuse it where the bound is less by a byte or a thing."""
    module, name, size, read = READ[what]
    path = write_recording(tmp_path, grid(2))
    exact = size if isinstance(size, int) else size(path)
    monkeypatch.setattr(module, name, exact)
    read(path)
    monkeypatch.setattr(module, name, exact - 1)
    with pytest.raises(
        GsbError, match="more than|at most|not a whole number from 1 to 1:|none that is drawn|no list of names"
    ):
        read(path)


CONFIGURATION: dict[str, Any] = {
    "simulator": "mujoco", "scene": "free-fall", "n_env": 4, "dt": 0.01, "steps": 10, "stride": 1, "warmup": 1,
    "timed_steps": 5, "phases": ["timed", "capture"], "seed": 0, "run_index": 0, "view": [0], "snapshots": [1],
    "timeout": 1.0,
}  # fmt: skip
SIMULATION: dict[str, Any] = {
    "version": "1", "device": "cpu", "buffers": [{"name": "b", "asked": 1, "per": "env"}],
    "overflow_bits": [{"bit": 1, "name": "o", "fatal": True}],
}  # fmt: skip
TOSS_SET: dict[str, Any] = {"source": "s", "sha256": "0", "rows": [5], "length_scale": 1.0, "corrections": []}


def _simulation_of(record: dict[str, Any]) -> object:
    return provenance.Simulation.from_json(json.dumps(record))


NUMBERS: list[tuple[Callable[[dict[str, Any]], object], dict[str, Any], str, float, float, float]] = [
    *(
        (configuration.RunConfiguration.from_json, CONFIGURATION, path, low, high, step)
        for path, low, high, step in (
            ("n_env", 1, 1 << 24, 1), ("dt", 1e-9, 1e9, 1e-10), ("steps", 1, 1 << 40, 1), ("stride", 1, 1 << 40, 1),
            ("warmup", 0, 1 << 40, 1), ("timed_steps", 1, 1 << 40, 1), ("seed", -(1 << 63), 1 << 64, 1),
            ("run_index", 0, 1 << 40, 1), ("view/0", 0, 3, 1), ("snapshots/0", 0, 1 << 40, 1),
            ("timeout", 0, 1e9, 1e-3),
        )
    ),
    (_simulation_of, SIMULATION, "buffers/0/asked", 0, 1 << 63, 1),
    (_simulation_of, SIMULATION, "overflow_bits/0/bit", 0, 31, 1),
    (lambda r: tosses.TossSet.from_json(json.dumps(r).encode(), 1), TOSS_SET, "rows/0", 2, 1 << 40, 1),
    (lambda r: tosses.TossSet.from_json(json.dumps(r).encode(), 1), TOSS_SET, "length_scale", 0.1, 10.0, 1e-3),
]  # fmt: skip


def _with(record: dict[str, Any], path: str, value: float) -> dict[str, Any]:
    found: Any = json.loads(json.dumps(record))
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("/"))
    at = found
    for part in parents:
        at = at[part]
    at[last] = value
    return dict(found)


@pytest.mark.parametrize(("read", "record", "path", "low", "high", "step"), NUMBERS, ids=[n[2] for n in NUMBERS])
def test_numbers_of_a_record_have_bounds(
    read: Callable[[dict[str, Any]], object], record: dict[str, Any], path: str, low: float, high: float, step: float
) -> None:
    """Read the lowest and the highest value that the format allows, and name a value that is just beyond."""
    for value in (low, high):
        read(_with(record, path, value))
    for value in (low - step, high + max(step, high * 1e-9 * isinstance(high, float))):
        with pytest.raises(GsbError, match=f"{path.replace('/0', '').split('/')[-1]} is not"):
            read(_with(record, path, value))


@pytest.mark.parametrize(
    ("most", "read"),
    [
        (20, lambda text: StateField.from_json({"dtype": text})),
        (20, lambda text: geometry.look_of({}, changed("bodies.2.joints.0.kind", text))),
        (40, lambda text: configuration.RunConfiguration.from_json({**CONFIGURATION, "keep": text})),
        (40, lambda text: decompression.decompress(text, memoryview(b""), 0)),
        (60, lambda text: model_files._safe(f"/{text[1:]}")),
    ],
)
def test_how_much_of_a_text_is_quoted(most: int, read: Callable[[str], object]) -> None:
    """Show the beginning of a text that cannot be, however long it is."""
    with pytest.raises((GsbError, ValueError)) as refused:
        read("x" * 1000)
    assert str(refused.value).replace("/", "x").count("x" * most) == 1
    assert "x" * (most + 1) not in str(refused.value).replace("/", "x")
