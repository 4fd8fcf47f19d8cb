"""Errors of recorders that were found after recordings had been made: which recordings show them, and who says so."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.read.known_errors import KNOWN_ERRORS, PREFIX, known_errors
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Section
from gpusimbench.evaluator.report.sections import provenance
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.recorder.simulators.mujoco.model import raised_tolerance
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.provenance import SIMULATION
from tests.conftest import call
from tests.synthetic import changing, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
H200 = ROOT / "recordings" / "h200"
BRAX = sorted(H200.glob("brax-positional-*.mcap"))
ONCE = "overflow bits are gathered on the device from the contacts that the step found"


def brax(folder: Path, covers: str = "", **keywords: Any) -> Path:
    """A recording of Brax with contacts; its recorder searched for collisions once where `covers` says so."""
    return write_recording(
        folder, None, simulator="brax", whole=True, proven=True,
        change=changing(SIMULATION, timing_covers=covers), **keywords,
    )  # fmt: skip


def errors_of(path: Path) -> list[str]:
    """The simulators of the errors that a recording shows."""
    return [error.simulator for error in known_errors(Recording(path))]


def test_shipped_recordings_with_a_known_error() -> None:
    """Find the errors of one folder's card, models on Newton from before a correction, everything that MuJoCo Warp
    stepped before its tolerance was stated, and no other."""
    found: Counter[tuple[str, str]] = Counter()
    for path in sorted((ROOT / "recordings").rglob("*.mcap")):
        recording = Recording(path)
        errors = known_errors(recording)
        found.update((path.parent.name, error.simulator) for error in errors if not error.in_force)
        assert any(error.in_force for error in errors) == _raised_without_saying_so(recording), path
    assert found == {
        **{("h200", "brax"): 2, ("h200", "genesis"): 10, ("h200", "isaaclab"): 2},
        **{("ant", "newton"): 1, ("humanoid", "newton"): 2, ("manipulator", "newton"): 2},
    }


def _raised_without_saying_so(recording: Recording) -> bool:
    simulation, simulator = recording.simulation, recording.configuration.simulator
    if simulation is None or any(deviation.parameter == "option.tolerance" for deviation in simulation.deviations):
        return False
    return simulator == "warp" or (simulator == "newton" and simulation.options["solver"] == "mujoco")


RAISED = [asdict(deviation) for deviation in raised_tolerance(1e-8, float(np.float32(1e-6)))]
"""What a recorder says of MuJoCo Warp's tolerance."""


@pytest.mark.parametrize(
    ("simulator", "options", "said", "shown", "in_force"),
    [
        ("warp", {"tolerance": 1e-8}, [], True, "1e-06"),
        ("warp", {"tolerance": 1e-8}, RAISED, False, "1e-06"),
        ("warp", {"tolerance": 0.0}, [], True, "1e-06"),
        ("warp", {"tolerance": float(np.float32(1e-6))}, [], False, "1e-06"),
        ("warp", {"tolerance": 1e-4}, [], False, "0.0001"),
        ("warp", {"tolerance": 1e-8}, [{**RAISED[0], "used": "2e-05"}], False, "2e-05"),
        ("warp", {"tolerance": 1e-8}, [{**RAISED[0], "used": "larger"}], True, "1e-06"),
        ("warp", {"tolerance": "1e-08"}, [], False, "1e-08"),
        ("warp", {}, RAISED, False, ""),
        ("newton", {"tolerance": float(np.float32(1e-8)), "solver": "mujoco"}, [], True, "1e-06"),
        ("newton", {"tolerance": 1e-8, "solver": "mujoco"}, RAISED, False, "1e-06"),
        ("newton", {"tolerance": 1e-8, "solver": "xpbd"}, [], False, "1e-08"),
        ("mjx", {"tolerance": 1e-8, "impl": "warp"}, [], False, "1e-08"),
        ("mujoco", {"tolerance": 1e-8}, [], False, "1e-08"),
    ],
)  # fmt: skip
def test_the_tolerance_in_force(
    simulator: str, options: dict[str, Any], said: list[Any], shown: bool, in_force: str, tmp_path: Path
) -> None:
    """Show the tolerance that MuJoCo Warp had, whether a recording states it or not, and the stated one of others."""
    path = write_recording(
        tmp_path, None, simulator=simulator, in_force=options, change=changing(SIMULATION, deviations=said)
    )
    assert errors_of(path) == [simulator] * shown
    (result,) = evaluate_files([path]).results
    assert result.timed.settings["tolerance"] == in_force


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("cpu/warp-*r0", "1e-06"),
        ("sweeps-h100/newton-mujoco-franka-n4096-r0", "1e-06"),
        ("protocol-h200/mjx-warp-*r0", "1e-08"),
        ("protocol-h200/isaaclab-newton-*r0", "1e-06"),
        ("mujoco-amd-r0", "1e-08"),
    ],
)
def test_the_tolerance_of_shipped_recordings(name: str, tolerance: str) -> None:
    """Show it beside the throughput, and in the list of options in force."""
    evaluation = evaluate_files(sorted((ROOT / "recordings").glob(f"{name}.mcap"))[:1])
    (result,) = evaluation.results
    assert result.timed.settings["tolerance"] == tolerance
    told = provenance.section(Source(evaluation, False, ""))
    assert _facts(told, "Options in force")["tolerance"] == tolerance


