"""What a publisher may not want to publish: paths of home folders, names of users and hosts, addresses of mail."""

from __future__ import annotations

import getpass
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.location import Place

_HOMES = re.compile(
    r"(?:/(?:home|Users|root|data/home|mnt/home)/[^\s\"':;,<>\\]{1,80}|[A-Z]:\\+Users\\+[^\\\s\"]{1,40})"
)
_MAIL = re.compile(r"[A-Za-z0-9._%+-]{1,64}@[A-Za-z0-9-]{1,63}(?:\.[A-Za-z0-9-]{1,63}){1,4}")
_COMMON = {"localhost", "root", "user", "ubuntu", "admin", "test", "home"}
_SHORTEST = 4
_MOST = 20  # of one recording


@dataclass(frozen=True)
class Personal:
    """Something personal that a recording holds.

    what   "path of a home folder", "address of mail", "name of this host", "name of this user"
    text   itself
    where  the attachment
    """

    what: str
    text: str
    where: str


def personal(path: Place) -> list[Personal]:
    """What is found in the attachments of a recording and in what it says of its end; nothing where it is damaged."""
    found: dict[Personal, None] = {}
    with suppress(GsbError):
        recording = Recording(path)
        texts = [(name, recording.attachment(name) or b"") for name in recording.attachment_names()]
        texts.append(("the reason of its end", recording.reason.encode(errors="replace")))
        for where, data in texts:
            for what, text in _in(data.decode(errors="replace")):
                found[Personal(what, text, where)] = None
                if len(found) >= _MOST:
                    break
    return list(found)


def _in(text: str) -> Iterator[tuple[str, str]]:
    for match in _HOMES.finditer(text):
        yield "path of a home folder", match[0]
    for match in _MAIL.finditer(text):
        yield "address of mail", match[0]
    for what, name in _of_this_machine():
        if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text):
            yield what, name


def _of_this_machine() -> Iterator[tuple[str, str]]:
    for what, name in (("name of this host", socket.gethostname()), ("name of this user", _user())):
        if len(name) >= _SHORTEST and name.lower() not in _COMMON:
            yield what, name


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # of a user that nobody knows, as in many a container
        return ""
