"""Where a file is: a path of this machine, or the address of a file elsewhere.

An address is whatever fsspec understands: s3://bucket/run.mcap, hf://datasets/name/set/run.mcap, https://..., memory://.
It may carry a password or a signature; those are for the server alone, and no text that this project writes has them.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import quote, unquote

_WEB = ("http", "https")
_CHAINED = re.compile(r"::(?=[a-z][a-z0-9+.-]*://)", re.IGNORECASE)  # as in zip://a.mcap::https://...
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]{0,31}://\S*", re.IGNORECASE)  # bounded: texts of strangers may be long


class Location:
    """The address of a file. As a text, what may be shown of it; no dataclass, whose fields anything may write out.

    url  the whole address, with whatever gives access
    """

    __slots__ = ("_url",)

    def __init__(self, url: str) -> None:
        self._url = url

    @property
    def url(self) -> str:
        """See Location."""
        return self._url

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Location) and self._url == other._url

    def __hash__(self) -> int:
        return hash(self._url)

    def __str__(self) -> str:
        return shown(self.url)

    def __repr__(self) -> str:
        return f"<Location {self}>"

    @property
    def name(self) -> str:
        """The name of the file, without its folder."""
        first = next((part for part in _CHAINED.split(str(self)) if is_address(part)), str(self))
        return _visible(unquote(first.rstrip("/").rpartition("/")[2])) or str(self)


Place = Path | Location


def is_address(text: str) -> bool:
    """Whether a text is the address of something rather than a path."""
    return "://" in text


def place(given: str | Path | Location) -> Place:
    """A path, or a location where an address is given."""
    if isinstance(given, str):
        return Location(given) if is_address(given) else Path(given)
    return given


def chain(address: str) -> list[str]:
    """The parts of a chained address, such as zip://a.mcap::https://..."""
    return _CHAINED.split(address)


def shown(address: str) -> str:
    """An address without user, password, query and fragment, and without what a terminal would obey."""
    return "::".join(map(_without_secrets, _CHAINED.split(address)))


def shown_argument(argument: str) -> str:
    """An argument of a command, the address in it as it may be shown."""
    found = _ADDRESS.search(argument)
    return argument if found is None else argument[: found.start()] + shown(argument[found.start() :])


def redacted(text: str) -> str:
    """A text with every address in it as it may be shown."""
    return _ADDRESS.sub(lambda found: shown(found[0]), text)


def _without_secrets(address: str) -> str:
    scheme, found, rest = address.partition("://")
    if not found:
        return _visible(scheme.partition("?")[0])
    if scheme.lower() in _WEB:
        # A password may hold / ? and # that nobody escaped; what precedes the last @ may be one.
        before, _, rest = rest.rpartition("@")
        if "?" in before or "#" in before:
            return _visible(f"{scheme}://...")  # nor what follows, which may be the rest of a query
        rest = rest.partition("#")[0]
    rest = rest.partition("?")[0]
    authority, slash, path = rest.partition("/")
    return _visible(f"{scheme}://{authority.rpartition('@')[2]}{slash}{path}")


def _visible(text: str) -> str:
    return "".join(c if c.isprintable() else quote(c, errors="replace") for c in text)
