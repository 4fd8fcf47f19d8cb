"""What commands write: through no link that waits for them, over no earlier result that a full disk would cost, and to
readers that leave."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.cli import check, compare, diff, info, share, view
from gpusimbench.evaluator.cli import eval as evaluate
from gpusimbench.recorder import cli as record
from tests.conftest import SMALL, call, command
from tests.schemas.test_writing import full_disk
from tests.synthetic import grid, write_recording

Main = Callable[[list[str]], int]

_CARD = ("--title", "A set", "--licence", "CC-BY-4.0", "--author", "Doe, Jane", "--update")
"""Stands for the folder that is written to; RUNS for that of the recordings."""

COMMANDS: dict[str, tuple[Main, list[str], list[str]]] = {
    "eval-json": (evaluate.main, ["RUNS/a.mcap", "--no-cache", "--json", "OUT/r.json"], ["r.json"]),
    "eval-tables": (
        evaluate.main,
        ["RUNS/a.mcap", "--no-cache", "--tables", "OUT", "--format", "parquet,csv,md,tex"],
        ["runs.parquet", "metrics.parquet", "throughput.csv", "validity.md", "variability.tex"],
    ),
    "eval-figures": (evaluate.main, ["RUNS/a.mcap", "--no-cache", "--figures", "OUT"], ["figures.tex"]),
    "eval-html": (evaluate.main, ["RUNS/a.mcap", "--no-cache", "--html", "OUT"], ["index.html"]),
    "info": (info.main, ["RUNS/a.mcap", "--json", "OUT/r.json"], ["r.json"]),
    "check": (check.main, ["RUNS/a.mcap", "--json", "OUT/r.json"], ["r.json"]),
    "diff": (diff.main, ["RUNS/a.mcap", "RUNS/b.mcap", "--json", "OUT/r.json", "--plot", "OUT/p.svg"],
             ["r.json", "p.svg"]),
    "compare": (
        compare.main,
        ["RUNS/a.mcap", "RUNS/b.mcap", "--no-cache", "--json", "OUT/r.json", "--markdown", "OUT/r.md", "--junit",
         "OUT/r.xml"],
        ["r.json", "r.md", "r.xml"],
    ),
    "view": (view.main, ["RUNS/a.mcap", "--no-open", "--with", "page", "--out", "OUT/view.html"], ["view.html"]),
    "leaderboard": (share.main, ["leaderboard", "RUNS", "--no-cache", "--out", "OUT"],
                    ["index.html", "leaderboard.csv", "leaderboard.json"]),
    "card": (share.main, ["card", "OUT", *_CARD], ["README.md", "CITATION.cff", "gpusimbench.json"]),
    "verify": (share.main, ["verify", "RUNS", "--json", "OUT/r.json"], ["r.json"]),
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A described folder of two recordings that differ."""
    folder = tmp_path_factory.mktemp("runs")
    write_recording(folder, grid(2), name="a.mcap")
    write_recording(folder, grid(2) + 0.01, run=1, name="b.mcap")
    assert share.main(["card", str(folder), *_CARD[:-1]]) == 4  # they say less than rules ask
    return folder


