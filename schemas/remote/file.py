"""A file elsewhere, read in parts through fsspec, with a cache of bounded size.

A part costs a request and the time that it takes to answer; so what is asked for is rounded to blocks, blocks that lie
beside each other are one request, and whoever reads on from where the last request ended is given more at once.
"""

from __future__ import annotations

import os
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, TypeVar
from urllib.parse import unquote

from gpusimbench.schemas.errors import DamagedRecording, Unreachable
from gpusimbench.schemas.location import Location, chain, is_address, redacted
from gpusimbench.schemas.remote.web import LIST_S, WrongAnswer, web_options, web_part
from gpusimbench.schemas.source import Source

_T = TypeVar("_T")

_BLOCK = 64 << 10
_CACHED_BYTES = 32 << 20
_AHEAD_BYTES = 4 << 20  # in one request, of whoever reads on
_PIECE_BYTES = 16 << 20  # of a file that is read from its beginning to its end
_WORKERS = 8
_ANSWER_S = 30.0
_FILE_S = 60.0
_END_S = 5.0
_LEAST_RATE = 32 << 10  # [byte/s]; time that bytes may take is added to the two above
_MOST_BYTES = 1 << 44  # no recording has more
_CONFIRM_S = 1.0  # at most this often, the server is asked whether the file is still the same
_WEB = ("http", "https")
_IDENTITY = ("size", "ETag", "etag", "Content-MD5", "Last-Modified", "LastModified", "mtime", "created", "generation")
"""What file systems tell of a file that changes when the file does."""


class TooSlow(Exception):
    """What was asked for did not come in time; the message says what was waited for."""


class Patience:
    """The time that is left for one file. Only waiting counts, and requests at the same time count once.

    answer_s  for one request, besides what its bytes may take [s]
    file_s    for all requests together, besides what their bytes may take [s]
    rate      at which bytes have to come at least [byte/s]
    """

    def __init__(self, answer_s: float, file_s: float, rate: float) -> None:
        self._answer_s, self._file_s, self._rate = answer_s, file_s, rate
        self._lock = Lock()
        self._waiting = 0  # requests
        self._since = 0.0  # when the first of them began
        self._waited = 0.0  # before
        self._bytes = 0
        self._over = ""

    def limit(self, size: int) -> float:
        """For how long a request of so many bytes is waited for from now on [s]."""
        with self._lock:
            now = time.monotonic() - self._since if self._waiting else 0.0
            left = self._file_s + self._bytes / self._rate - self._waited - now
            return max(0.0, min(self._answer_s + size / self._rate, left))

    def call(self, request: Callable[[], _T], size: int) -> _T:
        """What a request of `size` bytes returns or raises. TooSlow where that takes too long, and from then on.

        A request that cannot be ended is left alone, in a thread that does not keep the process alive.
        """
        limit = self.limit(size)
        if self._over or not limit:
            raise TooSlow(self._over or self._slow())
        outcome: SimpleQueue[tuple[list[_T], BaseException | None]] = SimpleQueue()

        def ask() -> None:
            try:
                outcome.put(([request()], None))
            except BaseException as error:
                outcome.put(([], error))

        self._begin()
        try:
            Thread(target=ask, daemon=True).start()
            found, error = outcome.get(timeout=limit)
        except Empty:
            whole = limit >= self._answer_s + size / self._rate
            self._over = f"no answer within {limit:.3g} s" if whole else self._slow()
            raise TooSlow(self._over) from None
        finally:
            self._end()
        if error is not None:
            raise error
        with self._lock:
            self._bytes += size
        return found[0]

    def _begin(self) -> None:
        with self._lock:
            if not self._waiting:
                self._since = time.monotonic()
            self._waiting += 1

    def _end(self) -> None:
        with self._lock:
            self._waiting -= 1
            if not self._waiting:
                self._waited += time.monotonic() - self._since

    def _slow(self) -> str:
        return f"after {self._file_s:.3g} s of waiting, what comes is slower than {self._rate:.0f} bytes a second"


