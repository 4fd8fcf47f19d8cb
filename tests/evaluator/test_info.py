"""gsb-info: what it says of whole files, of damaged ones, and of those that are none."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.check.inspection import inspect
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.cli.info import main
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.info import info_document
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.fields import array_field, body_field
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION, OverflowBit
from tests.conftest import Command, call
from tests.evaluator.damaged import BYTES, whole
from tests.evaluator.test_strangers import FORGERIES
from tests.synthetic import Shown, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def gsb_info() -> Command:
    """Call gsb-info with the given arguments."""
    return lambda *arguments, **keywords: call("gsb-info", *arguments, **keywords)


def test_what_is_said_of_a_run(gsb_info: Command, small: Path) -> None:
    """Say who, what, where, how long and what is in it: the most important in 15 lines, and all with --all."""
    brief = gsb_info(small, code=0)
    assert len(brief.stdout.splitlines()) <= 16
    for text in ("status       complete", "whole and unchanged", "4 environments, dt 0.01 s, seed 0", "at 101 steps"):
        assert text in brief.stdout, text
    done = gsb_info(small, "--all", code=0)
    assert not done.stderr
    for text in (
        "status       complete", "whole and unchanged", "gsb-record --sim mujoco", "number 0 of its set", "mujoco ",
        "inclined-collision", "4 environments, dt 0.01 s, seed 0", "10 warm-up and 20 timed steps", "cone=", "machine",
        "cubes/position ", "101x4x27x3", "unit quaternion", "4 x 20 steps, from step", "host: baseline",
        "capture at 101 steps",
        "intervals x steps: ", "scene.json", "precision=float64", "baseline ", "names        ball: ball\n",
        "cubes: cube_0_0_0, cube_0_0_1, ",
    ):  # fmt: skip
        assert text in done.stdout, text
    assert len(done.stdout.splitlines()) <= 60


def test_only_what_has_names_is_named(tmp_path: Path) -> None:
    """Name bodies and joints of a program's recording, and nothing of its arrays of environments."""
    fields = (body_field("parts", "position", "float64", ("hull", "wheel")), array_field("reward", "float64"))
    with RecordingWriter(
        tmp_path / "a.mcap", simulator="mine", version="1", scene="toy", n_env=2, dt=0.5, steps=1, fields=fields
    ) as log:
        for _ in range(2):
            log.append(np.zeros((2, 2, 3)), np.zeros(2))
    said = call("gsb-info", tmp_path / "a.mcap", "--all", code=0).stdout
    assert re.findall(r"^  names .*\n(?:   .*\n)*", said, re.MULTILINE) == ["  names        parts: hull, wheel\n"]


def test_numbers_are_the_recordings_own(small: Path) -> None:
    """Give sizes and rates that follow from the arrays and clocks of the file."""
    found = inspect(examine(small))
    (positions,) = (array for array in found.arrays if array.name == "cubes/position")
    assert positions.shape == (101, 4, 27, 3)
    assert positions.bytes == 101 * 4 * 27 * 3 * 8
    assert positions.bytes <= positions.stored_bytes < positions.bytes * 1.01
    assert positions.encodings == (0,)
    assert found.timed.env_steps_per_s == pytest.approx(4 * 20 / found.timed.seconds)
    assert found.captured.steps == 100
    assert list(found.phases) == ["baseline", "init", "warmup", "timed", "capture"]
    events = Recording(small).events
    begin, end = (next(e.monotonic_ns for e in events if (e.kind, e.phase) == (kind, "timed")) for kind in _BOTH)
    assert found.phases["timed"] == pytest.approx((end - begin) / 1e9)
    assert found.phases["timed"] >= found.timed.seconds
    assert found.peak_rss_bytes == examine(small).end.peak_rss_bytes > 10**7
    assert (found.timed.first_step, found.captured.first_step) == (10, 0)
    assert found.container.bytes == small.stat().st_size
    assert found.content_hash == examine(small).end.content_hash


