"""A part of a file on a web server: what was asked for, or an error, never more bytes than that, and from nowhere else.

A server may send whoever asks it elsewhere, as those of large sets do to their stores. It may not send them to what
only this machine or its network can reach: what answers there was meant for others.
"""

from __future__ import annotations

import ipaddress
import re
from typing import Any
from urllib.parse import SplitResult, urljoin, urlsplit

from gpusimbench.schemas.location import shown

_AT_ONCE = 1 << 20
_CONNECT_S = 15.0
LIST_S = 300.0  # for any request that has no limit of its own
_MOST_LISTED = 16 << 20  # bytes of a page that lists files
_PORTS = {"http": 80, "https": 443}


class WrongAnswer(Exception):
    """A server answered with something else than what was asked for; the message says with what."""


def web_part(system: Any, path: str, begin: int, end: int, limit_s: float) -> bytes:
    """The bytes of a file from `begin` up to `end`; fewer where the connection ends early.

    system   fsspec's HTTPFileSystem with web_options
    limit_s  after which the request is ended [s]

    WrongAnswer where the answer is not that part; whatever aiohttp raises.
    """
    from fsspec.asyn import sync

    data: bytes = sync(system.loop, _part, system, path, begin, end, limit_s)
    return data


def web_options() -> dict[str, Any]:
    """What fsspec's HTTPFileSystem is made with, so that servers do nothing but answer."""
    import aiohttp

    return {
        "headers": {"Accept-Encoding": "identity"},  # parts of the file, not of what a server packs
        "get_client": _client,
        "client_kwargs": {
            "auto_decompress": False,  # a few bytes may become any number
            "timeout": aiohttp.ClientTimeout(total=LIST_S, sock_connect=_CONNECT_S),
        },
    }


async def _client(**given: Any) -> Any:
    # a session that looks at every redirection before it follows it, and connects to the addresses that it looked at
    import aiohttp
    from aiohttp.abc import AbstractResolver

    class Resolver(AbstractResolver):
        def __init__(self) -> None:
            self._inner = aiohttp.DefaultResolver()
            self._known: dict[tuple[str, int, Any], Any] = {}

        async def resolve(self, host: str, port: int = 0, family: Any = 0) -> Any:
            key = host, port, family
            if key not in self._known:
                self._known[key] = await self._inner.resolve(host, port, family)
            return self._known[key]

        async def close(self) -> None:
            await self._inner.close()

    class Answer(aiohttp.ClientResponse):
        async def read(self) -> bytes:
            # whole, as a list of files is
            if self._body is None:
                parts, size = [], 0
                while part := await self.content.read(_AT_ONCE):
                    parts.append(part)
                    size += len(part)
                    if size > _MOST_LISTED:
                        self.close()
                        raise WrongAnswer(f"the server lists more than the {_MOST_LISTED} bytes that are read")
                self._body = b"".join(parts)
            return self._body

    resolver = Resolver()
    connector = aiohttp.TCPConnector(resolver=resolver)

    async def public(url: SplitResult) -> bool:
        host, port = url.hostname or "", url.port or _PORTS.get(url.scheme, 0)
        try:
            found = [ipaddress.ip_address(host)]
        except ValueError:
            # as the connector asks, so that it finds the same
            found = [ipaddress.ip_address(one["host"]) for one in await resolver.resolve(host, port, connector.family)]
        return bool(found) and all(map(is_public, found))

    async def redirected(_session: Any, _context: Any, told: Any) -> None:
        begin = urlsplit(str(told.url))
        headers = told.response.headers
        end = urlsplit(urljoin(str(told.url), headers.get("Location") or headers.get("URI") or ""))
        if same_server(begin, end):
            return
        if not (end.scheme == "https" and await public(begin) and await public(end)):
            raise WrongAnswer(
                f"the server sends the reader to {shown(end.geturl())}, which is another server and not one that is "
                "followed; give that address, if it is right"
            )

    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(redirected)
    given.pop("loop", None)
    return aiohttp.ClientSession(connector=connector, response_class=Answer, trace_configs=[trace], **given)


def same_server(one: SplitResult, other: SplitResult) -> bool:
    """Whether two addresses have the same scheme, host and port, or the other is the same host's encrypted one."""
    a, b = ((url.scheme, url.hostname, url.port or _PORTS.get(url.scheme)) for url in (one, other))
    return a == b or (a == ("http", a[1], 80) and b == ("https", a[1], 443))


def is_public(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether an address is one of the whole internet, and not of this machine or its network."""
    inner = getattr(address, "ipv4_mapped", None) or getattr(address, "sixtofour", None)
    return address.is_global and not address.is_multicast and (inner is None or is_public(inner))


async def _part(system: Any, path: str, begin: int, end: int, limit_s: float) -> bytes:
    import aiohttp

    session = await system.set_session()
    headers = {**system.kwargs.get("headers", {}), "Range": f"bytes={begin}-{end - 1}"}
    timeout = aiohttp.ClientTimeout(total=limit_s, sock_connect=session.timeout.sock_connect)
    async with session.get(system.encode_url(path), headers=headers, timeout=timeout) as answer:
        answer.raise_for_status()
        _check(answer.status, answer.headers, begin)
        parts, size = [], 0
        while size <= end - begin and (part := await answer.content.read(min(_AT_ONCE, end - begin + 1 - size))):
            parts.append(part)
            size += len(part)
        if size > end - begin:
            if answer.status == 206:
                raise WrongAnswer(f"the server sends more than the {end - begin} bytes that it was asked for")
            answer.close()  # a whole file, of which the beginning was wanted
        return b"".join(parts)[: end - begin]


def _check(status: int, headers: Any, begin: int) -> None:
    packed = headers.get("Content-Encoding", "identity").strip().lower()
    if packed not in ("", "identity"):
        raise WrongAnswer(f"the server packs its answers ({packed[:40]}); download the file")
    if status == 206:
        told = re.match(r"bytes (\d{1,20})-", headers.get("Content-Range", ""))
        if told is None or int(told[1]) != begin:
            raise WrongAnswer(f"the server gives another part than the one asked for, from byte {begin} on")
    elif status != 200 or begin:
        raise WrongAnswer("the server gives files only as a whole; download it")
