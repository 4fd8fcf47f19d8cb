"""A web server of this machine that counts what it is asked for, and can misbehave."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from gzip import compress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Lock, Thread
from typing import Any
from zlib import crc32


@dataclass
class Web:
    """What the server has and does.

    files     by path, without the leading slash
    ranges    whether parts are given
    status    of an answer with a part
    packed    whether parts are compressed, though nobody asked for it
    more      bytes of zero behind each part
    cut       bytes of an answer after which the connection breaks; None: never
    silent    whether it never answers; the same where only parts are asked for, for "parts"
    drip_s    between two bytes of an answer to a part; 0: they come at once
    says      size that it announces of every file, whatever it has
    redirects where it sends whoever asks for a path
    requests  the parts that were asked for: path, first and last byte (None: all of it)
    sent      bytes of all answers
    """

    files: dict[str, bytes] = field(default_factory=dict)
    ranges: bool = True
    status: int = 206
    packed: bool = False
    more: int = 0
    cut: int | None = None
    silent: bool | str = False
    drip_s: float = 0.0
    says: int | None = None
    redirects: dict[str, str] = field(default_factory=dict)
    closed: Event = field(default_factory=Event)
    requests: list[tuple[str, tuple[int, int] | None]] = field(default_factory=list)
    sent: int = 0
    address: str = ""
    lock: Lock = field(default_factory=Lock)

    def forget(self) -> None:
        """Count from zero."""
        self.requests.clear()
        self.sent = 0


@contextmanager
def serving() -> Iterator[Web]:
    """A server, until the block ends."""
    web = Web()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_HEAD(self) -> None:
            self._answer(send=False)

        def do_GET(self) -> None:
            self._answer(send=True)

        def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
            pass

        def _answer(self, *, send: bool) -> None:
            path = self.path.partition("?")[0].lstrip("/")
            if web.silent is True or (web.silent == "parts" and "Range" in self.headers):
                web.closed.wait()
                self.close_connection = True
                return
            if path in web.redirects:
                with web.lock:
                    web.requests.append((path, None))
                self.send_response(302)
                self.send_header("Location", web.redirects[path])
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            if path == "" or path.endswith("/"):
                names = [name.removeprefix(path) for name in web.files if name.startswith(path)]
                content = "".join(f'<a href="{name}">{name}</a>' for name in names).encode()
            elif path in web.files:
                content = web.files[path]
            else:
                self.send_error(404)
                return
            asked = re.match(r"bytes=(\d+)-(\d+)", self.headers.get("Range", "")) if web.ranges else None
            part, total = content, len(content)
            if asked:
                first, last = int(asked[1]), min(int(asked[2]), total - 1)
                part = content[first : last + 1]
                self.send_response(web.status)
                self.send_header("Content-Range", f"bytes {first}-{last}/{total}")
            else:
                self.send_response(200)
            if asked and web.packed:
                part = compress(part)
                self.send_header("Content-Encoding", "gzip")
            if asked:
                part += bytes(web.more)
            self.send_header("Content-Length", str(len(part) if web.says is None or asked else web.says))
            self.send_header("ETag", f'"{crc32(content)}"')
            self.end_headers()
            if not send:
                return
            with web.lock:
                web.requests.append((path, (int(asked[1]), int(asked[2])) if asked else None))
            if web.cut is not None and len(part) > web.cut:
                self.wfile.write(part[: web.cut])
                self.close_connection = True
                return
            try:
                for at in range(len(part)) if web.drip_s else ():
                    self.wfile.write(part[at : at + 1])
                    if web.closed.wait(web.drip_s):
                        return
                self.wfile.write(part[len(part) if web.drip_s else 0 :])
            except OSError:  # whoever asked does not want it any more
                self.close_connection = True
                return
            with web.lock:
                web.sent += len(part)

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, request: Any, client_address: Any) -> None:
            pass  # connections that the other side closed

    server = Server(("127.0.0.1", 0), Handler)
    web.address = f"http://127.0.0.1:{server.server_address[1]}"
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield web
    finally:
        web.closed.set()
        server.shutdown()
        server.server_close()
        thread.join()