_BOTH = ("PHASE_BEGIN", "PHASE_END")


@pytest.mark.parametrize(("name", "first"), [("T132945Z", 30), ("T132545Z", 0)])
def test_rate_of_captured_steps_says_from_which_step(name: str, first: int) -> None:
    """Count the steps of a run that continues another one from where it continued."""
    (path,) = (ROOT / "recordings" / "vary-h100").glob(f"mjx-run-to-run-cube-toss-n16-*{name}.mcap")
    captured = inspect(examine(path)).captured
    assert (captured.first_step, captured.steps) == (first, 60 - first)


def test_json(gsb_info: Command, small_set: list[Path], tmp_path: Path) -> None:
    """Write an object for each file, those that are no recordings included."""
    text = tmp_path / "text.mcap"
    text.write_text("no recording at all, and long enough")
    done = gsb_info(*small_set, text, "--json", "-", code=ExitCode.DATA_LOST)
    document = json.loads(done.stdout)
    assert document["schema_version"] == SCHEMA_VERSION
    assert [file["status"] for file in document["files"]] == ["complete"] * 3 + ["unreadable"]
    first = document["files"][0]
    assert first["provenance"]["configuration"]["n_env"] == 4
    assert first["simulation"]["deviations"][0].keys() == {"parameter", "wanted", "used", "reason"}
    assert first["arrays"][0]["unit"] == "m"
    assert first["integrity"] == {}
    assert first["verified"] is True


def test_several_files(gsb_info: Command, small_set: list[Path]) -> None:
    """Print a block for each file, an empty line between them."""
    blocks = gsb_info(*small_set).stdout.split("\n\n")
    assert ["".join(block.splitlines()[:1]) for block in blocks] == list(map(str, small_set))