def _facts(section: Any, title: str) -> dict[str, str]:
    """Values by name in the only part of a section that has a title."""
    if section.title == title:
        return {name: cell.text for facts in section.blocks for name, cell in facts.pairs}
    parts = [part for part in section.blocks if isinstance(part, Section)]
    return next((found for part in parts if (found := _facts(part, title))), {})


def test_what_a_recording_shows_its_error_by(tmp_path: Path) -> None:
    """Tell a recorder with an error by what the recording states, and by nothing else."""
    assert errors_of(brax(tmp_path)) == ["brax"]
    assert not errors_of(brax(tmp_path, ONCE))
    assert not errors_of(brax(tmp_path, built=False, status="FAILED"))
    stated: dict[Any, bool] = {0.01: True, 0.02: False, "0.01": False, None: False, True: False, -1.0: False}
    for value, shown in stated.items():
        options = {"constraint_timeconst": value, "substeps": 1}
        path = write_recording(tmp_path, None, simulator="genesis", dt=0.01, in_force=options)
        assert bool(errors_of(path)) is shown, value
    two = {"constraint_timeconst": 0.01, "substeps": 2}
    assert not errors_of(write_recording(tmp_path, None, simulator="genesis", dt=0.01, in_force=two))
    friction = {"parameter": "contact.friction", "wanted": "a patch", "used": "two points", "reason": "PhysX"}
    for backend, deviations, shown in (("ovphysx", [], True), ("newton", [], False), ("ovphysx", [friction], False)):
        path = write_recording(
            tmp_path, None, simulator="isaaclab", in_force={"backend": backend},
            change=changing(SIMULATION, deviations=deviations),
        )  # fmt: skip
        assert bool(errors_of(path)) is shown, (backend, deviations)
    for parameter, wanted, used, shown in (
        ("option.disableflags", "none", "multiccd", True),
        ("option.disableflags", "multiccd", "gravity, multiccd", False),
        ("option.disableflags", "none", "gravity", False),
        ("option.solver", "PGS", "multiccd", False),
    ):
        flag = {"parameter": parameter, "wanted": wanted, "used": used, "reason": "so it is made"}
        path = write_recording(tmp_path, None, simulator="newton", change=changing(SIMULATION, deviations=[flag]))
        assert bool(errors_of(path)) is shown, flag


