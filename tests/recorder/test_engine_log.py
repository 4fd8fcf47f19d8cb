"""What an engine prints is found, and still arrives where it was meant to go."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from gpusimbench.recorder.simulators.engine_log import EngineLog

LOST = (r"buffer overflow detected", r"Contacts have been dropped")


@pytest.fixture
def printed(tmp_path: Path) -> Iterator[IO[bytes]]:
    """A file that stands for what a run's process prints to."""
    with (tmp_path / "output").open("wb", buffering=0) as stream:
        stream.write(b"Contact buffer overflow detected, before\n")
        yield stream


def run(code: str, **streams: object) -> subprocess.CompletedProcess[bytes]:
    """Run Python code that has an EngineLog at hand in a process of its own."""
    head = "import ctypes, os, sys\nfrom gpusimbench.recorder.simulators.engine_log import EngineLog\n"
    return subprocess.run(  # type: ignore[call-overload,no-any-return]
        [sys.executable, "-c", head + textwrap.dedent(code)], **{"timeout": 300, "check": True, **streams}
    )


def test_finds_lines_of_a_file_once(printed: IO[bytes]) -> None:
    """Lines that match are given once, in order; earlier and other lines are not."""
    log = EngineLog((printed.fileno(),))
    printed.write(b"Contact buffer overflow detected, please increase its size to at least 5\nall is well\n")
    printed.write(b"Patch buffer overflow detected\n")
    assert log.matches(LOST) == [
        "Contact buffer overflow detected, please increase its size to at least 5",
        "Patch buffer overflow detected",
    ]
    assert log.matches(LOST) == []
    printed.write(b"Contacts have been dropped\r\n")
    assert log.matches(LOST) == ["Contacts have been dropped"]
    log.close()
    log.close()


def test_reads_a_file_and_leaves_it_as_it_is(printed: IO[bytes]) -> None:
    """What the run's log keeps does not change."""
    log = EngineLog((printed.fileno(),))
    printed.write(b"one\n")
    assert log.matches(("one", "two")) == ["one"]
    printed.write(b"two\n")
    log.close()
    assert Path(printed.name).read_bytes() == b"Contact buffer overflow detected, before\none\ntwo\n"


def test_an_unfinished_line_is_not_missed(printed: IO[bytes]) -> None:
    """A line that comes in two parts is found, whichever part says what is looked for."""
    log = EngineLog((printed.fileno(),))
    printed.write(b"error: ")
    assert log.matches(LOST) == []
    printed.write(b"Contacts have been dropped")
    assert log.matches(LOST) == ["error: Contacts have been dropped"]
    log.close()


def test_a_file_that_was_emptied_is_read_from_its_beginning(printed: IO[bytes]) -> None:
    """Lines printed after the file was emptied are found."""
    log = EngineLog((printed.fileno(),))
    printed.truncate(0)
    printed.seek(0)
    printed.write(b"Contacts have been dropped\n")
    assert log.matches(LOST) == ["Contacts have been dropped"]
    log.close()


def test_lines_across_chunks_are_whole(printed: IO[bytes]) -> None:
    """Megabytes of lines, some longer than a chunk, are read as the lines that they are."""
    log = EngineLog((printed.fileno(),))
    long = b"x" * 3_000_000 + b" Contacts have been dropped"
    printed.write(b"noise\n" * 300_000 + long + b"\n" + b"noise\n" * 300_000)
    assert log.matches(LOST) == [long.decode()]
    log.close()


@pytest.mark.parametrize("target", ["pipe", "file"])
def test_native_output_is_found_and_arrives(target: str, tmp_path: Path) -> None:
    """Lines that native code prints on both descriptors are found; pipes and files get every byte in order."""
    code = """
        c = ctypes.CDLL(None)
        c.puts(b"before")
        log = EngineLog()
        c.puts(b"Patch buffer overflow detected")  # held back by the C library, as standard output is no terminal
        os.write(2, b"Contacts have been dropped\\n")
        found = log.matches(("overflow", "dropped"))
        log.close()
        print(len(found), "found")
    """
    if target == "pipe":
        said = run(code, stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout
    else:
        with (tmp_path / "output").open("wb") as stream:
            run(code, stdout=stream, stderr=stream)
        said = (tmp_path / "output").read_bytes()
    lines = said.splitlines()
    assert lines[0] == b"before"
    assert sorted(lines[1:3]) == [b"Contacts have been dropped", b"Patch buffer overflow detected"]
    assert said.endswith(b"2 found\n")


def test_much_output_while_python_is_held_up() -> None:
    """Native code that fills a pipe many times over without letting Python run does not wait for ever."""
    said = run(
        """
        log = EngineLog()
        write = ctypes.PyDLL(None).write  # a PyDLL keeps Python's lock
        for _ in range(100):
            write(1, b"x" * 65535 + b"\\n", 65536)
        assert log.matches(("y",)) == []
        log.close()
        """,
        stdout=subprocess.PIPE,
    ).stdout
    assert len(said) == 100 * 65536


def test_what_is_left_is_passed_on_at_exit() -> None:
    """A log that nobody closes loses nothing, and each descriptor keeps its own target."""
    done = run(
        """
        log = EngineLog()
        os.write(1, b"to the output\\n")
        os.write(2, b"to the error\\n")
        raise SystemExit(0)
        """,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert (done.stdout, done.stderr) == (b"to the output\n", b"to the error\n")


def test_a_log_inside_a_log() -> None:
    """Two simulators in one process each see what is printed, in either order of closing."""
    said = run(
        """
        first = EngineLog()
        second = EngineLog()
        os.write(2, b"dropped\\n")
        seen = second.matches(("dropped",)), first.matches(("dropped",))
        first.close()
        second.close()
        print(seen == (["dropped"], ["dropped"]))
        """,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ).stdout
    assert said == b"dropped\nTrue\n"
