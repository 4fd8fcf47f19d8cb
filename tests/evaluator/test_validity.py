"""What shows that steps did their work: counts, buffers, overflow and actions, from files to every presentation."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.compare.counted import compare_misplaced
from gpusimbench.evaluator.compare.finding import Change, Finding
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report import verdicts, words
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.results.details import CaptureOverhead
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.faults import faults, faults_anywhere
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.validity import Misplaced
from gpusimbench.evaluator.runs.validation import demands, verify
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import Buffer, OverflowBit
from tests.conftest import Command, call
from tests.pages import part as part_of
from tests.pages import text_of
from tests.reading import verified
from tests.synthetic import Shown, grid, write_recording

BITS = (OverflowBit(0, "NEFC", fatal=True), OverflowBit(9, "ITERATIONS", fatal=False))
COUNTS = np.array([[2, 4], [6, 8], [0, 10]])
"""Contacts of three captured steps in two environments."""


def only(*files: Path) -> GroupResult:
    """The only group of some files."""
    (result,) = evaluate_files(files).results
    return result


def table(evaluation: Evaluation) -> str:
    """All that the command shows, in one line."""
    return " ".join(text_of(evaluation).split())


def overflowing(rows: int, step: int, bits: int, envs: int = 2) -> np.ndarray:
    """Bits of some captured steps that fire in one environment from `step` on, shape [row, env]."""
    found = np.zeros((rows, envs), dtype=np.uint32)
    found[step - 1 :, 0] = bits
    return found


def broken(folder: Path, run: int, final: np.ndarray) -> Path:
    """A run that the recorder calls invalid since it dropped contacts."""
    return write_recording(
        folder, final, run=run, status="INVALID", cause="BUFFER", reason="NEFC overflowed: contacts were dropped",
        elapsed_s=0.001, shown=Shown(counts={"capture": {"contacts": np.full((5, len(final)), 999)}},
                                     overflow={"capture": overflowing(5, 3, 1, len(final))}, bits=BITS),
    )  # fmt: skip


def test_every_stream_is_verified(small_set: list[Path]) -> None:
    """Read every stream before a recording's numbers are used: one of a new kind, too."""
    recording = Recording(small_set[0])
    for demand in demands(recording):
        demand()
    streams = {name for name, value in vars(Recording).items() if isinstance(value, cached_property)}
    assert streams - vars(recording).keys() == {"varied"}  # gsb-check holds it against the configuration


def test_positions_without_states_have_the_unit_of_the_format(tmp_path: Path) -> None:
    """Call a field of positions in centimetres damage, even where no state is recorded that would be read."""

    def in_cm(_: str, record: dict[str, Any]) -> None:
        for field in record.get("fields", ()):
            field["unit"] = "cm"

    with pytest.raises(DamagedRecording, match="cubes/position is in cm"):
        verify(Recording(write_recording(tmp_path, None, change=in_cm)))
    verify(Recording(write_recording(tmp_path, None)))


def test_counts_of_a_real_set(small_set: list[Path]) -> None:
    """Read what MuJoCo counted: every captured step, two of the timed phase, and a stack that rests on contacts."""
    recording = open_recording(small_set[0])
    contacts = recording.counts["capture"]["contacts"]
    assert contacts.steps.tolist() == list(range(1, 101))
    assert recording.counts["timed"]["contacts"].steps.tolist() == [10, 30]
    assert contacts.mean.min() > 0
    assert (contacts.mean <= contacts.max).all()
    assert recording.overflows["capture"].steps.tolist() == list(range(1, 101))
    validity = only(*small_set).validity
    assert (validity.overflow, validity.overflow_told.yes) == ((), True)  # MuJoCo C had room for everything
    counted = validity.of("constraint_rows")
    assert (counted.phase, counted.rows, counted.n_run) == ("capture", 300, 3)
    assert counted.mean == pytest.approx(recording.counts["capture"]["constraint_rows"].mean.mean())
    assert {"build", "compile_timed", "compile_capture"} <= set(recording.timing)


