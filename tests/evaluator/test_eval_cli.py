"""gsb-eval as a user calls it: what it prints, and how it takes bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.errors import FailedCrc
from tests.conftest import Command, call
from tests.synthetic import grid, write_recording


def test_table(gsb_eval: Command, small_set: list[Path]) -> None:
    """Print results on standard output alone, without colour where it is no terminal."""
    done = gsb_eval(*small_set, "--sample-time", 1, code=0)
    assert not done.stderr
    lines = done.stdout.splitlines()
    assert "all 3 runs are bit-identical" in lines[0]  # the verdict comes first
    assert len(lines) <= 15
    for text in ("inclined-collision", "mujoco", "throughput", "all 4 envs"):
        assert text in done.stdout
    everything = gsb_eval(*small_set, "--sample-time", 1, "--all").stdout
    for text in ("inclined-collision", "mujoco", "throughput", "other bits", "1 of 4", "95 % interval"):
        assert text in everything
    assert "\x1b" not in done.stdout + everything


def test_json_and_html_files(gsb_eval: Command, small_set: list[Path], tmp_path: Path) -> None:
    """Write JSON and the report beside the table."""
    done = gsb_eval(*small_set, "--sample-time", 1, "--json", tmp_path / "r.json", "--html", tmp_path / "report")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "r.json").read_text())["schema_version"] == SCHEMA_VERSION
    assert str(tmp_path / "report" / "index.html") in done.stdout
    assert "inclined-collision" in (tmp_path / "report" / "index.html").read_text()


def test_json_never_replaces_a_recording(gsb_eval: Command, tmp_path: Path) -> None:
    """Refuse "--json *.mcap", which would overwrite the first recording."""
    files = [write_recording(tmp_path, grid(2), run=r) for r in range(2)]
    before = files[0].read_bytes()
    done = gsb_eval("--json", *files, code=2)
    assert "named like a recording" in done.stderr
    assert files[0].read_bytes() == before


def test_published_figures_are_marked(gsb_eval: Command, small: Path) -> None:
    """Show the paper's figures only when asked, and as the paper's."""
    assert "RTX 5070" not in gsb_eval(small, "--sample-time", 1, "--all").stdout
    shown = gsb_eval(small, "--sample-time", 1, "--all", "--published").stdout
    assert "Madrona" in shown
    assert "published" in shown
    assert "RTX 5070" in shown


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        (b"", 3, "is not an MCAP file"),
        (b"plain text, long enough to be something", 3, "is not an MCAP file"),
        (b"\x89MCAP0\r\n", 3, "cut short before its provenance"),
        (b"\x89MCAP0\r\n" + b"\xff" * 64, 3, "cut short before its provenance"),
    ],
)
def test_a_bad_file(gsb_eval: Command, tmp_path: Path, content: bytes, code: int, message: str) -> None:
    """Say in one line what is wrong with the only file."""
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    done = gsb_eval(path, code=code)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


def test_a_bad_file_among_good_ones(gsb_eval: Command, tmp_path: Path) -> None:
    """Evaluate the good ones, name the bad one, end with 3."""
    good = write_recording(tmp_path, grid(2))
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(good.read_bytes()[:-2000])
    worse = tmp_path / "worse.mcap"
    changed = bytearray(good.read_bytes())
    changed[len(changed) // 2] ^= 4
    worse.write_bytes(changed)
    done = gsb_eval(good, bad, worse, code=3)
    assert "repeats itself" in done.stdout
    assert done.stdout.count("left out:") == 1
    assert "worse.mcap" in done.stderr
    told = " ".join(done.stdout.split())
    assert "worse.mcap: the data section fails its CRC; the file was changed or damaged after" in told
    assert FailedCrc.advice in told and FailedCrc.advice not in done.stderr
    assert FailedCrc.advice in gsb_eval(worse, code=3).stderr
    assert FailedCrc.advice in gsb_eval(good, worse, "--json", "-", code=3).stderr
    assert FailedCrc.advice in call("gsb-diff", good, worse, code=3).stderr


def test_nothing_usable(gsb_eval: Command, tmp_path: Path) -> None:
    """End with 5 where no file is a recording, or no recording is complete."""
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(b"no recording at all")
    assert gsb_eval(tmp_path / "a.mcap", tmp_path / "b.mcap").returncode == 5
    failed = write_recording(tmp_path, grid(2), status="FAILED", reason="out of device memory")
    done = gsb_eval(failed, code=5)
    assert "out of device memory" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("missing.mcap",), 3, "No such file"),
        (("SMALL", "--sample-time", "0"), 2, "--sample-time is a time"),
        (("SMALL", "--sample-time", "nan"), 2, "--sample-time is a time"),
        (("SMALL", "--reference", "missing.mcap"), 3, "No such file"),
        (("SMALL", "--json", "no/such/folder/r.json"), 2, "in no folder that exists"),
        (("SMALL", "--html", "/proc/report"), 1, "cannot write /proc/report/index.html"),
        ((), 2, "FILE"),
    ],
)
def test_bad_arguments(
    gsb_eval: Command, small: Path, tmp_path: Path, arguments: tuple[str, ...], code: int, message: str
) -> None:
    """Say what is wrong and end with the documented code."""
    done = gsb_eval(*(str(small) if a == "SMALL" else a for a in arguments), cwd=tmp_path, code=code)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
