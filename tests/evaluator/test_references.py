"""What each scene of a set is compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.reference import References, references
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.provenance import REAL

RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"


@pytest.fixture(scope="module")
def run() -> Run:
    """A shipped run."""
    return read_run(Recording(RECORDINGS / "mujoco-amd-r0.mcap"), 5.0)


def trials(run: Run, scene: str) -> Run:
    """The run as real trials of a scene."""
    configuration = replace(run.configuration, simulator=REAL, scene=scene)
    return replace(run, provenance=replace(run.provenance, configuration=configuration))


def scene_of(found: References, scene: str) -> str:
    """The scene of the reference that a scene is compared with."""
    reference = found.of(scene)
    return reference.scene


def test_each_scene_has_its_own(run: Run) -> None:
    """Compare a scene with its own trials; one without trials with those of the first evaluated scene that has any."""
    found = references(None, [trials(run, "ramp"), trials(run, "fall"), run], ["other", "fall", "ramp"])
    assert [scene_of(found, scene) for scene in ("ramp", "fall", "other")] == ["ramp", "fall", "fall"]
    name = run.path.name
    assert found.said == f"compared with the real trials in {name} and the real trials in {name}"


def test_a_given_reference_is_that_of_every_scene(run: Run) -> None:
    """Leave the trials among the files aside where a reference is given."""
    found = references(run, [trials(run, "ramp")], ["ramp"])
    assert scene_of(found, "ramp") == run.configuration.scene
    assert found.said == f"compared with mujoco with 16 envs, dt {run.configuration.dt:g} s in {run.path.name}"


def test_why_there_is_none(run: Run) -> None:
    """Say why a scene is compared with nothing: no trials, too many of them, or trials that cannot be used."""
    several = [trials(run, "ramp"), trials(run, "ramp")]
    failed = replace(trials(run, "ramp"), status="failed", reason="the engine stopped")
    for runs, why in (
        ([run], "no reference: give real trials or another recording with --reference"),
        (several, "2 recordings of real trials of ramp are here: choose one with --reference"),
        ([failed], f"the reference {run.path.name} is failed: the engine stopped"),
    ):
        found = references(None, runs, ["ramp"])
        assert found.of("ramp") == Missing(why)
        assert (found.said, found.main) == (why, None)
