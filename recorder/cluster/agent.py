"""What a worker of Ray does on a node: it starts one process at a time and passes on what that says.

Ray sends this class as it is, by value: a node needs Python to run it, and nothing of this project. Calls may be made
twice, where the network lost an answer; so each does the same the second time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

_KEPT_BYTES = 16 << 20  # of lines; a process that says more is not ours
_SILENCE_S = 120.0  # after which a caller is told that there is nothing new


class Agent:
    """One process of this node's Python: its lines, its input, and pieces of files."""

    def __init__(self) -> None:
        self._key = ""
        self._process: subprocess.Popen[str] | None = None
        self._lines: list[str] = []
        self._ended = False
        self._news = threading.Condition()

    def ready(self) -> bool:
        """Answer, once there is an agent."""
        return True

    def begin(self, key: str, arguments: list[str], first: str) -> None:
        """Start the process with these arguments and this first line of input; a second time with one key: nothing."""
        with self._news:
            if key == self._key:
                return
            self.end()
            self._key, self._lines, self._ended = key, [], False
            self._process = subprocess.Popen(
                [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True, errors="replace", env=self._environment(), start_new_session=True,
            )  # fmt: skip
            threading.Thread(target=self._read, args=(self._process, self._lines), daemon=True).start()
            self.say(key, first)  # before any other line, for which another call may be there already

    def lines(self, known: int) -> tuple[list[str], bool]:
        """The lines after so many that the caller knows, and whether these are all; none after some silence."""
        with self._news:
            self._news.wait_for(lambda: len(self._lines) > known or self._ended, _SILENCE_S)
            return self._lines[known:], self._ended

    def say(self, key: str, line: str) -> None:
        """A line of input to the process of that key; calls overtake each other, and another one's would be harmful."""
        with self._news:
            process = self._process
            if key != self._key or process is None or process.stdin is None:
                return
            with suppress(OSError, ValueError):  # it has ended, or its input has
                process.stdin.write(line + "\n")
                process.stdin.flush()

    def end(self) -> None:
        """Close the process's input, at which it brings itself to an end, and wait for that."""
        process = self._process
        if process is None or process.stdin is None:
            return
        with suppress(OSError):
            process.stdin.close()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()

    def piece(self, path: str, offset: int, length: int) -> bytes:
        """Bytes of a file."""
        with Path(path).open("rb") as stream:
            stream.seek(offset)
            return stream.read(length)

    def _read(self, process: subprocess.Popen[str], lines: list[str]) -> None:
        size = 0
        assert process.stdout is not None
        with process.stdout:
            for line in process.stdout:
                size += len(line)
                if size > _KEPT_BYTES:
                    process.kill()
                    break
                with self._news:
                    lines.append(line.rstrip("\n"))
                    self._news.notify_all()
        process.wait()
        with self._news:
            if lines is self._lines:
                self._ended = True
                self._news.notify_all()

    def _environment(self) -> dict[str, str]:
        # That of the node as it was started, and the devices that Ray chose. What else Ray has set since, such as
        # OMP_NUM_THREADS, would make other numbers and other times than the same run without Ray.
        try:
            block = Path("/proc/self/environ").read_bytes()
        except OSError:
            return dict(os.environ)
        pairs = (os.fsdecode(word).partition("=") for word in block.split(b"\0"))
        given = {name: value for name, equals, value in pairs if equals}
        chosen = ("CUDA_VISIBLE_DEVICES",)
        return {**given, **{name: os.environ[name] for name in chosen if name in os.environ}}
