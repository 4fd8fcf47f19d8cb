"""The scenes say what the published tables say, and MuJoCo loads them as they are."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from gpusimbench.recorder.command.arguments import parser
from gpusimbench.recorder.command.configure import check_configuration
from gpusimbench.recorder.scenes.base import Box, Plane, Sphere
from gpusimbench.recorder.scenes.emit.mjcf import deviations, emit_mjcf
from gpusimbench.recorder.scenes.free_fall import DROP_HEIGHT
from gpusimbench.recorder.scenes.inclined_collision import SLOPE_ANGLE
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.schemas.action_generator import GRID
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from tests.conftest import SMALL, Command, distribution

scenes = pytest.mark.parametrize("name", SCENES)


def _model(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(emit_mjcf(make_scene(name), dt=0.01, option={}, geom={}))


@scenes
def test_names_are_unique_and_groups_known(name: str) -> None:
    """Give every body a name of its own, and every moving one a group that the format knows."""
    scene = make_scene(name)
    assert len({b.name for b in scene.bodies}) == len(scene.bodies)
    assert set(scene.groups()) <= {"cubes", "boxes", "balls", "ball", "robot"}
    assert all(b.group for b in scene.moving())
    assert scene.name == name


@scenes
def test_orientations_are_unit_quaternions(name: str) -> None:
    """Rotate without scaling."""
    for body in make_scene(name).bodies:
        assert math.isclose(math.hypot(*body.orientation), 1.0, abs_tol=1e-15)


@scenes
def test_description_is_json_with_an_identity(name: str) -> None:
    """Write the description as JSON whose hash depends on nothing but the scene."""
    scene = make_scene(name)
    record = json.loads(scene.to_json())
    assert [b["name"] for b in record["bodies"]] == [b.name for b in scene.bodies]
    assert {b["shape"]["kind"] for b in record["bodies"]} <= {"box", "sphere", "plane"}
    assert scene.sha256() == make_scene(name).sha256()


@scenes
def test_mujoco_has_the_same_bodies(name: str) -> None:
    """Emit positions, orientations, masses, sizes and friction as described."""
    scene = make_scene(name)
    model = _model(name)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for body in scene.bodies:
        geom = model.geom(body.name)
        assert np.allclose(data.geom_xpos[geom.id], body.position, atol=1e-15)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, np.array(body.orientation))
        assert np.allclose(data.geom_xmat[geom.id], rotation, atol=1e-15)
        assert geom.friction[0] == body.material.kinetic_friction
        match body.shape:
            case Box(size):
                assert np.array_equal(geom.size * 2, size)
            case Sphere(radius):
                assert geom.size[0] == radius
            case Plane():
                assert geom.type[0] == mujoco.mjtGeom.mjGEOM_PLANE
        if body.mass is not None:
            assert model.body(body.name).mass[0] == body.mass
    joints = len(scene.robot.joints()) if scene.robot else 0
    assert model.nv == 6 * len(scene.moving()) + joints
    assert tuple(model.opt.gravity) == scene.gravity


@scenes
def test_every_material_loss_is_declared(name: str) -> None:
    """Declare what MuJoCo cannot honour of every material."""
    scene = make_scene(name)
    declared = {d.parameter for d in deviations(scene)}
    materials = {b.material.name for b in scene.bodies} | ({scene.robot.material.name} if scene.robot else set())
    for material in materials:
        assert {f"{material}.static_friction", f"{material}.restitution"} <= declared


def test_inclined_collision_is_consistent() -> None:
    """Start the ball touching the slope, 0.25 m before its foot, and the stack standing on the board."""
    bodies = {b.name: b for b in make_scene("inclined-collision").bodies}
    slope, ball, board = bodies["slope"], bodies["ball"], bodies["board"]
    normal = np.array([math.sin(SLOPE_ANGLE), 0.0, math.cos(SLOPE_ANGLE)])
    down = np.array([math.cos(SLOPE_ANGLE), 0.0, -math.sin(SLOPE_ANGLE)])
    offset = np.subtract(ball.position, slope.position)
    assert isinstance(slope.shape, Box)
    assert isinstance(ball.shape, Sphere)
    assert isinstance(board.shape, Box)
    assert math.isclose(offset @ normal, ball.shape.radius + slope.shape.size[2] / 2, abs_tol=2e-5)
    assert math.isclose(slope.shape.size[0] / 2 - offset @ down, 0.25, abs_tol=0.02)
    cubes = np.array([bodies[n].position for n in make_scene("inclined-collision").groups()["cubes"]])
    assert len(cubes) == 27
    top = board.position[2] + board.shape.size[2] / 2
    assert math.isclose(cubes[:, 2].min() - 0.01, top, abs_tol=1e-12)
    assert np.allclose(cubes.mean(axis=0), (0.08, 0.0, 0.05))
    assert np.array_equal(cubes[0], (0.06, -0.02, 0.03)), "nesting order is x, y, z"
    assert np.array_equal(cubes[1], (0.06, -0.02, 0.05))


def test_free_fall_starts_at_the_stated_height() -> None:
    """Put the lowest faces at the drop height."""
    scene = make_scene("free-fall")
    assert math.isclose(min(b.position[2] for b in scene.moving()) - 0.01, DROP_HEIGHT, abs_tol=1e-12)


def test_an_unknown_scene_names_the_known_ones() -> None:
    """List the scenes that there are."""
    with pytest.raises(UsageError, match="inclined-collision"):
        make_scene("outer-space")


def test_a_run_is_what_the_command_makes_it_where_nothing_is_asked_for() -> None:
    """Give a configuration the defaults of gsb-record, and the window that is timed in most scenes."""
    plain = RunConfiguration("mujoco", "inclined-collision", n_env=1, dt=0.01, steps=1)
    assert (plain.warmup, plain.timed_steps) == make_scene(plain.scene).timed_window()
    taken = parser().unless_given["simulated"]
    asked = {name: value for name, value in taken.items() if value is not None and hasattr(plain, name)}
    assert {"seed", "stride", "determinism", "timeout", "capture"} <= set(asked)
    assert {name: getattr(plain, name) for name in asked} == {
        **asked, "phases": tuple(asked["phases"].split(",")), "fitted": {},
    }  # fmt: skip


def test_joints_whose_range_is_too_wide_to_be_drawn() -> None:
    """Refuse targets that the generator's words of 32 bits would draw from a part of the range alone."""
    scene = make_scene("franka")
    assert scene.actions is not None
    run = RunConfiguration("mujoco", "franka", n_env=1, dt=0.01, steps=1)
    for lower, upper in ((-6.3, 6.3), (-4.0, 4.0)):
        wide = replace(scene.actions, lower=(lower,) * 7, upper=(upper,) * 7)
        with pytest.raises(UsageError, match=rf"range {lower:g} to {upper:g} in steps .*; at most 65536 steps can be"):
            check_configuration(run, replace(scene, actions=wide))
    widest = replace(scene.actions, lower=(-4.0,) * 7, upper=(4.0 - GRID,) * 7)
    check_configuration(run, replace(scene, actions=widest))
    drawn = widest.draw(0, n_env=400, first_step=0, n_step=400)
    assert drawn.min() < -3.99 and drawn.max() > 3.99