def test_a_wrong_throughput_has_no_value_and_a_note_says_why(tmp_path: Path) -> None:
    """Give the reason in place of throughput and capture overhead; keep the other figures."""
    (result,) = evaluate_files(BRAX).results
    (error,) = (error for error in KNOWN_ERRORS if error.simulator == "brax")
    assert why_missing(result.metrics["fps"].value) == f"{PREFIX}{error.said}"
    assert result.metrics["build_time"].value
    assert result.doubts == (f"{PREFIX}{error.said}",)
    assert result.doubts[0] in result.notes
    said = " ".join(call("gsb-eval", *BRAX, *H200.glob("physx-inclined*r0.mcap")).stdout.split())
    assert f"brax: {PREFIX}{error.said}" in said
    clocked = {"clocks": {"capture": 1.0}}
    runs = [brax(tmp_path, **clocked), brax(tmp_path, ONCE, run=1, **clocked)]
    (mixed,) = evaluate_files(runs).results
    assert [mixed.metrics[name].n for name in ("fps", "capture_slowdown")] == [1, 1]
    assert f"1 of 2 runs: {PREFIX}{error.said}" in mixed.notes


def test_a_wrong_throughput_has_no_place(tmp_path: Path) -> None:
    """Leave a row without a place, with the error as the reason, however fast it was."""
    (tmp_path / "runs").mkdir()
    for run in range(2):
        write_recording(
            tmp_path / "runs", None, simulator="slower", run=run, whole=True, proven=True, elapsed_s=2.0
        )  # fmt: skip
        brax(tmp_path / "runs", run=run)
    call("gsb-share", "leaderboard", tmp_path / "runs", "--out", tmp_path / "board")
    board = json.loads((tmp_path / "board" / "leaderboard.json").read_text())
    rows = {row["simulator"]: row for section in board["sections"] for row in section["rows"]}
    assert rows["slower"]["place"] == 1
    assert rows["brax"]["place"] is None
    assert "searched for collisions twice" in rows["brax"]["place_missing"]


def test_a_wrong_throughput_is_not_compared(tmp_path: Path) -> None:
    """Take a correction of the recorder for no improvement of the engine."""
    for side, covers, seconds in (("base", "", 1.6), ("head", ONCE, 1.0)):
        (tmp_path / side).mkdir()
        for run in range(6):
            brax(tmp_path / side, covers, run=run, elapsed_s=seconds)
    done = call("gsb-compare", tmp_path / "base", tmp_path / "head", "--json", "-", code=ExitCode.NOTHING_COMPARABLE)
    (compared,) = json.loads(done.stdout)["compared"]
    (fps,) = (finding for finding in compared["findings"] if finding["name"] == "fps")
    assert fps["change"] == "not compared", fps
    assert "searched for collisions twice" in json.dumps(fps)
    assert any(note.startswith(f"base: {PREFIX}") for note in compared["notes"])
    assert not any(note.startswith(f"head: {PREFIX}") for note in compared["notes"])


def test_check_warns_of_each_error_once(tmp_path: Path) -> None:
    """Warn of each error with the number of its files; stay silent with a set of rules that does not ask."""
    files = [brax(tmp_path), brax(tmp_path, run=1), brax(tmp_path, ONCE, run=2)]
    options = {"constraint_timeconst": 0.5, "substeps": 1}
    files.append(write_recording(tmp_path, grid(1), simulator="genesis", in_force=options, whole=True))
    done = call("gsb-check", *files)
    warned = [line for line in done.stdout.splitlines() if line.startswith("warning known-errors")]
    assert len(warned) == 2
    assert "4 files, 3 warnings" in done.stdout.splitlines()[0]
    assert "known-errors" not in call("gsb-check", "--rules", "integrity-1", *files).stdout
    caution = " ".join(call("gsb-info", files[0]).stdout.split())
    assert f"CAUTION {PREFIX}each timed step searched" in caution
    assert "CAUTION" not in call("gsb-info", files[2]).stdout


def test_a_run_keeps_what_shows_its_error() -> None:
    """Show the same errors once the file is closed, when what is left of it stands for it."""
    run = Reader(5.0, verify=False)(BRAX[0])
    assert known_errors(run) == known_errors(Recording(BRAX[0]))  # type: ignore[arg-type]