class RemoteFile(Source):
    """A file that fsspec can read.

    fetched  bytes that were asked for so far
    """

    near = False
    place: Location
    workers = _WORKERS

    def __init__(self, location: Location) -> None:
        self.place = location
        self.fetched = 0
        self._patience = Patience(_ANSWER_S, _FILE_S, _LEAST_RATE)
        self._system, self._path = _file_system(location)
        self._told = self._ask()
        size = self._told.get("size")
        if self._told.get("type") == "directory":
            raise Unreachable(f"cannot read {location}: Is a directory")
        if not isinstance(size, int):
            raise Unreachable(f"cannot read {location} in parts: the server does not say how large it is; download it")
        if not 0 <= size <= _MOST_BYTES:
            raise Unreachable(
                f"cannot read {location}: the server says that it has {size} bytes; at most {_MOST_BYTES} are read"
            )
        self.size = size
        self._asked = time.monotonic()
        self._lock = Lock()
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._next = -1  # block behind the last request
        self._streak = 0  # bytes of the requests that followed each other

    def read(self, begin: int, end: int) -> memoryview:
        """See Source.read."""
        if begin >= end:
            return memoryview(b"")
        if end - begin > _CACHED_BYTES // 2:
            return memoryview(self._fetch(begin, end))
        first, last = begin // _BLOCK, (end - 1) // _BLOCK
        found: dict[int, bytes] = {}
        with self._lock:
            for number in range(first, last + 1):
                if number in self._blocks:
                    self._blocks.move_to_end(number)
                    found[number] = self._blocks[number]
            runs = [self._prolonged(run) for run in _runs(n for n in range(first, last + 1) if n not in found)]
        for run in runs:
            data = self._fetch(run.start * _BLOCK, min(run.stop * _BLOCK, self.size))
            with self._lock:
                for number in run:
                    at = (number - run.start) * _BLOCK
                    found[number] = self._blocks[number] = data[at : at + _BLOCK]
                while len(self._blocks) * _BLOCK > _CACHED_BYTES:
                    self._blocks.popitem(last=False)
        offset = first * _BLOCK
        if first == last:
            return memoryview(found[first])[begin - offset : end - offset]
        joined = b"".join(found[number] for number in range(first, last + 1))
        return memoryview(joined)[begin - offset : end - offset]

    def pieces(self) -> Iterator[bytes]:
        """The whole file, piece by piece; nothing of it is kept."""
        for begin in range(0, self.size, _PIECE_BYTES):
            yield self._fetch(begin, min(begin + _PIECE_BYTES, self.size))
        self.confirm()

    def confirm(self) -> None:
        """See Source.confirm."""
        self._asked = time.monotonic()
        told = self._ask()
        if [told.get(key) for key in _IDENTITY] != [self._told.get(key) for key in _IDENTITY]:
            raise DamagedRecording(f"{self.place}: the file was changed while it was read; try again")

    def _prolonged(self, run: range) -> range:
        # of whoever reads on, as much again as was read so far; the lock is held
        if run.start != self._next:
            self._streak = 0
        blocks = max(len(run), min(self._streak, _AHEAD_BYTES) // _BLOCK)
        stop = min(run.start + blocks, -(-self.size // _BLOCK))
        self._next = stop
        self._streak += (stop - run.start) * _BLOCK
        return range(run.start, stop)

    def _fetch(self, begin: int, end: int) -> bytes:
        try:
            data = self._patience.call(lambda: self._part(begin, end), end - begin)
        except Exception as error:  # each file system has its own
            raise Unreachable(f"cannot read {self.place}: {_reason(error)}") from None
        with self._lock:
            self.fetched += len(data)
        if len(data) != end - begin or time.monotonic() - self._asked > _CONFIRM_S:
            self.confirm()
        if len(data) != end - begin:
            raise Unreachable(
                f"cannot read {self.place}: {len(data)} bytes came where {end - begin} were asked for, from byte "
                f"{begin} on"
            )
        return bytes(data)

    def _part(self, begin: int, end: int) -> bytes:
        if _is_web(self.place):
            limit = self._patience.limit(end - begin) + _END_S  # the patience ends first, and says why
            return web_part(self._system, self._path, begin, end, limit)
        return bytes(self._system.cat_file(self._path, start=begin, end=end))

    def _ask(self) -> dict[str, Any]:
        def ask() -> dict[str, Any]:
            self._system.invalidate_cache(self._path)
            return dict(self._system.info(self._path))

        try:
            return self._patience.call(ask, 0)
        except Exception as error:
            raise Unreachable(f"cannot read {self.place}: {_reason(error)}") from None


def matching(pattern: Location, most: int) -> list[Location]:
    """The files that an address with wildcards (*, [...]) in its path stands for, sorted; as itself where it has none,
    or where a file has that very name. They keep the query of the address, and what it is chained to.

    Unreachable where the file system cannot tell, or where they are more than `most`.
    """
    first, *behind = chain(pattern.url)
    if not is_address(first) and behind:  # simplecache::https://...
        return [Location(f"{first}::{found.url}") for found in matching(Location("::".join(behind)), most)]
    query = ""
    if _is_web(pattern):
        first, mark, query = first.partition("?")
        query = mark + query
    name = first.partition("://")[2]
    if not any(c in (name.partition("/")[2] if _is_web(pattern) else name) for c in "*["):  # not in [::1]
        return [pattern]
    system, path = _file_system(pattern)
    try:
        patience = Patience(LIST_S, LIST_S, _LEAST_RATE)
        if patience.call(lambda: system.isfile(path), 0):
            return [pattern]
        listed = path.removesuffix(query)
        found = sorted(map(str, patience.call(lambda: system.glob(listed), 0)))
    except Exception as error:
        raise Unreachable(f"cannot list {pattern}: {_reason(error)}") from None
    if not found:
        raise Unreachable(f"cannot list {pattern}: no file there has such a name, or the server shows no list")
    if len(found) > most:
        raise Unreachable(f"{pattern} stands for {len(found)} files, more than the {most} that are read at once")
    if behind:
        scheme = first.partition("://")[0]
        return [Location("::".join([f"{scheme}://{name}", *behind])) for name in found]
    return [Location(f"{system.unstrip_protocol(name)}{query}") for name in found]


def _runs(numbers: Iterable[int]) -> list[range]:
    runs: list[range] = []
    for number in numbers:
        if runs and runs[-1].stop == number:
            runs[-1] = range(runs[-1].start, number + 1)
        else:
            runs.append(range(number, number + 1))
    return runs


def _is_web(location: Location) -> bool:
    return location.url.lower().startswith(tuple(f"{scheme}://" for scheme in _WEB))


def _file_system(location: Location) -> tuple[Any, str]:
    try:
        import fsspec

        if _is_web(location):
            options = web_options()
        else:  # as in zip://a.mcap::https://...
            behind = {part.partition("://")[0] for part in chain(location.url)}
            options = {scheme: web_options() for scheme in behind & {*_WEB}}
        system, path = fsspec.core.url_to_fs(location.url, **options)
        if location.url.lower().startswith("file://") and "%" in path and not system.exists(path):
            path = unquote(path)
    except ImportError as error:
        raise Unreachable(
            f"cannot read {location}: {redacted(str(error))}; pip install 'gpusimbench[remote]' reads https://, other "
            "addresses need the package of their file system: s3fs, gcsfs, adlfs, huggingface_hub"
        ) from None
    except Exception as error:
        raise Unreachable(f"cannot read {location}: {_reason(error)}") from None
    return system, path


def _reason(error: BaseException) -> str:
    # what happened, in words that hold no address with its secrets
    status = getattr(error, "status", None)
    if isinstance(status, int) and status >= 400:  # a web server's answer
        known = {401: ": it wants a login", 403: ": access is refused", 404: ": there is no such file"}
        return f"the server answers {status}{known.get(status, '')}"
    if isinstance(error, FileNotFoundError):
        if error.__cause__ is not None and not isinstance(error.__cause__, FileNotFoundError):
            return _reason(error.__cause__)
        return "there is no such file"
    if isinstance(error, PermissionError):
        return "access is refused"
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, (WrongAnswer, TooSlow)):
        return str(error)
    if type(error).__name__ in ("ClientConnectorError", "ClientConnectorDNSError"):  # of aiohttp; not those of TLS
        host, port, cause = (getattr(error, name, None) for name in ("host", "port", "os_error"))
        number = getattr(cause, "errno", None) or 0
        why = os.strerror(number) if number > 0 else getattr(cause, "strerror", None) or "no answer"
        return f"cannot connect to {host}:{port}: {why}"
    told = redacted(str(error)).strip()
    return f"{type(error).__name__}{': ' if told else ''}{told[:300]}"
