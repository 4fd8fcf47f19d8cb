"""Which files an audit takes: each run once, and of a damaged file one sentence for each thing that is wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

from gpusimbench.evaluator.audit.audit import check_files
from gpusimbench.evaluator.audit.replays import unreproduced
from gpusimbench.evaluator.audit.verdict import Match, ladder
from gpusimbench.evaluator.read.recording import Recording
from tests.conftest import SMALL, Command
from tests.synthetic import grid, write_recording


def test_copies_count_once(tmp_path: Path) -> None:
    """Take one of two copies and say which was dropped; two runs with the same numbers are two."""
    runs = [write_recording(tmp_path, grid(2), run_id=run_id, name=f"{run_id}.mcap") for run_id in ("one", "two")]
    copy = tmp_path / "copy.mcap"
    shutil.copy(runs[0], copy)
    checked = check_files([*runs, copy])
    assert [recording.path for recording in checked.recordings] == runs
    assert f"{copy} is a copy of one.mcap; it counts once" in checked.warnings[runs[0]]
    assert copy not in (checked.damaged | checked.warnings | checked.broken)


def test_a_run_with_two_contents_is_refused(tmp_path: Path) -> None:
    """Set both aside, since one of them was changed."""
    files = [write_recording(tmp_path, grid(2) + moved, run_id="one", name=f"{moved}.mcap") for moved in (0, 1)]
    checked = check_files(files)
    assert (checked.recordings, list(checked.damaged)) == ((), files)


def test_one_reason_is_given_once(tmp_path: Path) -> None:
    """Say of a missing file and of text that it is no recording, once, and of a cut file what is wrong with it."""
    missing, text, cut = tmp_path / "missing.mcap", tmp_path / "text.mcap", tmp_path / "cut.mcap"
    text.write_text("no recording")
    whole = write_recording(tmp_path, grid(2)).read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    damaged = check_files([missing, text, cut]).damaged
    assert damaged[missing] == (f"recording: cannot read {missing}: No such file or directory",)
    assert len(damaged[text]) == 1
    reasons = [sentence.split(": ", 1)[1] for sentence in damaged[cut]]
    assert reasons
    assert len(set(reasons)) == len(reasons)
    assert not any("cannot be checked" in sentence for sentence in damaged[cut])


def test_an_original_that_no_replay_gave(small_set: list[Path], gsb_record: Command, tmp_path: Path) -> None:
    """Name the original whose states did not come out again; the others of its set do not vouch for it."""
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 4, "--runs", 1, "--option", "cone=pyramidal", *SMALL, "--out", tmp_path, code=0
    )
    honest, replay, other = (Recording(path) for path in (*small_set[:2], Path(done.stdout.strip())))
    assert unreproduced([honest], [replay]) == ""
    assert unreproduced([honest, other], [replay]).endswith(f"no replay gave the states of {other.path.name}")
    left = unreproduced([honest, other], [replay])
    match = Match(bit_identical=True, same_up_to_env_order=True, max_ulp=0, left_out=left)
    verdict = ladder([match], lambda: "not asked", max_ulps=0, originals=2)
    assert verdict.level is None
    assert [rung.holds for rung in verdict.rungs] == [None] * 4
