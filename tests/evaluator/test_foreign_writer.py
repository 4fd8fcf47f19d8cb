"""Recordings of a writer that shares no code with ours: the program of docs/how-to/write-without-our-code.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gpusimbench.schemas.errors import ExitCode
from tests.conftest import call, run_python

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "write-without-our-code.md"


def written(folder: Path, before: str = "", after: str = "") -> str:
    """Name of a file that the program wrote, with a part of its text replaced."""
    (found,) = re.findall(r'^```python title="write.py"\n(.*?)^```', PAGE.read_text(encoding="utf-8"), re.M | re.S)
    assert not before or found.count(before) == 1
    program = found.replace(before, after) if before else found
    assert "gpusimbench" not in program
    if not (folder / "recordings").exists():
        (folder / "recordings").symlink_to(ROOT / "recordings")
    run_python(program, "a.mcap", 0, cwd=folder)
    return "a.mcap"


def said(folder: Path, command: str, code: int = 0) -> str:
    """What a command says of the file."""
    done = call(command, "a.mcap", cwd=folder, code=code)
    return " ".join(f"{done.stdout} {done.stderr}".split())


@pytest.mark.parametrize(
    ("before", "after", "by"),
    [
        ("", "", "by mysim-writer 1.0, commit not recorded"),
        (', "recorder": {"name": "mysim-writer", "version": "1.0"}', "", "by a program that does not name itself"),
        ('"name": "mysim-writer", ', "", "by gpusimbench 1.0, commit not recorded"),  # as recordings before the name
    ],
)
def test_who_recorded_a_file(tmp_path: Path, before: str, after: str, by: str) -> None:
    """Name the writer, and not ours where there was another."""
    written(tmp_path, before, after)
    assert f"{by} simulator mysim 0.3 on cpu" in said(tmp_path, "gsb-info")


def test_a_file_of_another_writer_keeps_every_rule(tmp_path: Path) -> None:
    """Find nothing to object to in what the format's description leads to."""
    written(tmp_path)
    assert said(tmp_path, "gsb-check").startswith("PASSED: no error and no warning in a.mcap")


def test_states_without_hashes(tmp_path: Path) -> None:
    """Say that hashes are missing, and not that states are."""
    written(tmp_path, 'write("/fingerprint/capture"', 'hashes and write("/fingerprint/captured"')
    assert "repeats itself not compared: no state hashes were recorded" in said(tmp_path, "gsb-eval")


@pytest.mark.parametrize("command", ["gsb-eval", "gsb-view"])
def test_a_block_of_the_wrong_size_is_named_with_its_file(tmp_path: Path, command: str) -> None:
    """Say of which file a message is."""
    written(tmp_path, "data64=rows.ravel()", "data64=rows.ravel()[1:]")
    assert f"{command}: a.mcap: a gsb.v1.StateBlock message" in said(tmp_path, command, ExitCode.DATA_LOST)
