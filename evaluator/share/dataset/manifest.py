"""manifest.json: every file of a set, with its size, its digest, and what a recording was when the set was made."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from platform import python_version
from typing import Any

from gpusimbench import schemas
from gpusimbench.evaluator.compute.cache import version_of
from gpusimbench.evaluator.json_values import dump
from gpusimbench.evaluator.share.dataset.contents import (
    BROKEN,
    DAMAGED,
    INTEGRITY,
    MAX_FILES,
    WHOLE,
    Sum,
    collisions,
    why_not,
)
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, damage_in

MANIFEST = "manifest.json"
SCHEMA_VERSION = 2
"""Of the manifest, and of the columns of the tables that stand beside it."""
KIND = "gpusimbench set of recordings"
"""By which a manifest is told from other files of that name."""

MAX_BYTES = 16 << 20
"""A larger manifest is not read."""

_MAX_FILE_BYTES = 1 << 50
_PACKAGES = ("numpy", "scipy", "numba", "POT", "polars", "mcap", "protobuf")
_OUTCOMES = (WHOLE, BROKEN, DAMAGED)
CHECKSUMS = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)\n")


@dataclass(frozen=True)
class RecordingEntry:
    """What a recording was found to be.

    content_hash  of the recording; empty where it has no end record, or cannot be read
    run_id        empty where it cannot be read
    status        complete, invalid, failed, incomplete; "unreadable" where it is damaged
    reason        why it is not complete
    group         that its metrics stand under; empty where it is in none
    check         what the rules of INTEGRITY came to, one of WHOLE, BROKEN, DAMAGED
    findings      of broken rules
    """

    content_hash: str
    run_id: str
    status: str
    reason: str
    group: str
    check: str
    findings: tuple[str, ...]


@dataclass(frozen=True)
class FileEntry:
    """A file of the set; `recording` is None of a file that is none."""

    path: str
    sum: Sum
    recording: RecordingEntry | None = None


@dataclass(frozen=True)
class Manifest:
    """A set.

    title, licence  as the publisher gave them
    sample_time     at which positions were compared [s]
    identity        of the set's content, see contents.identity
    written_by      versions of what computed the tables
    files           that were published, by path
    written         files that describe them, by path; but for the manifest itself and SHA256SUMS
    """

    title: str
    licence: str
    sample_time: float
    identity: str
    written_by: dict[str, str]
    files: tuple[FileEntry, ...]
    written: tuple[FileEntry, ...]

    @property
    def recordings(self) -> tuple[FileEntry, ...]:
        """The files that are recordings."""
        return tuple(file for file in self.files if file.recording is not None)

    @property
    def sums(self) -> dict[str, Sum]:
        """The sums of all files that the manifest names, by path."""
        return {file.path: file.sum for file in (*self.files, *self.written)}


def versions() -> dict[str, str]:
    """Versions of this project, and of what it computes and writes with."""
    return {"gpusimbench": schemas.__version__, "python": python_version()} | {
        name: found for name in _PACKAGES if (found := version_of(name))
    }


def dump_manifest(manifest: Manifest) -> str:
    """The file's text."""
    return dump({
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "title": manifest.title,
        "licence": manifest.licence,
        "sample_time_s": manifest.sample_time,
        "content_sha256": manifest.identity,
        "rules": INTEGRITY,
        "written_by": manifest.written_by,
        "files": [_record(file) for file in manifest.files],
        "written": [_record(file) for file in manifest.written],
    })  # fmt: skip


def _record(file: FileEntry) -> dict[str, Any]:
    record: dict[str, Any] = {"path": file.path, "bytes": file.sum.bytes, "sha256": file.sum.sha256}
    if file.recording is not None:
        record["recording"] = {**vars(file.recording), "findings": list(file.recording.findings)}
    return record


def is_manifest(data: bytes) -> bool:
    """Whether a file called manifest.json is one of these, whatever else is wrong with it."""
    try:
        return checks.load(MANIFEST, data).get("kind") == KIND if len(data) <= MAX_BYTES else False
    except DamagedRecording:
        return False


