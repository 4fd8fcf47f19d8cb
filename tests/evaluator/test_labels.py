"""Names of groups: short, unique, and about what matters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.groups import group, labels, options_given
from tests.synthetic import grid, write_recording


def named(folder: Path, *kinds: dict[str, Any]) -> list[str]:
    """Labels of one recording of each kind."""
    recordings = [open_recording(write_recording(folder, grid(1), **kind)) for kind in kinds]
    return sorted(labels([g.key for g in group(recordings)], options_given(recordings)))


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        (
            [{"options": {"impl": impl, "cone": "elliptic"}} for impl in ("jax", "warp")],
            ["synthetic [impl=jax]", "synthetic [impl=warp]"],
        ),
        (
            [{"options": {"solver": "xpbd", "relaxation": 0.9}}, {"options": {"solver": "mujoco"}}],
            ["synthetic [relaxation=0.9, solver=xpbd]", "synthetic [solver=mujoco, relaxation=unset]"],
        ),
        (
            [
                {"determinism": level, "switches": switches, "environment": variables}
                for level, switches, variables in (
                    ("default", {"deterministic": False}, {}),
                    ("run", {"deterministic": True, "atomics": "off"}, {"XLA_FLAGS": "--xla_gpu_deterministic_ops"}),
                )
            ],
            ["synthetic [determinism=default]", "synthetic [determinism=run]"],
        ),
        (
            [
                {"determinism": level, "switches": {"precision": precision}}
                for level in ("default", "full")
                for precision in ("f32", "f64")
            ],
            [
                f"synthetic [determinism={level}, precision={p}]"
                for level in ("default", "full")
                for p in ("f32", "f64")
            ],
        ),
        ([{}, {"built": False, "status": "FAILED", "options": {"cone": "cubic"}}], None),
    ],
)
def test_labels(tmp_path: Path, kinds: list[dict[str, Any]], expected: list[str] | None) -> None:
    """Show what tells groups of one simulator apart; a level of determinism stands for the switches that it sets."""
    found = named(tmp_path, *kinds)
    assert len(set(found)) == len(kinds)
    assert all(len(label) < 80 for label in found)
    if expected is None:
        assert any("never built" in label and "scene" not in label for label in found)
    else:
        assert found == expected


def test_a_failed_run_joins_what_was_asked_for(tmp_path: Path) -> None:
    """Put a run that was never built to the group of the same request, also where another machine ran it too."""
    files = [
        write_recording(tmp_path, grid(2)),
        write_recording(tmp_path, grid(2), run=1, built=False, status="FAILED", reason="no memory"),
        write_recording(tmp_path, grid(2), gpu_bytes=(1, 2)),
        write_recording(tmp_path, grid(2), run=1, built=False, status="FAILED", reason="lost", gpu_bytes=(1, 2)),
    ]
    groups = group([open_recording(f) for f in files])
    assert [len(g.recordings) for g in groups] == [2, 2]
    assert all(g.outcomes["failed"] == 1 for g in groups)


def test_another_precision_is_named(tmp_path: Path) -> None:
    """Tell float32 from float64 by name, before settings that nobody chose; a run that was never built has neither."""
    finals: list[Any] = [grid(2, "float32"), grid(2, "float64")]
    files = [write_recording(tmp_path, final, switches={"x": str(final.dtype)}) for final in finals]
    recordings = [open_recording(file) for file in files]
    assert sorted(labels([g.key for g in group(recordings)])) == ["synthetic [float32]", "synthetic [float64]"]
    failed = open_recording(
        write_recording(tmp_path, None, built=False, status="FAILED", reason="no memory", options={"cone": "x"})
    )
    found = labels([g.key for g in group([*recordings, failed])], {"cone"})
    assert sum("float32" in label for label in found) == sum("float64" in label for label in found) == 1
    assert not any("#" in label for label in found)
