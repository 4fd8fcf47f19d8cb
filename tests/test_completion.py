"""The shell completes commands: in a real bash, from the script that the command prints."""

from __future__ import annotations

import importlib.util
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from gpusimbench.schemas.commands.parser import SHELLS
from tests.conftest import finished
from tests.test_site import script

pytestmark = pytest.mark.skipif(importlib.util.find_spec("shtab") is None, reason="shtab is not installed")
needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")

MODULES = script("make_reference").entry_points()


def printed(command: str, shell: str) -> str:
    """The script that a command prints."""
    done = finished([sys.executable, "-m", MODULES[command], "--print-completion", shell])
    assert done.stderr == ""
    return done.stdout


def completed(line: str, folder: Path) -> set[str]:
    """What bash offers for the last word of a line, after it has read the script of the line's command."""
    words = line.split(" ")
    source = folder / f"{words[0]}.bash"
    if not source.exists():
        source.write_text(printed(words[0], "bash"), encoding="utf-8")
    program = f"""
        source {shlex.quote(str(source))}
        COMP_WORDS=({" ".join(shlex.quote(word) for word in words)}) COMP_CWORD={len(words) - 1}
        function=$(complete -p {words[0]} | sed 's/.*-F \\([^ ]*\\).*/\\1/')
        "$function" && printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = finished(["bash", "-c", program], cwd=folder)
    return set(done.stdout.split())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a recording, a table and a text."""
    for name in ("run.mcap", "left.mcap.partial", "trials.csv", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "more").mkdir()
    return tmp_path


@needs_bash
def test_options_and_names(folder: Path) -> None:
    """Offer options that begin so, simulators and scenes that are known here, and the values of a closed set."""
    assert completed("gsb-record --det", folder) == {"--determinism"}
    assert completed("gsb-record --sim mu", folder) == {"mujoco"}
    assert {"warp", "real"} <= completed("gsb-record --sim ", folder)
    assert completed("gsb-record --sim mujoco --scene fr", folder) == {"free-body", "free-fall", "franka"}
    assert completed("gsb-record --setup gen", folder) == {"genesis"}
    assert completed("gsb-record --compression z", folder) == {"zstd"}
    assert completed("gsb-audit --require bit", folder) == {"bit-identical"}
    assert completed("gsb-share re", folder) == {"recover"}
    assert completed("gsb-share viewer --ra", folder) == {"--rate"}
    assert completed("gsb ev", folder) == {"eval"}
    assert completed("gsb record --sim mu", folder) == {"mujoco"}
    assert completed("gsb eval ", folder) == {"run.mcap", "left.mcap.partial", "more"}


@needs_bash
def test_files(folder: Path) -> None:
    """Offer recordings where recordings are read, tables where a table is, and anything where a file is written."""
    recordings = {"run.mcap", "left.mcap.partial", "more"}
    assert completed("gsb-eval ", folder) == recordings
    assert completed("gsb-eval run.mcap --reference ", folder) == recordings
    assert completed("gsb-share recover ", folder) == recordings
    assert completed("gsb-record --sim real --trials ", folder) == {"trials.csv", "more"}
    for written in ("gsb-eval run.mcap --json ", "gsb-share recover --out ", "gsb-share viewer --layout "):
        assert "notes.txt" in completed(written, folder), written
    assert completed("gsb-eval run.mcap --html ", folder) == {"more"}


@pytest.mark.parametrize("shell", [SHELLS[0], *(pytest.param(shell, marks=pytest.mark.slow) for shell in SHELLS[1:])])
def test_every_shell(shell: str) -> None:
    """Print for each command a script that names it and its options."""
    for command in MODULES:
        text = printed(command, shell)
        assert command in text
        assert "print-completion" in text


def test_help_and_work_are_as_they_were() -> None:
    """Let names that only completion knows neither show in the help nor limit what an option takes."""
    from gpusimbench.recorder.command.arguments import parser

    (sim,) = (action for action in parser()._actions if action.dest == "sim")
    assert sim.choices is None
    assert parser().parse_args(["--sim", "of-a-package-of-yours"]).sim == "of-a-package-of-yours"


def test_an_unknown_shell() -> None:
    """End with 2 and name the shells that are known."""
    done = finished([sys.executable, "-m", "gpusimbench.recorder.cli", "--print-completion", "ksh"], code=2)
    assert "bash" in done.stderr