def _arguments(name: str, runs: Path, out: Path) -> list[str]:
    if name == "card":
        for path in runs.iterdir():
            shutil.copy(path, out)
    return [a.replace("RUNS", str(runs)).replace("OUT", str(out)) for a in COMMANDS[name][1]]


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("name", COMMANDS)
def test_earlier_results_outlive_afull_disk(
    runs: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """End with 1 and one line, and leave every file of the folder as it was, with none beside."""
    arguments = _arguments(name, runs, tmp_path)
    if name == "card":
        arguments[arguments.index("A set")] = "Another name"
    else:
        for file in COMMANDS[name][2]:
            (tmp_path / file).write_text('{"kind": "gpusimbench leaderboard"}')
    before = _contents(tmp_path)
    with full_disk(64):
        assert COMMANDS[name][0](arguments) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith(": File too large")
    assert _contents(tmp_path) == before


@pytest.mark.parametrize("name", COMMANDS)
def test_links_are_replaced(runs: Path, tmp_path: Path, name: str) -> None:
    """Write through no link under the name of a result, nor under one that a result once had while it was made."""
    victim = tmp_path / "victim"
    out = tmp_path / "out"
    out.mkdir()
    arguments = _arguments(name, runs, out)
    victim.write_text("mine")
    planted = [f".{file}.{os.getpid()}{end}" for file in COMMANDS[name][2] for end in (".partial", "")]
    planted += [f"{file}.partial" for file in COMMANDS[name][2]]
    if name not in ("card", "leaderboard"):  # which refuse a name that others have
        planted += COMMANDS[name][2]
    for file in planted:
        (out / file).symlink_to(victim)
    code = COMMANDS[name][0](arguments)
    assert victim.read_text() == "mine"
    if name == "card":
        assert code == 2  # no link can be published
        return
    for file in COMMANDS[name][2]:
        assert (out / file).is_file()
        assert not (out / file).is_symlink()


def test_a_recording_is_not_written_through_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take another name where a link waits under that of the recording being made."""
    monkeypatch.setattr("gpusimbench.recorder.trials.real.utc_now", lambda: "2026-01-01T00:00:00Z")
    (tmp_path / "trials.csv").write_text("trial,cube,x,y\n" + "".join(f"a,{cube},0.1,0.2\n" for cube in range(27)))
    (tmp_path / "runs").mkdir()
    stem = "real-inclined-collision-n1-r0-20260101T000000Z"
    (tmp_path / "runs" / f"{stem}.mcap.partial").symlink_to(tmp_path / "victim")
    arguments = ["--sim", "real", "--scene", "inclined-collision", "--trials", str(tmp_path / "trials.csv")]
    assert record.main([*arguments, "--unit", "m", "--out", str(tmp_path / "runs")]) == 0
    assert not (tmp_path / "victim").exists()
    assert (tmp_path / "runs" / f"{stem}-2.mcap").is_file()


def _unread(*words: object, errors_too: bool = False, **environment: str) -> tuple[int, str]:
    """Exit code and errors of a command whose output goes into a pipe that nobody reads any more."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [*command(str(words[0])), *map(str, words[1:])], stdout=writer, text=True, timeout=300,
            stderr=writer if errors_too else subprocess.PIPE, env={**os.environ, **environment},
        )  # fmt: skip
    finally:
        os.close(writer)
    return done.returncode, done.stderr or ""


@pytest.mark.parametrize("unbuffered", ["", pytest.param("1", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "arguments",
    [
        ("gsb",),
        ("gsb", "--help"),
        ("gsb-check", "--print-completion", "bash"),
        ("gsb-diff", "RUNS/a.mcap", "RUNS/b.mcap"),
        ("gsb-diff", "RUNS/a.mcap", "RUNS/b.mcap", "--json", "-"),
        ("gsb-info", "RUNS/a.mcap"),
        ("gsb-record", "--list"),
        ("gsb-record", "--list", "--json"),
    ],
)
def test_a_reader_that_leaves(runs: Path, arguments: tuple[str, ...], unbuffered: str) -> None:
    """End in silence, with the exit code that the command has where all of its output is read."""
    words = [word.replace("RUNS", str(runs)) for word in arguments]
    code = call(*words).returncode
    assert _unread(*words, PYTHONUNBUFFERED=unbuffered) == (code, "")


def test_a_reader_of_errors_that_leaves(runs: Path) -> None:
    """End with the exit code of an error that nobody reads."""
    assert _unread("gsb-info", runs / "nowhere.mcap", errors_too=True) == (3, "")


def test_a_recorder_whose_reader_leaves(tmp_path: Path) -> None:
    """Make the runs that were asked for."""
    code, said = _unread("gsb-record", "--sim", "mujoco", "--n-env", 1, "--runs", 2, *SMALL, "--out", tmp_path)
    assert code == 0, said
    assert "Traceback" not in said
    assert [open_recording(path).status for path in tmp_path.iterdir()] == ["complete"] * 2
