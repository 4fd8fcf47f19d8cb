"""gsb: every command under one name, and what to do next in a folder."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gpusimbench.cli import COMMANDS
from gpusimbench.next_steps import next_steps
from tests.conftest import call, command, finished
from tests.test_help import PARSERS

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "recordings" / "mujoco-amd-r0.mcap"


def test_every_command_is_a_verb() -> None:
    """Have a verb for each command of the hyphen family, with its options, and a script that completes it."""
    assert {f"gsb-{verb}" for verb in COMMANDS} == set(PARSERS) - {"gsb"}
    (loop,) = re.findall(r"^for c in (.+); do$", (ROOT / "docs" / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(loop.split()) == set(PARSERS)
    (verbs,) = (action for action in PARSERS["gsb"]._actions if action.dest == "verb")
    assert verbs.choices is not None
    for verb, parser in dict(verbs.choices).items():
        assert parser._option_string_actions.keys() == PARSERS[f"gsb-{verb}"]._option_string_actions.keys()


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", FILE),
        ("info", "nowhere.mcap"),
        ("check", FILE, "--rules", "no-such-rules"),
        ("diff", FILE, ROOT / "recordings" / "mujoco-pyramidal-r0.mcap", "--json", "-"),
        ("record", "--sim", "mujco"),
        ("share", "--help"),
        ("eval", "--help-all"),
    ],
)
def test_a_verb_does_what_its_command_does(arguments: tuple[object, ...]) -> None:
    """Print the same, and end with the same code."""
    verb, *given = arguments
    one, other = call("gsb", verb, *given), call(f"gsb-{verb}", *given)
    assert (one.returncode, one.stdout, one.stderr) == (other.returncode, other.stdout, other.stderr)


def test_a_verb_that_is_none() -> None:
    """End with 2 and the verb that may have been meant."""
    done = call("gsb", "evaluate", code=2)
    assert "did you mean 'eval'?" in done.stderr


def test_the_module() -> None:
    """Be what python -m gpusimbench runs."""
    done = finished([sys.executable, "-m", "gpusimbench", "info", str(FILE)])
    assert done.stdout == call("gsb-info", FILE).stdout
    assert subprocess.run([*command("gsb"), "--version"], capture_output=True, timeout=300).returncode == 0


def _suggested(text: str) -> list[list[str]]:
    # arguments of gsb in the lines that show a command
    return [line.split("  ")[1].split()[1:] for line in text.splitlines() if line.startswith("  gsb ")]


def test_an_empty_folder(tmp_path: Path) -> None:
    """Say that recordings come first, and how they are made."""
    done = call("gsb", cwd=tmp_path, code=0)
    assert "no recordings here" in done.stdout
    assert "gsb record --sim mujoco" in done.stdout
    assert len(done.stdout.splitlines()) <= 10


def test_a_folder_of_work(tmp_path: Path) -> None:
    """Name the newest set, an older one to compare it with, a page of results and what a crash left."""
    for name in ("older", "newer set"):
        (tmp_path / name).mkdir()
        shutil.copyfile(FILE, tmp_path / name / "run.mcap")
    (tmp_path / "newer set" / "left.mcap.partial").write_bytes(b"content")
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").write_text("<title>mine</title>", encoding="utf-8")
    assert call("gsb", "eval", "newer set", "--html", "report", cwd=tmp_path).returncode == 3
    said = call("gsb", cwd=tmp_path).stdout
    assert "1 recording in newer set/, 1 recording in older/, 1 unfinished recording, 1 page of results" in said
    assert "gsb eval 'newer set' " in said
    assert "gsb compare older 'newer set' " in said
    assert "gsb share recover 'newer set/left.mcap.partial'" in said
    assert "report/index.html" in said
    assert "site/index.html" not in said
    assert len(said.splitlines()) <= 12


def test_folders_that_commands_evaluate_themselves(tmp_path: Path) -> None:
    """Go on from the user's sets, and not from newer recordings of gsb-import and gsb-audit, if there are others."""
    for number, name in enumerate(("runs", "imports", "audit")):
        (tmp_path / name).mkdir()
        copy = tmp_path / name / "mujoco-free-fall-n2-r0-20260101T000000Z.mcap"
        copy.write_bytes(b"")
        os.utime(copy, (number, number))
    said = "\n".join(next_steps(tmp_path))
    assert f"gsb eval {tmp_path / 'runs'} " in said
    assert "gsb compare" not in said
    assert f"1 recording in {tmp_path / 'audit'}/" in said
    (tmp_path / "runs" / "mujoco-free-fall-n2-r0-20260101T000000Z.mcap").unlink()
    assert f"gsb eval {tmp_path / 'audit'} " in "\n".join(next_steps(tmp_path))


def test_names_that_an_encoding_lacks(tmp_path: Path) -> None:
    """Say what is in a folder whose name the terminal cannot show."""
    (tmp_path / "é×2").mkdir()
    shutil.copyfile(FILE, tmp_path / "é×2" / "run.mcap")
    poor = {**os.environ, "PYTHONIOENCODING": "ascii"}
    assert r"gsb eval '\xe9x2' " in call("gsb", cwd=tmp_path, env=poor, encoding="ascii", code=0).stdout


def test_what_is_said_can_be_typed(tmp_path: Path) -> None:
    """Show commands that the parsers take."""
    (tmp_path / "runs").mkdir()
    for make in (lambda: None, lambda: shutil.copyfile(FILE, tmp_path / "runs" / "run.mcap")):
        make()
        for arguments in _suggested(call("gsb", cwd=tmp_path).stdout):
            if arguments != ["--help"]:
                PARSERS["gsb"].parse_args(arguments)


def test_recordings_of_programs(tmp_path: Path) -> None:
    """Name gsb-episodes where files have names that gsb-record does not give, and gsb-run where there are none."""
    assert "gsb run -- python train.py" in "\n".join(next_steps(tmp_path))
    (tmp_path / "mujoco-inclined-collision-n16-r0-20261126T060451Z.mcap").write_bytes(b"recorded by gsb-record")
    assert "gsb episodes" not in "\n".join(next_steps(tmp_path))
    (tmp_path / "train.mcap").write_bytes(b"recorded by a program")
    assert "gsb episodes" in "\n".join(next_steps(tmp_path))


def test_the_present_folder_itself(tmp_path: Path) -> None:
    """Name the folder by a point where the recordings lie in it, and mind no folder that cannot be read."""
    shutil.copyfile(FILE, tmp_path / "run.mcap")
    said = call("gsb", cwd=tmp_path).stdout
    assert "1 recording in this folder" in said
    assert "gsb eval . " in said
    assert next_steps(tmp_path / "nowhere")[0].startswith("There are no recordings here")