def test_actions_of_a_real_run(tmp_path: Path, gsb_record: Command) -> None:
    """Read which actions a run applied, and that the engine was asked for the last of them."""
    small = ("--steps", 4, "--warmup", 1, "--timed-steps", 2, "--n-env", 2, "--runs", 2)
    gsb_record("--sim", "mujoco", "--scene", "franka", *small, "--out", tmp_path, code=0)
    found = {a.phase: a for a in only(*tmp_path.glob("*.mcap")).validity.actions}
    assert set(found) == {"timed", "capture"}
    assert (found["timed"].verified, found["timed"].n_run, len(found["timed"].sha256)) == (2, 2, 1)
    assert json.loads(found["capture"].generators[0])["seed"] == 0


def test_the_definitions(tmp_path: Path) -> None:
    """Compute mean, mean percentile and maximum per step and environment, over steps and runs."""
    shown = Shown(counts={"capture": {"contacts": COUNTS}, "timed": {"contacts": np.array([[1, 3]])}})
    more = Shown(counts={"capture": {"contacts": COUNTS + 10}})
    found = only(
        write_recording(tmp_path, grid(2), shown=shown), write_recording(tmp_path, grid(2), run=1, shown=more)
    ).validity
    contacts = found.of("contacts")
    assert contacts.mean == pytest.approx(COUNTS.mean() + 5)
    assert contacts.p95 == pytest.approx(np.mean([4, 8, 10]) + 5)
    assert contacts.max == 20
    timed = found.of("contacts", "timed")
    assert (timed.mean, timed.max, timed.n_run) == (2, 3, 1)
    assert found.of("solver_iterations") is None


@pytest.mark.parametrize(("per", "needed"), [("env", 10), ("all", 14)])
def test_buffers(tmp_path: Path, per: str, needed: float) -> None:
    """Need the fullest environment of a buffer per env, and the fullest step of one that all share."""
    shown = Shown(
        counts={"capture": {"contacts": COUNTS}}, buffers=(Buffer("nconmax", 20, per, "contacts", "a guess"),)
    )
    result = only(write_recording(tmp_path, grid(2), shown=shown))
    (use,) = result.validity.buffers
    assert use.needed == pytest.approx(needed)
    assert use.share == pytest.approx(needed / 20)
    assert f"nconmax: {needed} of 20" in table(evaluate_files([r.path for r in result.group.recordings]))


def test_buffers_that_nothing_counts(tmp_path: Path) -> None:
    """Say that it is not told how much of a buffer was needed, instead of nothing."""
    shown = Shown(buffers=(Buffer("pairs", 0, "all"), Buffer("arena", 20, "env", "cells")))
    found = only(write_recording(tmp_path, grid(2), shown=shown)).validity.buffers
    assert [(use.needed, use.share) for use in found] == [(None, None), (None, None)]


def test_failed_runs_show_what_they_needed(tmp_path: Path) -> None:
    """Count a buffer's need over all runs: the one that overflowed is the one to learn from."""
    counts = {"capture": {"contacts": COUNTS * 10}}
    bits = {"capture": overflowing(3, 2, 1)}
    buffers = (Buffer("nconmax", 50, "env", "contacts"),)
    shown = Shown(counts=counts, overflow=bits, bits=BITS, buffers=buffers)
    good = write_recording(tmp_path, grid(2), shown=Shown(counts={"capture": {"contacts": COUNTS}}, buffers=buffers))
    bad = write_recording(tmp_path, grid(2), run=1, shown=shown, status="INVALID", cause="BUFFER", reason="overflow")
    (use,) = only(good, bad).validity.buffers
    assert (use.needed, use.share) == (100, 2.0)


