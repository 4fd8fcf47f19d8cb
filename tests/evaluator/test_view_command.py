"""gsb-view as a user calls it: what it writes, what it opens, and how it ends."""

from __future__ import annotations

import os
import re
import shlex
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import finished, run_python, searched, wait_for
from tests.evaluator.test_player_clip import diverging
from tests.synthetic import grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "recordings"
PARTING = SHIPPED / "h200" / "physx-spacing-0-inclined-collision-n16-r0.mcap"


def view(*arguments: object, code: int | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run gsb-view without a display, a browser and other viewers, unless they are given."""
    kept = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")}
    words = [sys.executable, "-m", "gpusimbench.evaluator.cli.view", *arguments]
    return finished(words, code=code, env={**kept, "PATH": "/usr/bin:/bin", **environment})


def program(folder: Path, name: str, *, ends: int = 0) -> Path:
    """A program that writes down what it was given, and ends as asked."""
    path = folder / name
    path.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > {folder}/{name}.given.new\n'
                    f"mv {folder}/{name}.given.new {folder}/{name}.given\nexit {ends}\n")  # fmt: skip
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return folder / f"{name}.given"


def test_without_a_display_it_says_where_the_page_is(tmp_path: Path) -> None:
    """Write the page into a folder of its own, print its path alone, and say why no browser was opened."""
    done = view(PARTING, TMPDIR=str(tmp_path), code=0)
    page = Path(done.stdout.strip())
    assert page.parent.parent == tmp_path
    assert page.name == f"{PARTING.stem}.html"
    assert f"no browser can be opened from here; the page is {page}" in done.stderr
    assert "first differ at step 72 (0.72 s); distinct: 2 from step 72, 3 from step 105." in done.stderr
    text = page.read_text(encoding="utf-8")
    for fact in (
        "physx 0.7.0.74035321",
        "inclined-collision",
        "NVIDIA H200",
        "3 of 16 environments",
        "step 72 (0.72 s)",
    ):
        assert fact in text
    assert re.search(r"[0-9a-f]{64}", text)
    assert not re.search(r"""(?:src|href|url)\s*[=(]""", text), "nothing outside the page"
    assert len(text) < 2e6


def test_the_page_is_opened_in_the_browser(tmp_path: Path) -> None:
    """Hand the page's address to the user's browser, unless it is not to be opened."""
    given = program(tmp_path, "browser")
    out = tmp_path / "my page.html"
    done = view(PARTING, "--out", out, BROWSER=f"{tmp_path}/browser %s", code=0)
    assert given.read_text().strip() == out.as_uri()
    assert "no browser" not in done.stderr
    given.unlink()
    done = view(PARTING, "--out", out, "--no-open", BROWSER=f"{tmp_path}/browser %s")
    assert (done.returncode, done.stdout) == (0, f"{out}\n")
    assert not given.exists()


@pytest.mark.parametrize(("asked", "name"), [("auto", "foxglove"), ("rerun", "rerun")])
def test_a_viewer_that_is_installed_is_given_a_view(tmp_path: Path, asked: str, name: str) -> None:
    """Write views of the environments that are shown for a program that draws no recordings, and start it with them."""
    given = program(tmp_path, name)
    source = diverging(tmp_path, name="four.mcap")
    done = view(source, "--with", asked, PATH=f"{tmp_path}:/usr/bin:/bin", DISPLAY=":9", TMPDIR=str(tmp_path), code=0)
    assert f"lacks some of these for {name}; a view was written" in done.stderr
    wait_for(given.exists)
    made = Path(given.read_text().strip())
    assert done.stdout == f"{made}\n"
    info = run_python(_ENVS, made)
    assert info.stdout.strip() == "0,2,3"


def test_rerun_is_not_taken_unasked(tmp_path: Path) -> None:
    """Write the page where rerun alone is installed, since rerun would draw nothing."""
    given = program(tmp_path, "rerun")
    done = view(PARTING, "--no-open", PATH=f"{tmp_path}:/usr/bin:/bin", DISPLAY=":9", TMPDIR=str(tmp_path), code=0)
    assert done.stdout.endswith(".html\n")
    assert not given.exists()


def test_a_viewer_is_given_the_environments_that_are_named(small: Path, tmp_path: Path) -> None:
    """Give a program the recording where its view is of what is shown, and else a view of that."""
    given = program(tmp_path, "rerun")
    for env, itself in ((0, True), (2, False)):
        done = view(
            small, "--with", "rerun", "--env", env, "--no-open", PATH=f"{tmp_path}:/usr/bin:/bin", TMPDIR=str(tmp_path)
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert f"Shown: env {env}." in done.stderr
        assert (done.stdout.strip() == str(small)) is itself
        assert ("a view was written" in done.stderr) is not itself
        assert any(tmp_path.glob("gsb-view-*")) is not itself  # no folder is left that nothing was written to
    assert not given.exists()


_ENVS = """
import sys
from mcap.reader import make_reader
print(next(m.metadata["environments"] for m in make_reader(open(sys.argv[1], "rb")).iter_metadata()))
"""


_PATIENT = """
import sys
from gpusimbench.evaluator.cli.view import main
from gpusimbench.evaluator.player import programs
programs._GRACE_S = 300.0
sys.exit(main())
"""
"""gsb-view with more time for a program to end: where others compute, a second may be too short for a shell."""


def test_programs_that_cannot_be_started(tmp_path: Path) -> None:
    """Say that a program is missing, or ended at once; and take the page where there is no display for one."""
    done = view(PARTING, "--with", "foxglove", "--no-open", code=2)
    assert "there is no foxglove-studio or foxglove on the PATH; --with page needs nothing" in done.stderr
    program(tmp_path, "lichtblick", ends=7)
    path = f"{tmp_path}:/usr/bin:/bin"
    environment = {**os.environ, "PATH": path, "TMPDIR": str(tmp_path)}
    done = run_python(_PATIENT, PARTING, "--with", "lichtblick", env=environment, code=1)
    assert "ended with exit code 7 as soon as it was started" in done.stderr
    done = view(PARTING, PATH=path, TMPDIR=str(tmp_path), code=0)
    assert done.stdout.endswith(".html\n")


def test_exit_codes(tmp_path: Path) -> None:
    """End with the code of what went wrong, and one line that says it."""
    without = write_recording(tmp_path, None, name="without.mcap")
    short = diverging(tmp_path, end=False, name="short.mcap")
    other = write_recording(tmp_path, grid(1), dt=0.5, name="other.mcap")
    nothing = tmp_path / "nothing.mcap"
    nothing.write_bytes(b"nothing")
    out = ("--no-open", "--out", tmp_path / "view.html")
    expected: list[tuple[tuple[Any, ...], int, str]] = [
        ((without, *out), 5, "holds no states"),
        ((short, *out), 3, "Recording short.mcap.partial is incomplete"),
        ((nothing, *out), 3, "not an MCAP file"),
        ((PARTING, other, *out), 2, "the same time step"),
        ((PARTING, "--env", 16, *out), 2, "no environment 16: it has 0 to 15"),
        ((PARTING, "--no-open", "--out", tmp_path / "view.mcap"), 2, "call it .html"),
        ((PARTING, "--no-open", "--out", tmp_path / "no" / "view.html"), 1, "cannot write"),
        ((PARTING, *out, "--with", "rerun"), 2, "with --with rerun there is none"),
        ((PARTING, "--with", "paper"), 2, "invalid choice"),
    ]
    for arguments, code, said in expected:
        done = view(*arguments, code=code)
        assert said in done.stderr, (arguments, done.stderr)
        assert "Traceback" not in done.stderr
    assert view(short, *out).stdout.endswith("view.html\n"), "what is there is shown all the same"


def test_environments_that_part_by_design(arms: Path, tmp_path: Path) -> None:
    """Say where environments were told to do different things, so that nobody takes that for a fault."""
    done = view(arms, "--out", tmp_path / "view.html", "--no-open", code=0)
    assert "first differ at step 1" in done.stderr
    assert "The environments were given different actions, so they differ by design." in done.stderr


@pytest.mark.slow
def test_the_guide_shows_what_happens(tmp_path: Path) -> None:
    """Run every command of the guide against the shipped recordings, and find the output that it shows."""
    guide = (ROOT / "docs" / "view.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```console\n(.*?)^```\n(?:\n```text\n(.*?)^```)?", guide, re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 2
    (tmp_path / "recordings").symlink_to(SHIPPED)
    for commands, shown in blocks:
        for line in commands.splitlines():
            name, *arguments = shlex.split(line)
            assert name == "gsb-view"
            done = subprocess.run(
                [sys.executable, "-m", "gpusimbench.evaluator.cli.view", *arguments],
                cwd=tmp_path, capture_output=True, text=True, timeout=300,
                env={**os.environ, "PYTHONPATH": searched(ROOT)},
            )  # fmt: skip
            assert done.returncode == 0, f"{line}\n{done.stderr}"
            assert not shown or done.stderr + done.stdout == shown, line
