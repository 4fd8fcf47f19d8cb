"""Where the command's words go: files, pipes and terminals."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from contextlib import redirect_stdout
from pathlib import Path
from threading import Thread

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.commands.output import OfMainThread
from tests.conftest import SMALL, Command, command, distribution, finished


def _on_a_terminal(arguments: list[str], stdout: Path | None = None) -> tuple[int, str]:
    """Run a command on a terminal of 80 columns, its output optionally in a file; returns exit code and screen."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with (stdout or Path(os.devnull)).open("wb") as file:
        process = subprocess.Popen(
            arguments, stdin=theirs, stdout=file if stdout else theirs, stderr=theirs,
            env={**os.environ, "TERM": "xterm-256color"}, start_new_session=True,
        )  # fmt: skip
        os.close(theirs)
        screen = b""
        while True:
            try:
                data = os.read(ours, 65536)
            except OSError:  # the last process has closed the terminal
                break
            if not data:
                break
            screen += data
    os.close(ours)
    return process.wait(timeout=300), re.sub(rb"\x1b\[[0-9;?]*[a-zA-Z]", b"", screen).decode().replace("\r", "")


def _record(out: Path, runs: int = 2) -> list[str]:
    return [*command("gsb-record"), "--sim", "mujoco", "--n-env", "1", "--runs", str(runs), *SMALL, "--out", str(out)]


def test_paths_go_into_the_file(tmp_path: Path) -> None:
    """Write the paths into the file that standard output is, while bars are on the terminal."""
    code, screen = _on_a_terminal(_record(tmp_path / "out"), tmp_path / "paths")
    assert code == 0, screen
    paths = [Path(line) for line in (tmp_path / "paths").read_text().splitlines()]
    assert sorted(paths) == sorted((tmp_path / "out").iterdir())
    assert "run 2/2 complete" in screen
    assert ".mcap" not in screen


def test_paths_on_a_terminal_are_unbroken(tmp_path: Path) -> None:
    """Print a path that is longer than the terminal is wide, and holds what could be markup, as it is."""
    out = tmp_path / ("L" * 60) / "[red]x :smile: [bold]"
    code, screen = _on_a_terminal(_record(out, runs=1))
    assert code == 0, screen
    for file in out.iterdir():
        assert f"{file}\n" in screen


@pytest.mark.parametrize("unbuffered", ["", pytest.param("1", marks=pytest.mark.slow)])
@pytest.mark.parametrize("arguments", [("--list",), ("--list", "--json"), ("--sim", "mujoco", "--runs", "2", *SMALL)])
def test_an_output_that_takes_nothing(tmp_path: Path, arguments: tuple[str, ...], unbuffered: str) -> None:
    """Say in one line that standard output takes no more, end with 1, and keep the recording."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*command("gsb-record"), *arguments, "--out", str(tmp_path)], stdout=full, stderr=subprocess.PIPE,
            text=True, timeout=300, env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "gsb-record: cannot write to standard output: No space left on device"
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    for file in tmp_path.iterdir():
        assert open_recording(file).status == "complete"


@pytest.mark.slow
def test_a_path_in_another_encoding(gsb_record: Command, tmp_path: Path) -> None:
    """Print the bytes of a path whatever the encoding of standard output, and whatever they are."""
    out = os.fsencode(tmp_path) + b"/\xc3\xbc \xff"
    arguments = [os.fsencode(word) for word in (*command("gsb-record"), "--sim", "mujoco", "--n-env", "1", *SMALL)]
    done = subprocess.run(
        [*arguments, b"--runs", b"1", b"--out", out], capture_output=True, timeout=300,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (file,) = os.listdir(out)
    assert done.stdout == out + b"/" + file + b"\n"


def test_words_that_the_output_cannot_show(tmp_path: Path) -> None:
    """Say in one line which character standard output cannot show, and end with 1."""
    distribution(tmp_path, "übung", "[gsb.simulators]\nübung = nowhere:Nothing\n")
    done = finished(
        [*command("gsb-record"), "--list"],
        code=1,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": str(tmp_path)},
    )
    assert len(done.stderr.splitlines()) == 1
    assert "standard output is in ascii and cannot show '\\xfc'" in done.stderr


@pytest.mark.slow
def test_two_recorders_in_one_folder(tmp_path: Path) -> None:
    """Give each of two commands that start at once files of its own, all of them whole."""
    processes = [
        subprocess.Popen(_record(tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)
    ]
    printed: list[str] = []
    for process in processes:
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        printed += out.split()
    assert sorted(printed) == sorted(map(str, tmp_path.iterdir()))
    assert len(set(printed)) == 4
    recordings = [open_recording(path) for path in printed]
    for recording in recordings:
        verify(recording)
        assert recording.status == "complete"
    assert len({r.provenance.run_id for r in recordings}) == 4


def test_a_name_is_reserved_once(tmp_path: Path) -> None:
    """Give a name to one recorder alone, give it back when nothing was written, and keep what was."""
    from gpusimbench.recorder.capture.sink import Sink
    from gpusimbench.recorder.plan import release, reserve
    from gpusimbench.schemas.configuration import RunConfiguration
    from gpusimbench.schemas.errors import UsageError

    configuration = RunConfiguration("s", "free-fall", n_env=3, dt=0.01, steps=1)
    first, second = (reserve(tmp_path, configuration, "2026-01-02T03:04:05Z") for _ in range(2))
    assert [p.name for p in (first, second)] == [f"s-free-fall-n3-r0-20260102T030405Z{n}.mcap" for n in ("", "-2")]
    with pytest.raises(UsageError, match="another recorder may be writing it"):
        Sink(first, compression="none")
    assert release(first) is None
    sink = Sink(second, compression="none", reserved=True)
    sink.channel("/run/event", "gsb.v1.Event")
    sink.write("/run/event", b"")
    with pytest.raises(UsageError, match="is not empty"):
        Sink(second, compression="none", reserved=True)
    assert release(second) == sink.partial
    sink.finish("COMPLETE", "", last_step=0, peak_rss_bytes=0)
    assert [p.name for p in tmp_path.iterdir()] == [second.name]
    assert reserve(tmp_path, configuration, "2026-01-02T03:04:05Z") == first
    assert reserve(tmp_path, configuration, "2026-01-02T03:04:05Z").name.endswith("-3.mcap")


def test_other_threads_print_nothing() -> None:
    """Keep the words of a library's threads out of a command's output, and tell the threads that they were written."""
    kept, written = io.StringIO(), list[int]()
    with redirect_stdout(OfMainThread(kept)):
        print("ours")
        thread = Thread(target=lambda: written.append(sys.stdout.write("theirs")))
        thread.start()
        thread.join()
        print("ours again")
    assert (kept.getvalue(), written) == ("ours\nours again\n", [len("theirs")])