def test_overflow_is_described(tmp_path: Path) -> None:
    """Name each bit that fired, with its weight, how often, in how many environments, and since when."""
    shown = Shown(overflow={"capture": overflowing(5, 4, 1 << 9)}, bits=BITS)
    late = Shown(overflow={"capture": overflowing(5, 2, 1 << 9), "timed": overflowing(1, 1, 1 << 9)}, bits=BITS)
    result = only(
        write_recording(tmp_path, grid(2), shown=shown), write_recording(tmp_path, grid(2), run=1, shown=late)
    )
    (seen,) = result.validity.overflow
    assert (seen.name, seen.fatal, seen.rows, seen.envs, seen.n_run) == ("ITERATIONS", False, 7, 1, 2)
    assert (seen.phase, seen.first_step, seen.first_step_exact) == ("capture", 2, True)
    assert len(result.group.complete) == 2  # nothing was dropped
    quiet = only(write_recording(tmp_path, grid(2), shown=Shown(overflow={"capture": overflowing(5, 6, 1)}, bits=BITS)))
    assert quiet.validity.overflow == ()
    assert only(write_recording(tmp_path, grid(2))).validity.overflow is None


def test_a_bit_that_nothing_describes(tmp_path: Path) -> None:
    """Show a bit of an engine that simulation.json does not explain, and pass no judgement."""
    shown = Shown(overflow={"capture": overflowing(5, 4, 1 << 7)}, bits=BITS)
    (seen,) = only(write_recording(tmp_path, grid(2), shown=shown)).validity.overflow or ()
    assert (seen.name, seen.fatal) == ("bit 7", None)


def test_an_invalid_run_enters_no_mean_and_is_seen_everywhere(tmp_path: Path) -> None:
    """Leave a run that dropped contacts out of every value, and mark it in table, JSON and HTML with its reason."""
    counts = {"capture": {"contacts": np.full((5, 2), 7)}}
    good = [
        write_recording(tmp_path, grid(2), run=r, shown=Shown(counts, {"capture": overflowing(5, 9, 1)}, BITS))
        for r in range(2)
    ]
    evaluation = evaluate_files([*good, broken(tmp_path, 2, grid(2) + 1.0)])
    (result,) = evaluation.results
    assert result.metrics["fps"].value == pytest.approx(2000)
    assert result.metrics["w1_run_to_run"].value == 0
    contacts = result.validity.of("contacts")
    assert contacts.max == 7

    printed = table(evaluation)
    assert "1 INVALID (buffer)" in printed
    assert "NEFC (DROPPED) at 3 recorded steps, first at step 3" in printed
    assert "NEFC overflowed: contacts were dropped" in printed
    document = to_json(evaluation)
    (group,) = document["groups"]
    assert group["outcomes"] == {"complete": 2, "invalid": 1, "failed": 0, "incomplete": 0, "lost data": 0}
    assert group["validity"]["overflow"][0]["fatal"] is True
    assert [r["cause"] for r in document["recordings"]] == ["", "", "buffer"]
    page = render_html(evaluation, published=False, command="")
    for section in ("variability", "throughput", "validity"):
        part = part_of(page, section)
        assert "1 INVALID (buffer) of 3 runs" in part, section
    assert "NEFC overflowed: contacts were dropped" in page.partition("<main>")[0]


def test_only_invalid_runs(tmp_path: Path) -> None:
    """Give no value at all where every run is invalid."""
    result = only(broken(tmp_path, 0, grid(2)))
    assert all(isinstance(metric.value, Missing) for metric in result.metrics.values())
    assert result.validity.counted == ()


def test_a_complete_run_that_overflowed_is_no_complete_run(tmp_path: Path) -> None:
    """Refuse a file that calls itself complete while a fatal bit is set: the recorder would not have."""
    shown = Shown(overflow={"capture": overflowing(5, 2, 1)}, bits=BITS)
    path = write_recording(tmp_path, grid(2), shown=shown)
    evaluation = evaluate_files([path])
    assert evaluation.results == ()
    (unreadable,) = evaluation.unreadable
    assert "says that it is complete, but NEFC overflowed by step 2 of the capture phase" in str(unreadable.error)


def test_different_actions_are_noted(tmp_path: Path) -> None:
    """Say so where the runs of a group were not given the same actions."""
    files = []
    for run, digest in enumerate("ab"):
        message = message_class("gsb.v1.ActionStream")(
            generator="{}", steps=5, envs=2, first_sha256=digest * 64, last_sha256=digest * 64, verified=run == 0
        )
        files.append(write_recording(tmp_path, grid(2), run=run, shown=Shown(streams={"capture": message})))
    result = only(*files)
    (applied,) = result.validity.actions
    assert (applied.verified, applied.n_run, len(applied.sha256)) == (1, 2, 2)
    assert any("different actions" in note for note in result.notes)