def _distribution(folder: Path, code: str, names: dict[str, str]) -> None:
    # an installed one that adds scenes
    (folder / "their_scenes.py").write_text(code)
    lines = "".join(f"{name} = their_scenes:{target}\n" for name, target in names.items())
    distribution(folder, "their-scenes", f"[gsb.scenes]\n{lines}")


_THEIRS = """
from dataclasses import replace
from gpusimbench.recorder.scenes.free_fall import free_fall

def low_drop():
    return replace(free_fall(), name="low-drop", summary="a drop of another height")

def misnamed():
    return free_fall()

def broken():
    raise RuntimeError("no such thing")

def nothing():
    return None
"""


def test_a_distribution_adds_scenes(tmp_path: Path, gsb_record: Command) -> None:
    """Record a third party's scene by its name, list it, and say what is wrong with one that cannot be made."""
    names = {"low-drop": "low_drop", "misnamed": "misnamed", "broken": "broken", "nothing": "nothing", "no": "absent"}
    _distribution(tmp_path, _THEIRS, names)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    listed = json.loads(gsb_record("--list", "--json", env=environment).stdout)["scenes"]
    needs = ["free bodies", "boxes", "planes"]
    assert {"name": "low-drop", "summary": "a drop of another height", "problem": "", "needs": needs} in listed
    problems = {scene["name"]: scene["problem"] for scene in listed if scene["problem"]}
    assert set(problems) == {"misnamed", "broken", "nothing", "no"}
    assert "a Scene named 'free-fall'" in problems["misnamed"]
    assert "RuntimeError: no such thing" in problems["broken"]
    done = gsb_record(
        "--sim", "mujoco", "--scene", "low-drop", "--n-env", 1, "--runs", 1, *SMALL, "--out", tmp_path / "out",
        env=environment, code=0,
    )  # fmt: skip
    done = gsb_record("--sim", "mujoco", "--scene", "broken", env=environment, code=2)
    assert "scene 'broken' of their-scenes cannot be made" in done.stderr