def load_manifest(data: bytes, *, older: bool = False) -> Manifest:
    """Read a stranger's manifest; DamagedRecording names the first thing that cannot be.

    older  whether one of an earlier schema version will do: all have these fields, and tables of other columns

    No path in it leads out of the set's folder, and none is there twice, or is another one on some systems.
    """
    if len(data) > MAX_BYTES:
        raise DamagedRecording(f"{MANIFEST} has {len(data)} bytes; at most {MAX_BYTES} are read")
    record = checks.load(MANIFEST, data)
    _check_keys(data)
    if record.get("kind") != KIND:
        raise DamagedRecording(f"{MANIFEST} is not that of a set of recordings: 'gsb-share card' writes one")
    version = record.get("schema_version")
    if version not in range(1 if older else SCHEMA_VERSION, SCHEMA_VERSION + 1):
        raise DamagedRecording(
            f"{MANIFEST} has schema version {json.dumps(version)[:20]}, and {SCHEMA_VERSION} is known here: use the "
            "version of gpusimbench that wrote it, or write it anew with this one: gsb-share card --update"
        )
    with damage_in(MANIFEST):
        manifest = Manifest(
            title=checks.text(record, "title"),
            licence=checks.text(record, "licence"),
            sample_time=checks.number(record, "sample_time_s", 1e-9, 1e9),
            identity=_digest(record, "content_sha256"),
            written_by=checks.text_map(record, "written_by"),
            files=tuple(_entry(one) for one in _few(record, "files")),
            written=tuple(_entry(one) for one in _few(record, "written")),
        )
    _check_paths([file.path for file in (*manifest.files, *manifest.written)])
    return manifest


def _check_keys(data: bytes) -> None:
    # a reader that takes the first of two equal keys sees another manifest than one that takes the last
    def once(pairs: list[tuple[str, Any]]) -> None:
        if len({key for key, _ in pairs}) < len(pairs):
            raise DamagedRecording(f"{MANIFEST} has an object with a key that is there twice")

    json.loads(data, object_pairs_hook=once)


def _check_paths(paths: Sequence[str]) -> None:
    reserved = [MANIFEST, "SHA256SUMS"]
    if twice := collisions([*reserved, *paths]):
        first, second = twice[0]
        raise DamagedRecording(f"{MANIFEST}: {first!r} and {second!r} are one file on some systems")
    if len({*reserved, *paths}) < len(paths) + len(reserved):
        raise DamagedRecording(f"{MANIFEST}: a path is there twice")


def _few(record: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = checks.objects(record, key)
    if len(found) > MAX_FILES:
        raise DamagedRecording(f"{key} has {len(found)} entries; at most {MAX_FILES} are read")
    return found


def _entry(record: dict[str, Any]) -> FileEntry:
    path = checks.text(record, "path")
    if why := why_not(path):
        raise DamagedRecording(f"{path[:80]!r} cannot be the path of a file of the set: {why}")
    told = Sum(checks.whole(record, "bytes", 0, _MAX_FILE_BYTES), _digest(record, "sha256"))
    return FileEntry(path, told, _recording(checks.mapping(record, "recording")) if "recording" in record else None)


def _recording(record: dict[str, Any]) -> RecordingEntry:
    found = RecordingEntry(
        content_hash=checks.text(record, "content_hash"),
        run_id=checks.text(record, "run_id"),
        status=checks.text(record, "status"),
        reason=checks.text(record, "reason"),
        group=checks.text(record, "group"),
        check=checks.text(record, "check"),
        findings=checks.texts(record, "findings"),
    )
    if found.check not in _OUTCOMES:
        raise DamagedRecording(f"check is none of {', '.join(_OUTCOMES)}: {found.check[:40]!r}")
    return found


def _digest(record: dict[str, Any], key: str) -> str:
    text = checks.text(record, key)
    if len(text) != 64 or set(text) - set("0123456789abcdef"):
        raise DamagedRecording(f"{key} is no SHA-256 in hexadecimal: {text[:70]!r}")
    return text


def write_sums(digests: Mapping[str, str]) -> str:
    """The file: a digest [hex], two spaces, and the path, sorted by path. Paths hold no backslash and no line feed."""
    return "".join(f"{digest}  {path}\n" for path, digest in sorted(digests.items()))


def read_sums(text: str) -> dict[str, str]:
    """Digests by path; DamagedRecording names the first line that is none, or names a path for the second time."""
    found: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(keepends=True), start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise DamagedRecording(f"{CHECKSUMS}: line {number} is not a digest, two spaces and a path")
        if match[2] in found:
            raise DamagedRecording(f"{CHECKSUMS}: line {number} names a path for the second time")
        found[match[2]] = match[1]
    return found
