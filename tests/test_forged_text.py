"""Recordings whose every text forges lines: no command prints or writes such a line, nor a character nobody sees."""

from __future__ import annotations

import json
import re
import unicodedata
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.cli import audit, check, compare, diff, info, share, view
from gpusimbench.evaluator.cli import eval as evaluate
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.synthetic import grid, write_recording

EVIL = (
    "a\nFORGED\r\nFORGED\u2028FORGED\x85FORGED\n::error::FORGED ##[error]FORGED "
    "\u200b\u200e\ufeff\U000e0041\ufe0f\x1b[2J"
)
_FILE = "x\nFORGED\n::error::FORGED\u200e"
"""In the names of files."""

_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
_OWN = {".md": "\n\u200b"}  # with which a comment parts what would be mentions
_FORGED = re.compile(r"^FORGED|^\s*::error|##\[", re.MULTILINE)

Change = Callable[[str, dict[str, Any]], None]


def _said(name: str, record: dict[str, Any]) -> None:
    """Spoil what may be any text, so that the recording stays one that every command shows."""
    if name == PROVENANCE:
        record["argv"] = [EVIL, *record["argv"]]
        record["created_utc"] = EVIL
        for part in ("host", "software", "environment"):
            record[part] = {**record.get(part, {}), EVIL: EVIL, "cpu": EVIL, "hostname": EVIL, "system": EVIL}
        record["gpus"] = [{"name": EVIL, "driver": EVIL}]
        record["configuration"]["options"] = {EVIL: EVIL, "solver": EVIL}
    if name == SIMULATION:
        record["version"] = record["device"] = EVIL
        record["options"] = record["switches"] = {EVIL: EVIL, "solver": EVIL}
        record["deviations"] = [{"parameter": EVIL, "requested": EVIL, "used": EVIL, "reason": EVIL}]
        record["fresh_start"] = EVIL


def _names(name: str, record: dict[str, Any]) -> None:
    """Spoil names that commands sort by."""
    _said(name, record)
    if name == PROVENANCE:
        record["configuration"].update(simulator=EVIL, scene=EVIL, determinism=EVIL)
        record["run_id"] = EVIL
    if name == SIMULATION and isinstance(record.get("scene"), dict):
        record["scene"]["name"] = EVIL


def _all(name: str, record: dict[str, Any]) -> None:
    """Spoil every text, so that the recording is refused by most commands, with reasons."""

    def spoiled(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: spoiled(item) for key, item in value.items()}
        if isinstance(value, list):
            return [spoiled(item) for item in value]
        return value + EVIL if isinstance(value, str) else value

    record.update(spoiled(record))


