"""A part of a file on a web server: what was asked for, or an error, and never more bytes than that."""

from __future__ import annotations

import re
from typing import Any

_AT_ONCE = 1 << 20


class WrongAnswer(Exception):
    """A server answered with something else than what was asked for; the message says with what."""


def web_part(system: Any, path: str, begin: int, end: int) -> bytes:
    """The bytes of a file from `begin` up to `end`; fewer where the connection ends early.

    system  fsspec's HTTPFileSystem, which must not decompress

    WrongAnswer where the answer is not that part; whatever aiohttp raises.
    """
    from fsspec.asyn import sync

    data: bytes = sync(system.loop, _part, system, path, begin, end)
    return data


async def _part(system: Any, path: str, begin: int, end: int) -> bytes:
    session = await system.set_session()
    headers = {**system.kwargs.get("headers", {}), "Range": f"bytes={begin}-{end - 1}"}
    async with session.get(system.encode_url(path), headers=headers) as answer:
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