def test_build_and_compilation(tmp_path: Path) -> None:
    """Show the median over runs: the first one fills the caches of the others."""
    files = [
        write_recording(tmp_path, grid(2), run=r, clocks={"build": b, "compile_timed": c})
        for r, (b, c) in enumerate([(5.0, 120.0), (1.0, 2.0), (1.5, 3.0)])
    ]
    found = only(*files).metrics
    assert found["build_time"].value == 1.5
    assert found["compile_time"].value == 3.0
    assert found["compile_time"].unit == "s"
    captured = only(write_recording(tmp_path, grid(2), elapsed_s=None, clocks={"compile_capture": 9.0})).metrics
    assert captured["compile_time"].value == 9.0
    assert why_missing(captured["build_time"].value) == "building was not clocked"


def test_what_capturing_costs(tmp_path: Path) -> None:
    """Compare a captured step with a timed one, and say how much of it was waiting for the disk."""
    files = [
        write_recording(tmp_path, grid(2), run=r, elapsed_s=1.0, timed_steps=100, clocks={"capture": 6.0, "stall": 1.5})
        for r in range(2)
    ]
    steps = open_recording(files[0]).configuration.steps
    found = only(*files)
    slowdown = found.metrics["capture_slowdown"]
    assert slowdown.value == pytest.approx(6.0 / steps / (1.0 / 100))
    assert slowdown.of(CaptureOverhead).stalled_share == pytest.approx(0.25)
    assert words.capturing(slowdown).endswith("; 25.0% of the time waiting for the disk")
    assert "captured and timed steps are other steps of the scene" in table(evaluate_files(files))
    without = only(write_recording(tmp_path, grid(2), elapsed_s=None, clocks={"capture": 6.0})).metrics
    assert why_missing(without["capture_slowdown"].value) == "timed and captured steps were not both clocked"


