"""Tasks of MuJoCo recorded with their physics: their models are drawn where MuJoCo has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording, wrap
from gpusimbench.evaluator.cli.view import main
from gpusimbench.evaluator.player.poses import items_of, recorded_steps
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.view.geometry import GEOMETRY
from gpusimbench.schemas.view.motion import Motion

gymnasium = pytest.importorskip("gymnasium")
mujoco = pytest.importorskip("mujoco")
STEPS = 12


def recorded(task: str, path: Path, change: Any = None) -> Any:
    """A recording of two environments with their physics; the model of the first."""
    envs = gymnasium.make_vec(task, num_envs=2, vectorization_mode="sync")
    model = envs.envs[0].unwrapped.model
    if change is not None:
        change(envs.envs[1].unwrapped.model)
    with wrap(envs, path, steps=STEPS, physics=True) as wrapped:
        wrapped.reset(seed=4)
        wrapped.action_space.seed(4)
        for _ in range(STEPS):
            wrapped.step(wrapped.action_space.sample())
    return model


@pytest.mark.parametrize("task", ["HalfCheetah-v5", "Ant-v5"])
def test_bodies_are_where_mujoco_has_them(task: str, tmp_path: Path) -> None:
    """Draw every body where MuJoCo's kinematics of the recorded qpos has it: slides, hinges and a free joint."""
    model = recorded(task, tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")
    assert recorded_steps(recording).tolist() == list(range(STEPS + 1))
    data, number = mujoco.MjData(model), {model.body(b).name or f"body{b}": b for b in range(model.nbody)}
    for env in range(2):
        found = items_of(recording, env, [range(STEPS + 1)])
        names = [name for _, name in found.bodies]
        assert len(names) >= model.nbody - 2 and len(set(names)) == len(names)
        for row, qpos in enumerate(recording.state("env", "physics_qpos")[:, env, 0]):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            for item, name in enumerate(names):
                np.testing.assert_allclose(found.position[row, item], data.xpos[number[name]], atol=1e-9)
                turned = abs(np.dot(found.orientation[row, item], data.xquat[number[name]]))
                assert turned == pytest.approx(np.linalg.norm(found.orientation[row, item]), abs=1e-9)
    page = tmp_path / "page.html"
    assert main([str(recording.path), "--no-open", "--out", str(page)]) == ExitCode.OK
    assert "canvas" in page.read_text(encoding="utf-8")


def _longer(model: Any) -> None:
    model.geom_size[1] *= 1.5


def _turned(model: Any) -> None:
    model.geom_quat[1] = (0.6, 0.8, 0.0, 0.0)


def _begun(model: Any) -> None:
    model.qpos0[0] += 1.0


@pytest.mark.parametrize("change", [_longer, _turned, _begun])
def test_other_models(change: Any, tmp_path: Path) -> None:
    """Attach no model where environments have others: bodies of one would be drawn as those of another."""
    recorded("HalfCheetah-v5", tmp_path / "other.mcap", change)
    assert open_recording(tmp_path / "other.mcap").attachment(GEOMETRY) is None
    assert main([str(tmp_path / "other.mcap"), "--no-open", "--out", str(tmp_path / "page.html")]) == ExitCode.OK


def test_what_is_no_place(tmp_path: Path) -> None:
    """Take qpos of another length for no coordinates of a model."""
    recorded("HalfCheetah-v5", tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")
    assert Motion(recording.fields, recording.look).parts
    for look in (replace(recording.look, order=recording.look.order[:-1]), replace(recording.look, order=())):
        assert Motion(recording.fields, look).fields == ()
