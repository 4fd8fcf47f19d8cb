"""Where a set is: in a folder of this machine, or at an address."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from urllib.parse import quote

from gpusimbench.evaluator.read.addresses import fetched
from gpusimbench.evaluator.share.dataset.contents import MAX_FILES, Found, find
from gpusimbench.schemas.errors import Unreachable, UsageError
from gpusimbench.schemas.location import Location, Place, chain


class SetPlace(ABC):
    """The files of a set, by their paths relative to it.

    fetched_bytes  that came from elsewhere so far
    """

    fetched_bytes = 0

    @abstractmethod
    def read(self, path: str, most: int) -> bytes:
        """A small file; Unreachable where there is none, or where it has more than `most` bytes."""

    @abstractmethod
    def size(self, path: str) -> int:
        """The size of a file [byte]; Unreachable where there is none."""

    @abstractmethod
    def local(self, path: str, size: int) -> AbstractContextManager[Path]:
        """The file on this machine's disk as long as the block lasts; Unreachable where it has another size."""

    @abstractmethod
    def names(self) -> Found | str:
        """All that is there, or why that cannot be told."""


def place_of(given: Place) -> SetPlace:
    """The set in a folder or at an address; UsageError where it is neither."""
    if isinstance(given, Location):
        return _Elsewhere(given)
    if not given.is_dir():
        raise UsageError(f"{given} is no folder: name the folder of a set, or its address")
    return _Folder(given)


class _Folder(SetPlace):
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._found = find(folder)
        self._files = frozenset(self._found.files)

    def read(self, path: str, most: int) -> bytes:
        if self.size(path) > most:
            raise Unreachable(f"{path} is larger than the {most} bytes that are read")
        try:
            with (self._folder / path).open("rb") as stream:
                return stream.read(most)
        except OSError as error:
            raise Unreachable(f"{path} cannot be read: {error.strerror}") from None

    def size(self, path: str) -> int:
        if path not in self._files:  # nor is a link followed
            raise Unreachable(f"{path} is not there")
        try:
            return (self._folder / path).stat().st_size
        except OSError as error:
            raise Unreachable(f"{path} cannot be read: {error.strerror}") from None

    @contextmanager
    def local(self, path: str, size: int) -> Iterator[Path]:
        if (found := self.size(path)) != size:
            raise Unreachable(f"{path} has {found} bytes, not {size}")
        yield self._folder / path

    def names(self) -> Found | str:
        return self._found


class _Elsewhere(SetPlace):
    def __init__(self, base: Location) -> None:
        self._base = base

    def read(self, path: str, most: int) -> bytes:
        size = self.size(path)
        if size > most:
            raise Unreachable(f"{path} has {size} bytes, more than the {most} that are read")
        with self.local(path, size) as copy:
            return copy.read_bytes()

    def size(self, path: str) -> int:
        from gpusimbench.schemas.remote.file import RemoteFile

        return int(RemoteFile(child(self._base, path)).size)

    @contextmanager
    def local(self, path: str, size: int) -> Iterator[Path]:
        with fetched(child(self._base, path), size=size) as copy:
            self.fetched_bytes += size
            yield copy

    def names(self) -> Found | str:
        if self._base.url.lower().startswith(("http://", "https://")):
            return "a web server shows no list of its files that can be relied on"
        from gpusimbench.schemas.remote.file import matching

        try:
            names = [found.url for found in matching(child(self._base, "**"), MAX_FILES)]
        except Unreachable as error:
            return str(error)
        root = min((name for name in names if name.endswith("/manifest.json")), key=len, default="")
        if not root:
            return "the list of its files does not name its manifest"
        below = root.removesuffix("manifest.json")
        paths = {name.removeprefix(below).rstrip("/") for name in names if name.startswith(below)}
        # a list tells folders, too: what has something below it
        folders = {path.rpartition("/")[0] for path in paths}
        hidden = {path for path in paths if any(part.startswith(".") for part in path.split("/"))}
        return Found(tuple(sorted(paths - folders - hidden - {""})), (), tuple(sorted(hidden)))


def child(base: Location, path: str) -> Location:
    """The address of a file in the folder at an address; a query, such as a signature, stays behind it."""
    first, *behind = chain(base.url)
    query = ""
    if first.lower().startswith(("http://", "https://")):
        first, mark, query = first.partition("?")
        query, path = mark + query, quote(path, safe="/*")
    joint = "" if first.endswith("/") else "/"
    return Location("::".join([f"{first}{joint}{path}{query}", *behind]))