def test_a_cause_of_a_later_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read a cause that this version does not know, and show its number."""
    from gpusimbench.recorder.capture import sink

    original = sink.enum_values
    monkeypatch.setattr(sink, "enum_values", lambda name: {**original(name), "CAUSE_LATER": 77})
    path = write_recording(tmp_path, grid(1), status="FAILED", reason="of the future", cause="LATER")
    monkeypatch.undo()
    assert open_recording(path).cause == "77"


def _known_causes() -> list[str]:
    names = [name.removeprefix("CAUSE_") for name in enum_values("gsb.v1.Cause")]
    return [name for name in names if name != "UNSPECIFIED"]


@pytest.mark.parametrize("cause", _known_causes())
def test_causes(tmp_path: Path, cause: str) -> None:
    """Read back every cause that the recorder writes."""
    recording = verified(write_recording(tmp_path, grid(1), status="FAILED", reason="r", cause=cause))
    assert recording.cause == cause.replace("_", " ").lower()


def test_older_recordings_have_none_of_it() -> None:
    """Read recordings of the time before counts were recorded, with nothing said of them."""
    path = next((Path(__file__).parents[2] / "recordings").glob("*.mcap"))
    recording: Any = open_recording(path)
    assert recording.cause == ""
    result = only(path)
    assert not isinstance(result.metrics["fps"].value, Missing)
    assert result.validity.buffers == ()


def test_every_value_has_a_row_in_the_documents() -> None:
    """Define every metric in docs/metrics.md."""
    root = Path(__file__).parents[2]
    documented = (root / "docs" / "metrics.md").read_text(encoding="utf-8")
    for name in only(next((root / "recordings").glob("*.mcap"))).metrics:
        assert f"`{name}`" in documented, name


def test_the_command_prints_it(small_set: list[Path]) -> None:
    """Show contacts and preparation times in the table of the command."""
    shown = call("gsb-eval", *small_set, "--sample-time", "1", "--all").stdout
    assert "contacts: " in shown
    assert "time to" in shown
    assert "build" in shown
    assert "no run is INVALID" in shown


def misplacing(folder: Path, run: int, *counts: int) -> Path:
    """A complete run of two environments, of which the first has so many misplaced contacts at each captured step."""
    found = np.stack([np.array(counts), np.zeros(len(counts), int)], axis=1)
    shown = Shown(counts={"capture": {"misplaced_contacts": found}})
    return write_recording(folder, grid(2), run=run, run_id=f"run {run}", whole=True, shown=shown)


def test_misplaced_contacts_are_said_everywhere(tmp_path: Path) -> None:
    """Call a group not valid whose complete runs have contacts outside of their bodies: in verdict, table, page, JSON,
    faults, and by gsb-check with the step; and say nothing where there are none."""
    paths = [misplacing(tmp_path, 0, 0, 0, 3, 0, 1), misplacing(tmp_path, 1, 0, 0, 0, 0, 0)]
    evaluation = evaluate_files(paths)
    (result,) = evaluation.results
    assert len(result.group.complete) == 2
    said = "4 misplaced contacts in 1 of 2 runs"
    assert result.validity.misplaced == Misplaced(4, 1, 2)
    assert (faults(result).misplaced, str(faults(result))) == (said, said)
    assert faults_anywhere(result, evaluation.results) == (f"{said} ({result.group.key.scene})",)
    assert "no: 1 of 2 runs: misplaced contacts" in " ".join(call("gsb-eval", *paths).stdout.split())
    assert said in table(evaluation)
    assert "What is wrong with this set: 1 run with misplaced contacts" in " ".join(table(evaluation).split())
    assert said in part_of(render_html(evaluation, published=False, command=""), "validity")
    (group,) = to_json(evaluation)["groups"]
    assert group["faults"]["misplaced"] == said
    assert group["validity"]["misplaced_contacts"] == {"contacts": 4, "n_run": 1, "of": 2}
    checked = " ".join(call("gsb-check", *paths, code=0).stdout.split())
    assert "1 warning" in checked
    assert "misplaced-contacts: 4 misplaced contacts in the capture phase, first at step 3" in checked

    clean = evaluate_files(paths[1:])
    assert clean.results[0].validity.misplaced == Misplaced(0, 0, 1)
    assert not faults(clean.results[0])
    assert "misplaced contacts" not in call("gsb-eval", paths[1]).stdout
    assert "misplaced" not in to_json(clean)["groups"][0]["faults"]
    assert "misplaced" not in call("gsb-check", paths[1], code=0).stdout


def test_misplaced_contacts_that_are_not_counted(tmp_path: Path) -> None:
    """Say nothing of runs that do not count them, in words or keys, and count them out of those that do."""
    shown = Shown(counts={"capture": {"contacts": COUNTS}})
    silent = write_recording(tmp_path, grid(2), run=1, whole=True, shown=shown)
    (group,) = to_json(evaluate_files([silent]))["groups"]
    assert "misplaced_contacts" not in group["validity"]
    assert "misplaced" not in group["faults"]
    both = only(misplacing(tmp_path, 0, 0, 1), silent)
    assert both.validity.misplaced == Misplaced(1, 1, 1)
    assert verdicts.valid([both]).notes == ("1 of 1 run: misplaced contacts",)


def test_misplaced_contacts_are_compared(tmp_path: Path) -> None:
    """Call misplaced contacts of head alone a regression, and of base alone an improvement; of neither, say nothing."""
    runs = [misplacing(tmp_path, 0, 0, 0, 0), misplacing(tmp_path, 1, 0, 2, 0)]
    runs.append(write_recording(tmp_path, grid(2), run=2, run_id="run 2", whole=True))
    clean, wrong, silent = (evaluate_files([path]).results[0].group.complete for path in runs)
    assert compare_misplaced(clean, clean) is None
    assert compare_misplaced(silent, silent) is None
    found = [compare_misplaced(*sides) for sides in ((clean, wrong), (wrong, clean), (silent, wrong))]
    changes = [one.change if isinstance(one, Finding) else None for one in found]
    assert changes == [Change.REGRESSION, Change.IMPROVEMENT, Change.NOT_COMPARED]
