"""Peak memory of every command on files that would take gigabytes as objects; what is said where memory is short."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from gpusimbench.evaluator.cli import eval as evaluate
from gpusimbench.schemas.errors import ExitCode
from tests.conftest import finished
from tests.hostile.amplifiers import write_amplifiers
from tests.synthetic import grid, write_recording

_LIMIT = 600 << 20
"""Resident, the interpreter with its packages among it: 100 to 180 MiB. What was read before took up to 8 GiB."""
_RUN = """
import contextlib, importlib, io, json, re, sys
name, *calls = json.loads(sys.stdin.read())
main = importlib.import_module(f"gpusimbench.evaluator.cli.{name}").main
found = []
for call in calls:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            code = main(call)
        except SystemExit as ended:
            code = ended.code
    # what resource tells has the peak of the process that started this one
    peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1]) * 1024
    found.append([code, peak])
print(json.dumps(found))
"""
_COMMANDS: dict[str, list[str]] = {
    "info": ["FILE", "--json", "OUT.json"],
    "check": ["FILE", "--json", "OUT.json"],
    "eval": ["FILE", "--json", "OUT.json", "--html", "OUT", "--tables", "OUT", "--no-cache"],
    "diff": ["FILE", "GOOD", "--json", "OUT.json"],
    "compare": ["--base", "GOOD", "--head", "FILE", "--json", "OUT.json", "--markdown", "OUT.md", "--no-cache"],
    "audit": ["FILE", "--runs", "1", "--json", "OUT.json", "--out", "OUT"],
    "share": ["recover", "FILE", "--out", "OUT.mcap"],
    "view": ["FILE", "--no-open", "--out", "OUT.html"],
}
"""What each is called with; those that have --json or --html write it."""
_READ = {"long texts", "metadata", "events"}
"""What is less than the bounds, or nothing that most commands look at."""


@pytest.fixture(scope="session")
def amplifiers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Made once; must not be written to."""
    return write_amplifiers(tmp_path_factory.mktemp("amplifiers"))


@pytest.mark.slow
@pytest.mark.parametrize("command", _COMMANDS)
def test_memory_of_commands(command: str, amplifiers: dict[str, Path], tmp_path: Path) -> None:
    """Refuse what would take gigabytes as objects before it is made into any, and write the rest in little memory."""
    good = next(iter(amplifiers.values())).with_name("good.mcap")
    calls = [
        [
            argument.replace("FILE", str(path)).replace("GOOD", str(good)).replace("OUT", str(tmp_path / path.stem))
            for argument in _COMMANDS[command]
        ]
        for path in amplifiers.values()
    ]
    done = finished([sys.executable, "-c", _RUN], input=json.dumps([command, *calls]), timeout=600)
    found = dict(zip(amplifiers, json.loads(done.stdout), strict=True))
    codes = {what: code for what, (code, _) in found.items()}
    peaks = {what: peak >> 20 for what, (_, peak) in found.items()}
    assert max(peaks.values()) < _LIMIT >> 20, peaks
    if command in ("info", "check", "eval", "audit"):  # which need all of it
        assert {code for what, code in codes.items() if what not in _READ} == {3}, codes
    assert set(codes.values()) <= set(ExitCode), codes


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")], ids=["memory", "thread"])
def test_short_memory_is_said(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """End with one message, and leave the earlier result as it is."""

    def fails(*_: object, **__: object) -> None:
        raise error

    write_recording(tmp_path, grid(1), name="a.mcap")
    result = tmp_path / "r.json"
    result.write_text("earlier")
    monkeypatch.setattr("gpusimbench.evaluator.results.evaluate.evaluate", fails)
    assert evaluate.main([str(tmp_path / "a.mcap"), "--no-cache", "--json", str(result)]) == 1
    assert "not enough memory" in capsys.readouterr().err
    assert result.read_text() == "earlier"
