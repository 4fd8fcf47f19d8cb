"""What moves is counted by the recorder, of states alone."""

from __future__ import annotations

import numpy as np

from gpusimbench.recorder.capture.evidence import moving, with_motion
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas.fields import body_fields, joint_field

BODIES = body_fields({"ball": ("ball",), "cubes": ("a", "b")}, "float32")
JOINTS = tuple(joint_field("joints", field, "float64", ("shoulder", "elbow")) for field in ("qpos", "qvel"))


def test_a_body_counts_once() -> None:
    """Count a body that moves and spins once, one that only spins too, and none that lies still."""
    state = tuple(np.zeros((3, len(field.items), field.width), dtype=np.float32) for field in BODIES)
    by_name = dict(zip((field.name for field in BODIES), state, strict=True))
    by_name["cubes/linear_velocity"][0, 0] = by_name["cubes/angular_velocity"][0, 0] = 1.0
    by_name["cubes/angular_velocity"][0, 1, 2] = 0.02
    by_name["ball/linear_velocity"][1, 0] = (0.008, 0.008, 0.0)  # faster than either of its components
    by_name["ball/position"][2] = 5.0
    found = moving(BODIES, state)
    assert found.tolist() == [2, 1, 0]


def test_joints_count_and_what_is_not_finite_is_no_rest() -> None:
    """Count joints by their own speed, and numbers that are none as motion, which another gate names."""
    qvel = np.array([[[0.5], [0.0]], [[np.nan], [0.0]], [[0.01], [-0.011]]])
    found = moving(JOINTS, (np.ones((3, 2, 1)), qvel))
    assert found.tolist() == [1, 1, 1]


def test_states_without_velocities_tell_nothing() -> None:
    """Leave an engine's evidence as it is where no velocity is there, and add a count where one is."""
    qpos, qvel = np.ones((2, 2, 1)), np.ones((2, 2, 1))
    evidence = Evidence({"contacts": np.ones((1, 2), dtype=np.int64)})
    assert with_motion(evidence, JOINTS[:1], (qpos,)) is evidence
    assert with_motion(None, JOINTS[:1], (qpos,)) is None
    both = with_motion(evidence, JOINTS, (qpos, qvel))
    assert {name: rows.tolist() for name, rows in both.counts.items()} == {"contacts": [[1, 1]], "moving": [[2, 2]]}
    alone = with_motion(None, JOINTS, (qpos, qvel))
    assert list(alone.counts) == ["moving"]
