"""A model file with every file that it refers to, as one archive that names no path outside itself.

MJCF (``<mujoco>``) and URDF (``<robot>``) say in attributes which files they include: other documents, meshes, height
fields, textures. Where MuJoCo may look in several folders, every file that lies in one of them belongs to the closure.
An archive that this module writes is not compressed and has no dates, so that the same files are the same bytes, and
their SHA-256 is the model's identity. The model's own file comes first. A recording has a large archive as one frame of
Zstandard; the bytes of a frame depend on the version of zstd, and are no identity of the model.
"""

from __future__ import annotations

import io
import os
import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.mcap import decompression
from gpusimbench.schemas.writing import write_file

MODEL = "model.zip"
"""Attachment with a closure."""

COMPRESSED = "model.zip.zst"
"""Attachment with a closure as one Zstandard frame, which announces its size."""

MAX_FILES = 4096
"""Files of a closure."""

MAX_BYTES = 256 << 20
"""Of the files of a closure together."""

MAX_ARCHIVE_BYTES = MAX_BYTES + (64 << 20)
"""Of an archive, decompressed: the files, and of each file twice its path (4096 bytes at most) and a head."""

_LEVEL = 3  # of Zstandard; docs/model-files.md has what other levels take
_WORTH_BYTES = 64 << 10  # to be saved: a smaller archive stays one that earlier versions replay and any tool opens

_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback", "filename")
_FOLDERS = ("meshdir", "texturedir", "assetdir")  # of <compiler>


def scene_name(path: Path, taken: Collection[str]) -> str:
    """What the scene of a model file is called: the file's name, in characters that file names have everywhere.

    taken  names of registered scenes
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", path.stem).strip("-.") or "model"
    return f"{name}-model" if name in taken else name


def pack(path: Path) -> bytes:
    """The archive of a model's file and of all files that it refers to.

    UsageError where a file is missing, lies at an absolute path, is no XML, or where there is too much.
    """
    if path.suffix.lower() == ".mjb":
        raise UsageError(
            f"{path} is a compiled model (.mjb), which cannot be recorded; give the MJCF or URDF that it was made from"
        )
    if path.exists() and not path.is_file():
        raise UsageError(f"{path} is a folder or a pipe; give a file with the model, MJCF or URDF")
    main = Path(os.path.abspath(path))
    found = _Search(main).files()
    root = Path(os.path.commonpath([file.parent for file in found]))
    stream = io.BytesIO()
    total = 0
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for file in [main, *sorted(found - {main})]:
            try:
                data = file.read_bytes()
            except OSError as error:
                raise UsageError(f"{path}: {file} cannot be read: {error.strerror}") from None
            total += len(data)
            if total > MAX_BYTES:
                raise UsageError(f"{path} and the files that it refers to have more than {MAX_BYTES >> 20} MiB")
            archive.writestr(zipfile.ZipInfo(file.relative_to(root).as_posix()), data)
    return stream.getvalue()


def attachment(archive: bytes) -> tuple[str, str, bytes]:
    """Name, media type and bytes of what a recording attaches of an archive: a frame where that is much smaller."""
    import zstandard

    frame = zstandard.ZstdCompressor(level=_LEVEL).compress(archive)
    if len(archive) - len(frame) < _WORTH_BYTES:
        return MODEL, "application/zip", archive
    return COMPRESSED, "application/zstd", frame


def plain(name: str, data: bytes) -> bytes:
    """The bytes of an attachment before they were compressed: an archive where the name is COMPRESSED, else `data`.

    DamagedRecording where the attachment is not one frame that announces at most MAX_ARCHIVE_BYTES and has as many.
    """
    if name != COMPRESSED:
        return data
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_ARCHIVE_BYTES:
            announced = f"{size} bytes" if size >= 0 else "no size"
            raise ValueError(f"it announces {announced}, and at most {MAX_ARCHIVE_BYTES} bytes are read")
        return decompression.decompress("zstd", memoryview(data), size).tobytes()
    except (zstandard.ZstdError, ValueError) as error:
        raise DamagedRecording(f"{COMPRESSED}: {error}") from None


def unpack(data: bytes, folder: Path) -> Path:
    """Write the files of an archive into an empty folder; returns the model's own file.

    DamagedRecording where the archive is none, names a path outside the folder, is too large, or where the model refers
    to a file that is not in it: nothing that MuJoCo reads of it lies elsewhere.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if not 0 < len(members) <= MAX_FILES or sum(member.file_size for member in members) > MAX_BYTES:
                raise DamagedRecording(f"{MODEL} has no files, more than {MAX_FILES}, or more than {MAX_BYTES} bytes")
            names = [_safe(member.filename) for member in members]
            if len(set(names)) < len(names):
                raise DamagedRecording(f"{MODEL} has two files of one name")
            for member, name in zip(members, names, strict=True):
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as stream:
                    content = stream.read(member.file_size)  # no more is decompressed, whatever is in it
                write_file(target, content, durable=False)
    except DamagedRecording:
        raise
    except Exception as error:  # zipfile raises what it likes, and a name may be taken by a folder
        raise DamagedRecording(f"{MODEL} is no archive of files: {' '.join(str(error).split())}") from None
    main = folder / names[0]
    try:
        inside = Path(os.path.abspath(folder))
        if strange := sorted(file for file in _Search(main).files() if not file.is_relative_to(inside)):
            raise UsageError(f"it refers to {strange[0]}, which lies outside")
    except UsageError as error:
        raise DamagedRecording(f"{MODEL}: {error}") from None
    return main