@pytest.fixture(scope="module", params=[_said, _names, _all])
def forged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of recordings, one failed, one cut short, and one that is none."""
    folder = tmp_path_factory.mktemp("forged")
    change: Change = request.param
    for run in range(2):
        write_recording(folder, grid(2) + 0.01 * run, run=run, name=f"{run}{_FILE}.mcap", change=change)
    write_recording(folder, grid(2), run=2, status="FAILED", reason=EVIL, name=f"2{_FILE}.mcap", change=change)
    whole = (folder / f"0{_FILE}.mcap").read_bytes()
    (folder / f"3{_FILE}.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / f"4{_FILE}.mcap").write_bytes(b"FORGED\n")
    return folder


def _versions(folder: Path, out: Path) -> Path:
    """The recordings as a history: each file is a version of its own."""
    made = out / "versions"
    for number, path in enumerate(sorted(folder.glob("*.mcap"))):
        point = made / f"v{number}{_FILE}"
        point.mkdir(parents=True, exist_ok=True)
        if not (point / path.name).exists():
            (point / path.name).symlink_to(path)
    return made


def _commands(folder: Path, out: Path) -> list[tuple[Callable[[list[str]], int], list[str]]]:
    files = [str(path) for path in sorted(folder.glob("*.mcap"))]
    return [
        (evaluate.main, [*files, "--no-cache", "--all", "--published", "--html", str(out / "html"), "--tables",
                         str(out / "tables"), "--format", "csv,md,tex", "--figures", str(out / "figures")]),
        (evaluate.main, [*files, "--no-cache", "--json", "-"]),
        (evaluate.main, [f"--{EVIL}"]),
        (info.main, files),
        (info.main, [*files, "--json", "-"]),
        (check.main, ["--protocol", *files]),
        (check.main, [*files, "--json", "-"]),
        (diff.main, [*files[:2], "--plot", str(out / "plot.svg")]),
        (diff.main, [files[0]]),
        (diff.main, [files[0], files[3]]),
        (compare.main, [*files[:2], "--no-cache", "--markdown", str(out / "c.md"), "--junit", str(out / "c.xml")]),
        (compare.main, [*files[:2], "--no-cache", "--json", "-"]),
        (compare.main, ["--history", str(_versions(folder, out.parent)), "--no-cache", "--all", "--html",
                        str(out / "h.html"), "--markdown", str(out / "h.md")]),
        (compare.main, ["--history", str(_versions(folder, out.parent)), "--no-cache", "--json", "-"]),
        (view.main, [*files[:2], "--no-open", "--with", "page", "--out", str(out / "view.html")]),
        (audit.main, [files[2], files[4], "--out", str(out / "audit")]),
        (share.main, ["pack", *files, "--out", str(out / "packed")]),
        (share.main, ["recover", files[3], "--out", str(out / "recovered.mcap")]),
        (share.main, ["viewer", files[0], "--out", str(out / "viewer.mcap")]),
        (share.main, ["leaderboard", str(folder), "--no-cache", "--out", str(out / "board")]),
        (share.main, ["verify", str(folder)]),
        (share.main, ["card", str(folder), "--title", "A", "--licence", "CC-BY-4.0", "--author", "Doe, Jane"]),
    ]  # fmt: skip


def test_no_line_is_forged(forged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Show what strangers wrote on the lines that are about it, and never as a line of its own."""
    for number, (main, arguments) in enumerate(_commands(forged, tmp_path)):
        try:
            main(arguments)
        except SystemExit as end:
            assert end.code in (0, 2)
        shown = capsys.readouterr()
        if arguments[-2:] == ["--json", "-"]:
            assert not shown.out or json.loads(shown.out)
            assert "##[" not in shown.out
        for text in (shown.out, shown.err):
            _check(text, "\n", f"{main.__module__} {number}")
    for path in tmp_path.rglob("*"):
        if path.suffix in (".html", ".svg", ".md", ".tex", ".csv", ".xml", ".json"):
            _check(path.read_text(encoding="utf-8"), _OWN.get(path.suffix, "\n\r\t"), path.name, pages=True)


def _check(text: str, own: str, where: str, *, pages: bool = False) -> None:
    hidden = {f"U+{ord(c):04X}" for c in set(text) - set(own) if unicodedata.category(c) in _HIDDEN or c == "\ufe0f"}
    assert not hidden, where
    if not pages or where.endswith((".md", ".csv", ".tex")):
        found = _FORGED.search(text)
        assert found is None, (where, text[max(0, found.start() - 200) : found.end() + 100])


def test_json_says_what_the_recording_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave texts for programs as they are."""
    path = write_recording(tmp_path, grid(1), change=_said)
    assert info.main([str(path), "--json", "-"]) in (0, 3)
    shown = json.loads(capsys.readouterr().out)
    assert EVIL in json.dumps(shown, ensure_ascii=False).replace("\\n", "\n").replace("\\r", "\r").replace(
        "\\u001b", "\x1b"
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308, -1e308])
def test_no_warnings_of_numpy(tmp_path: Path, value: float, capsys: pytest.CaptureFixture[str]) -> None:
    """Say of states that are not finite, or are as large as numbers get, what our own sentences say."""
    out = tmp_path / "out"
    out.mkdir()
    for run in range(2):
        final = grid(3)
        final[run, 3:5] = value
        write_recording(tmp_path, final, run=run, name=f"{run}.mcap")
    files = [str(tmp_path / f"{run}.mcap") for run in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what numpy says of them by default
        for main, arguments in (
            (evaluate.main, ["--no-cache", "--html", str(out), "--all", *files]),
            (info.main, files),
            (check.main, files),
            (diff.main, [*files, "--plot", str(out / "plot.svg")]),
            (diff.main, files[:1]),
            (compare.main, [*files, "--no-cache"]),
            (compare.main, ["--history", str(_versions(tmp_path, out)), "--no-cache", "--html", str(out / "h.html")]),
            (view.main, [*files, "--no-open", "--with", "page", "--out", str(out / "view.html")]),
            (share.main, ["viewer", files[0], "--out", str(out / f"{main_name(value)}.mcap")]),
        ):
            assert main(arguments) in (0, 3, 4, 5)
    assert "Warning" not in capsys.readouterr().err


def main_name(value: float) -> str:
    """Of a file."""
    return re.sub(r"\W", "_", str(value))