@pytest.mark.parametrize("damage", [name for name, (rule, _) in BYTES.items() if rule != "recording"])
def test_damaged_files(damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say what can be said of a damaged file, with what is wrong, and end with 3 where it is damage."""
    rule, change = BYTES[damage]
    path = whole(tmp_path)
    path.write_bytes(change(path.read_bytes()))
    code = main([str(path)])
    shown = capsys.readouterr().out
    assert code == (ExitCode.OK if rule in ("known-records", "crc-present") else ExitCode.DATA_LOST)
    assert "! " in shown
    if damage in ("a chunk", "an attachment"):  # its content is another
        assert "as the file states it: not confirmed" in " ".join(shown.split())
    if damage in ("no CRC", "an index", "a record that nobody knows"):  # its content is the same
        assert "as the file states it" not in shown
    assert shown.startswith(str(path))
    if damage != "an attachment":
        assert "synthetic" in shown


def test_a_changed_attachment_is_not_quoted_as_if_it_were_true(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Warn of what is told from provenance that is not what was recorded."""
    path = whole(tmp_path)
    path.write_bytes(path.read_bytes().replace(b'"seed": 0', b'"seed": 1'))
    assert main([str(path)]) == ExitCode.DATA_LOST
    shown = capsys.readouterr().out
    assert "seed 1" in shown
    assert "CAUTION      provenance.json is not what was recorded" in shown


@pytest.mark.parametrize("damage", [name for name, (rule, _) in BYTES.items() if rule == "recording"])
def test_no_recording(damage: str, gsb_info: Command, tmp_path: Path) -> None:
    """Say in one line why nothing can be said of a file, or what is left of it; end with 3."""
    path = whole(tmp_path)
    path.write_bytes(BYTES[damage][1](path.read_bytes()))
    done = gsb_info(path, code=ExitCode.DATA_LOST)
    assert "Traceback" not in done.stderr
    assert done.stdout or len(done.stderr.splitlines()) == 1


def test_a_run_that_was_cut_short(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Show configuration and states up to the cut."""
    path = whole(tmp_path, steps=400, end=False)
    assert main([str(path)]) == ExitCode.DATA_LOST
    shown = capsys.readouterr().out
    assert re.search(r"status +incomplete: no end record", shown)
    assert re.search(r"states +of cubes, in float64, at \d+ steps", shown)
    assert "of the content: none" in shown


def test_a_run_that_was_never_built(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say why a run failed before its simulator was there; that is no damage."""
    path = whole(tmp_path, built=False, status="FAILED", reason="no memory", cause="DEVICE_MEMORY")
    assert main([str(path)]) == ExitCode.OK
    shown = capsys.readouterr().out
    assert "failed (device memory): no memory" in shown
    assert "which was never built" in shown
    assert re.search(r"throughput +none: the run ended before its timed phase did", shown)


def test_without_verification(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say that nothing was verified where it was not."""
    assert main([str(small), "--no-verify"]) == 0
    shown = capsys.readouterr().out
    assert "not verified (--no-verify)" in shown
    assert "as the file states it: not verified" in " ".join(shown.split())


def test_overflow_gates_and_losses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name buffers that were run into and data that was lost."""
    import numpy as np

    bits = np.zeros((5, 2), dtype=np.uint32)
    bits[3, 1] = 2
    shown = Shown(overflow={"capture": bits}, bits=(OverflowBit(1, "njmax", fatal=True),))
    path = whole(tmp_path, shown=shown, status="INVALID", reason="njmax", cause="BUFFER", dropout="the disk was full")
    assert main([str(path)]) == ExitCode.DATA_LOST
    text = " ".join(capsys.readouterr().out.split())
    assert "njmax in capture, at 1 of 5 recorded steps" in text
    assert "LOST /state: 2 steps from step 1: the disk was full" in text


def test_terminal_sequences_are_made_visible(tmp_path: Path) -> None:
    """Print a stranger's escape sequences, line breaks and deep values as text on their own line."""

    def evil(name: str, record: dict[str, Any]) -> None:
        deep: Any = "\x1b[2J"
        for _ in range(40):
            deep = {"a\nstatus      complete": deep}
        if name == PROVENANCE:
            record["argv"] = ["gsb-record\nstatus      complete", "x" * 100_000]
            record["host"] = {"cpu": "a\nstatus      complete", "note": deep}
        if name == SIMULATION:
            record["version"] = "\x1b]0;owned\x07\ud800"
            record["options"] = {"deep": deep}

    path = write_recording(tmp_path, grid(2), change=evil, status="FAILED", reason="gone")
    text = _printed(path)
    assert "\x1b" not in text
    assert "\\x1b]0;owned\\x07" in text
    said = [line for line in text.splitlines() if line.lstrip().startswith("status")]
    assert ["".join(line.split()) for line in said] == ["statusfailed:gone"]
    assert len(text) < 10_000


def _printed(path: Path) -> str:
    out = io.StringIO()
    print_document(info_document(inspect(examine(path)), every=True), out)
    return out.getvalue()


@pytest.mark.parametrize("forgery", FORGERIES)
def test_forged_files_raise_nothing(forgery: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Show what can be shown of the forged files that strangers may send, as text and as JSON."""
    path = write_recording(tmp_path, grid(2), **FORGERIES[forgery])
    main([str(path)])
    text = capsys.readouterr()
    assert text.out or text.err
    main([str(path), "--json", "-"])
    assert json.loads(capsys.readouterr().out)["files"]


@pytest.mark.parametrize("path", sorted((ROOT / "recordings").glob("*-r0.mcap")), ids=lambda p: p.name)
def test_shipped_recordings_fit_a_terminal(path: Path) -> None:
    """Describe shipped recordings within 120 columns."""
    assert all(len(line) <= 120 for line in _printed(path).splitlines()[1:])


def test_bad_arguments(gsb_info: Command, tmp_path: Path) -> None:
    """End with 2 without a file, and where a recording would be overwritten."""
    path = whole(tmp_path)
    before = path.read_bytes()
    assert gsb_info().returncode == ExitCode.USAGE
    assert gsb_info("--json", path, path).returncode == ExitCode.USAGE
    assert path.read_bytes() == before