def _safe(name: str) -> PurePosixPath:
    path = PurePosixPath(name)
    if not name or not name.isprintable() or "\\" in name or ":" in name or path.is_absolute() or ".." in path.parts:
        raise DamagedRecording(f"{MODEL} names a file that may lie outside it: {name[:60]!r}")
    return path


@dataclass
class _Search:
    """Which files a model refers to."""

    main: Path
    _found: set[Path] = field(default_factory=set)

    def files(self) -> set[Path]:
        """All of them, absolute, the model's own included; UsageError as of pack."""
        self._model(self.main)
        return self._found

    def _model(self, path: Path) -> None:
        # a document with those that it includes: all that one of them says of folders is true of all
        documents = [path]
        elements: list[tuple[Path, ET.Element]] = []
        unread: set[ET.Element] = set()
        for document in documents:
            self._add(document)
            root = _parsed(document)
            unread |= _shown_only(root)
            for element in root.iter():
                elements.append((document, element))
                if element.tag == "include":
                    for name in _references(element):
                        included = self._existing(document, name, (path.parent, document.parent))
                        documents += [file for file in included if file not in documents]
        folders = {
            element.attrib[kind] for _, element in elements if element.tag == "compiler" for kind in _FOLDERS
            if kind in element.attrib
        }  # fmt: skip
        if any(element.get("discardvisual", "true") != "true" for _, element in elements if element.tag == "compiler"):
            unread.clear()
        assets = [path.parent / folder for folder in ("", *sorted(folders))]
        for document, element in elements:
            for name in _references(element) if element.tag != "include" and element not in unread else ():
                last = Path(name).name  # a path may be stripped: by strippath, and always in URDF
                places = [place / text for place in (*assets, document.parent) for text in (name, last)]
                for file in self._existing(document, name, (), places):
                    if element.tag == "model" and file not in self._found:
                        self._model(file)
                    self._add(file)

    def _add(self, file: Path) -> None:
        self._found.add(file)
        if len(self._found) > MAX_FILES:
            raise UsageError(f"{self.main} refers to more than {MAX_FILES} files")

    def _existing(self, document: Path, name: str, bases: tuple[Path, ...], places: Sequence[Path] = ()) -> list[Path]:
        if Path(name).is_absolute() or "://" in name or "\\" in name:
            ros = name.startswith("package://")
            raise UsageError(
                f"{document} refers to {name}; a model that travels in a recording names its files by paths relative "
                f"to itself{': MuJoCo does not know where packages of ROS lie, so write such a path' if ros else ''}"
            )
        there = [Path(os.path.normpath(place)) for place in (*(base / name for base in bases), *places)]
        there = list(dict.fromkeys(place for place in there if place.is_file()))
        if not there:
            raise UsageError(f"{document} refers to {name}, and there is no such file")
        return there


def _parsed(path: Path) -> ET.Element:
    try:
        data = path.read_bytes()
        if b"<!DOCTYPE" in data:  # entities may name files, and MuJoCo's parser knows none
            raise UsageError(f"{path} has a DOCTYPE, which models do not need; remove it")
        return ET.fromstring(data)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from None
    except ET.ParseError as error:
        raise UsageError(f"{path} is no XML: {error}") from None


def _shown_only(root: ET.Element) -> set[ET.Element]:
    """What MuJoCo does not open of a URDF file by default (discardvisual): what is only drawn."""
    if root.tag != "robot":
        return set()
    return {element for kind in ("visual", "material") for drawn in root.iter(kind) for element in drawn.iter()}


def _references(element: ET.Element) -> list[str]:
    return [text for name in _FILES if (text := element.attrib.get(name, "").strip())]
