"""The sample time where none is named: 5 s, or the last time that all recordings of a scene have."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import compare, evaluate
from gpusimbench.evaluator.compute.work import HERE
from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.inputs.sample_time import last_common_time, read_sampled
from gpusimbench.evaluator.missing import Missing
from tests.conftest import call, recorded
from tests.synthetic import grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
LONG = ROOT / "recordings" / "mujoco-amd-r0.mcap"


def _time(*files: Path, reference: Path | None = None) -> float:
    evaluation = evaluate(files, reference=reference)
    (scene,) = {result.group.key.scene for result in evaluation.results}
    return evaluation.sampled_at(scene)


def test_shorter_recordings(small_set: list[Path]) -> None:
    """Compare positions at the end of recordings of a second, say so, and give what --sample-time 1 gives."""
    done = call("gsb-eval", *small_set, "--json", "-", "--no-cache")
    asked = call("gsb-eval", *small_set, "--json", "-", "--no-cache", "--sample-time", 1)
    found, wanted = json.loads(done.stdout), json.loads(asked.stdout)
    note = "inclined-collision: positions are compared at 1 s, the last time that all its recordings have; none has 5 s"
    assert found["sample_time_s"] == 1.0
    assert note in found["notes"]
    assert [n for n in found["notes"] if n != note] == wanted["notes"]
    assert found["groups"] == wanted["groups"]
    printed = call("gsb-eval", *small_set)
    assert "at 1 s, the last time that all its recordings have" in " ".join(printed.stdout.split())


def test_a_time_that_is_named(small_set: list[Path]) -> None:
    """Keep to the user's time, even if no recording has it."""
    (group,) = json.loads(call("gsb-eval", *small_set, "--json", "-", "--sample-time", 5).stdout)["groups"]
    assert "step 500 (5 s) was not recorded" in group["metrics"]["w1_run_to_run"]["value_missing"]


def test_one_that_is_long_enough(small_set: list[Path]) -> None:
    """Keep 5 s where a recording of the scene has it: a short file changes nothing of the others."""
    assert _time(LONG) == _time(LONG, small_set[0]) == _time(small_set[0], reference=LONG) == 5.0


def test_every_scene_has_its_own(small_set: list[Path]) -> None:
    """Compare each scene at a time of its own."""
    falling = recorded(
        "--sim", "mujoco", "--scene", "free-fall", "--n-env", 2, "--runs", 1, "--steps", 20, "--phases", "capture"
    )
    evaluation = evaluate([LONG, *falling])
    assert evaluation.sample_time == 5.0
    assert evaluation.shorter == {"free-fall": 0.2}
    assert sorted(evaluate([*small_set, *falling]).shorter.items()) == [("free-fall", 0.2), ("inclined-collision", 1.0)]
    for result in evaluation.results:
        assert not isinstance(result.metrics["w1_parallel"].value, Missing)
    brief = call("gsb-eval", LONG, *falling).stdout
    assert "free-fall: positions are compared at 0.2 s" in brief
    printed = call("gsb-eval", LONG, *falling, "--all").stdout
    assert "positions at t = 0.2 and 5 s" in printed
    assert "free-fall: positions are compared at 0.2 s" in printed


def test_comparing_two_sets(small_set: list[Path]) -> None:
    """Take one time for both sets, from the command line and from Python."""
    done = call("gsb-compare", "--base", *small_set[:1], "--head", *small_set[1:], "--json", "-", "--no-cache")
    assert any("compared at 1 s" in note for note in json.loads(done.stdout)["notes"])
    assert any("compared at 1 s" in note for note in compare(small_set[:1], small_set[1:]).notes)
    assert not any("compared at" in note for note in compare(small_set[:1], small_set[1:], sample_time=1.0).notes)


@pytest.mark.parametrize("sets", [[(100, 1), (60, 1)], [(100, 10), (90, 3)], [(40, 1)]])
def test_strides(tmp_path: Path, sets: list[tuple[int, int]]) -> None:
    """Take a step that every recording has, however seldom each was recorded."""
    files = [
        write_recording(tmp_path, grid(2), run=run, steps=steps, stride=stride, dt=0.01)
        for run, (steps, stride) in enumerate(sets)
    ]
    sampled = read_sampled(files, Reader(), HERE)
    ((scene, time),) = sampled.shorter.items()
    common = set.intersection(*(set(range(0, steps + 1, stride)) for steps, stride in sets))
    assert round(time / 0.01) == max(common)
    assert all(not isinstance(file.positions, Missing) for file in sampled.files.values())  # type: ignore[union-attr]


@given(st.lists(st.tuples(st.sampled_from([0.01, 0.004, 0.02]), st.integers(1, 40), st.integers(1, 7)), min_size=1))
def test_a_time_has_a_step_everywhere(described: list[tuple[float, int, int]]) -> None:
    """Find a time whose nearest step every run has recorded, or none."""
    from types import SimpleNamespace

    runs = [
        SimpleNamespace(
            configuration=SimpleNamespace(dt=dt), histories=SimpleNamespace(steps=np.arange(0, rows + 1) * stride)
        )
        for dt, rows, stride in described
    ]
    time = last_common_time(runs)  # type: ignore[arg-type]
    if time is not None:
        assert time > 0
        for run in runs:
            assert round(time / run.configuration.dt) in run.histories.steps
