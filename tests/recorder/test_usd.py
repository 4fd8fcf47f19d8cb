"""Scenes as USD text: what is in it, number for number, without an engine to read it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Material, Plane, Scene, Shape, Sphere, solid_inertia
from gpusimbench.recorder.scenes.emit.usd import emit_usd
from gpusimbench.recorder.scenes.emit.usd_prim import identifiers
from gpusimbench.recorder.scenes.franka import PANDA
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.recorder.simulators.physx.model import Model
from tests.recorder.mixed_model import scene_of as model_scene_of
from tests.rotations import rotation

NUMBER = st.floats(-1e6, 1e6, allow_subnormal=False)
SIZE = st.floats(1e-3, 1e3)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)


def scene_of(*bodies: Body) -> Scene:
    """A scene with these bodies."""
    return Scene(name="made up", summary="of a test", bodies=bodies)


def prim(text: str, path: str) -> list[str]:
    """The lines of a prim's own body, those of its children left out."""
    lines = [line.strip() for line in text.splitlines()]
    begin = 0
    for name in path.strip("/").split("/"):
        begin = next(i for i in range(begin, len(lines)) if re.match(rf'def \w+ "{name}"', lines[i]))
    depth, found = 0, []
    for line in lines[begin:]:
        depth += (line == "{") - (line == "}")
        if depth == 1 and line != "}":
            found.append(line)
        if depth == 0 and found:
            break
    return found


def numbers(text: str, path: str, name: str) -> tuple[float, ...]:
    """The value of one property of a prim."""
    line = next(line for line in prim(text, path) if re.match(rf"\w+( \w+)?(\[\])? {re.escape(name)} = ", line))
    return tuple(float(word) for word in re.findall(r"-?(?:inf|[0-9.]+(?:e[-+]?\d+)?)", line.partition(" = ")[2]))


@given(st.lists(st.text(min_size=1), unique=True, max_size=20))
def test_identifiers(names: list[str]) -> None:
    """Any names become names that USD allows, each another one."""
    words = identifiers(names)
    assert list(words) == names
    assert len(set(words.values())) == len(names)
    assert all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", word) for word in words.values())


@given(VECTOR, VECTOR, st.floats(1e-6, 1e6), st.tuples(NUMBER, NUMBER))
def test_numbers_survive(position: tuple, velocity: tuple, mass: float, friction: tuple) -> None:
    """Whatever a description has comes back from the text with every bit; angular speeds are in degrees."""
    wood = Material("wood", *friction, 0.5)
    body = Body(
        "cube", Box((1.0, 1.0, 1.0)), wood, position, mass, "cubes",
        linear_velocity=velocity, angular_velocity=velocity,
    )  # fmt: skip
    text = emit_usd(scene_of(body), apis={})
    path = "/World/envs/env0/cube"
    assert numbers(text, path, "xformOp:translate") == position
    assert numbers(text, path, "physics:velocity") == velocity
    assert numbers(text, path, "physics:angularVelocity") == tuple(math.degrees(v) for v in velocity)
    assert numbers(text, path, "physics:mass") == (mass,)
    assert numbers(text, "/World/materials/wood", "physics:staticFriction") == friction[:1]
    assert numbers(text, "/World/materials/wood", "physics:dynamicFriction") == friction[1:]


def test_a_pin_closes_a_loop_outside_the_articulation() -> None:
    """Join the ends of coupler and rocker by a joint that is no part of the tree, and give the joints their speeds."""
    text = emit_usd(make_scene("four-bar"), apis={})
    path = "/World/envs/env0/four_bar"
    lines = prim(text, f"{path}/pin")
    assert "bool physics:excludeFromArticulation = true" in lines
    for side, link in enumerate(("coupler", "rocker")):
        assert f"rel physics:body{side} = <{path}/{link}>" in lines
    assert numbers(text, f"{path}/pin", "physics:localPos0") == (0.5, 0.0, -0.05)
    assert numbers(text, f"{path}/pin", "physics:localPos1") == (0.4, 0.0, 0.0)
    (speed,) = numbers(text, f"{path}/crank_turn", "state:angular:physics:velocity")
    assert math.radians(speed) == pytest.approx(5.0)


@pytest.mark.parametrize("name", SCENES)
def test_well_formed(name: str) -> None:
    """Braces and parentheses match, and a brace has its line to itself, as some readers want it."""
    text = emit_usd(make_scene(name), apis={"PhysxSceneAPI": {"bool physxScene:enableCCD": False}})
    assert text.startswith("#usda 1.0\n")
    for opening, closing in ("{}", "()", "[]"):
        assert text.count(opening) == text.count(closing)
    for line in text.splitlines():
        assert line.strip() in "{}" or not set(line) & set("{}")


def test_shapes() -> None:
    """Colliders are children without a scale, but for boxes with unequal edges; a plane faces upward."""
    wood = Material("wood", 0.5, 0.4, 0.3)
    shapes: dict[str, Shape] = {
        "cube": Box((0.2, 0.2, 0.2)), "brick": Box((0.2, 0.4, 0.6)), "ball": Sphere(0.1), "rod": Capsule(0.1, 0.5),
        "ground": Plane(),
    }  # fmt: skip
    text = emit_usd(scene_of(*(Body(name, shape, wood, (0.0, 0.0, 0.0)) for name, shape in shapes.items())), apis={})
    env = "/World/envs/env0"
    assert numbers(text, f"{env}/cube/shape", "size") == (0.2,)
    assert not any("scale" in line for line in prim(text, f"{env}/cube/shape"))
    assert numbers(text, f"{env}/brick/shape", "size") == (1.0,)
    assert numbers(text, f"{env}/brick/shape", "xformOp:scale") == (0.2, 0.4, 0.6)
    assert numbers(text, f"{env}/ball/shape", "radius") == (0.1,)
    assert numbers(text, f"{env}/rod/shape", "height") == (0.5,)
    assert 'uniform token axis = "Z"' in prim(text, f"{env}/ground/shape")
    assert not any("RigidBody" in line for line in text.splitlines())


def test_shared_bodies() -> None:
    """Fixed bodies can stand outside of the environment; none that moves can."""
    scene = make_scene("inclined-collision")
    text = emit_usd(scene, apis={}, shared=("board",))
    assert numbers(text, "/World/shared/board", "xformOp:translate") == (0.3, 0.0, 0.01)
    assert '"board"' not in text.partition('"envs"')[2]
    for names in (("ball",), ("board", "nothing")):
        with pytest.raises(ValueError, match="only fixed bodies"):
            emit_usd(scene, apis={}, shared=names)


def test_settings_of_an_engine() -> None:
    """Settings go, with their schema, where that schema belongs, and nowhere else."""
    apis = {
        "PhysxRigidBodyAPI": {"float physxRigidBody:sleepThreshold": 0.0},
        "PhysxSceneAPI": {"uniform token physxScene:solverType": "PGS", "uint physxScene:gpuHeapCapacity": 7},
    }
    text = emit_usd(make_scene("inclined-collision"), apis=apis)
    assert text.count("sleepThreshold = 0.0") == text.count('"PhysxRigidBodyAPI"') == 28
    scene = prim(text, "/World/physicsScene")
    assert 'uniform token physxScene:solverType = "PGS"' in scene
    assert "uint physxScene:gpuHeapCapacity = 7" in scene


@given(VECTOR)
def test_gravity(gravity: tuple[float, float, float]) -> None:
    """Direction times magnitude is the scene's gravity; without any, the magnitude is zero."""
    text = emit_usd(replace(scene_of(), gravity=gravity), apis={})
    direction = numbers(text, "/World/physicsScene", "physics:gravityDirection")
    (magnitude,) = numbers(text, "/World/physicsScene", "physics:gravityMagnitude")
    assert np.allclose(np.array(direction) * magnitude, gravity, rtol=1e-12, atol=1e-300)
    assert math.isclose(math.hypot(*direction), 1.0)


@given(SIZE, SIZE, SIZE, SIZE)
def test_moments_of_inertia(mass: float, x: float, y: float, z: float) -> None:
    """Solids obey the triangle inequality; a capsule lies between the sphere and the rod that it can become."""
    for shape in (Box((x, y, z)), Sphere(x), Capsule(x, y)):
        a, b, c = solid_inertia(shape, mass)
        assert min(a, b, c) > 0
        assert 2 * max(a, b, c) <= (a + b + c) * (1 + 1e-9)
    assert np.allclose(solid_inertia(Capsule(x, 1e-12 * x), mass), solid_inertia(Sphere(x), mass))
    thin = solid_inertia(Capsule(1e-6 * y, y), mass)
    assert np.allclose(thin[:2], mass * y * y / 12, rtol=1e-4)
    with pytest.raises(ValueError, match="plane"):
        solid_inertia(Plane(), mass)


def test_inertia_of_links() -> None:
    """Principal moments and axes make up the tensor that the robot's description has."""
    text = emit_usd(make_scene("franka"), apis={})
    for link in PANDA.links:
        path = f"/World/envs/env0/panda/{link.name}"
        axes = rotation(numbers(text, path, "physics:principalAxes"))
        found = axes @ np.diag(numbers(text, path, "physics:diagonalInertia")) @ axes.T
        xx, yy, zz, xy, xz, yz = link.inertial.inertia
        assert np.allclose(found, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-12)
        assert numbers(text, path, "physics:centerOfMass") == link.inertial.centre


def test_links_stand_where_the_joints_put_them() -> None:
    """World poses of the links at the first joint angles are those that MuJoCo computes."""
    mujoco = pytest.importorskip("mujoco")
    from gpusimbench.recorder.simulators.mujoco.model import compile_scene
    from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

    scene = make_scene("franka")
    data = compile_scene(scene, dt=scene.dt, options=MjcfOptions()).data()
    text = emit_usd(scene, apis={})
    for link in PANDA.links:
        path = f"/World/envs/env0/panda/{link.name}"
        body = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_BODY, link.name)
        assert np.allclose(numbers(text, path, "xformOp:translate"), data.xpos[body], atol=1e-12)
        turned = [line for line in prim(text, path) if "xformOp:orient =" in line]
        quaternion = numbers(text, path, "xformOp:orient") if turned else (1.0, 0.0, 0.0, 0.0)
        assert np.allclose(rotation(quaternion), data.xmat[body].reshape(3, 3), atol=1e-12)


def test_joints_and_drives() -> None:
    """Hinges have the description's limits, drives and friction, in degrees; pairs that may overlap are filtered."""
    text = emit_usd(make_scene("franka"), apis={})
    for joint in PANDA.joints():
        path = f"/World/envs/env0/panda/{joint.name}"
        assert numbers(text, path, "physics:lowerLimit") == (math.degrees(joint.lower),)
        assert numbers(text, path, "physics:upperLimit") == (math.degrees(joint.upper),)
        (stiffness,) = numbers(text, path, "drive:angular:physics:stiffness")
        assert math.isclose(stiffness * math.degrees(1), joint.stiffness)
        assert numbers(text, path, "drive:angular:physics:maxForce") == (joint.max_torque,)
        assert numbers(text, path, "physxJointAxis:angular:armature") == (joint.armature,)
    assert "rel physics:filteredPairs = [</World/envs/env0/panda/link2>]" in text
    assert text.count("filteredPairs") == len(PANDA.apart)
    weld = prim(text, "/World/envs/env0/panda/link0_weld")
    assert not any("body0" in line for line in weld)  # to the world


def test_a_model_for_isaac_lab(tmp_path: Path) -> None:
    """Fix a tree to its environment, and not to a place in the world, where environments are copies in USD; and make no
    articulation of a free body without joints."""
    text = """<mujoco><worldbody>
      <body name="arm" pos="0 0 1"><joint name="turn" axis="0 0 1"/><geom size=".1"/></body>
      <body name="ball" pos="1 0 1"><freejoint/><geom size=".1"/></body>
    </worldbody></mujoco>"""
    model = Model(model_scene_of(text, tmp_path), dt=0.005)
    plain, copied = (model.usd({}, spacing=4.0, isaac_lab=isaac_lab) for isaac_lab in (False, True))
    (arm, ball) = model.plan.trees
    assert (arm.is_a_body(), ball.is_a_body()) == (False, True)
    assert plain.count("PhysicsArticulationRootAPI") == 2
    assert copied.count("PhysicsArticulationRootAPI") == 1
    assert f"rel physics:body0 = </World/envs/env0/{arm.prim}>" in copied
    lost = [line for line in plain.splitlines() if line not in copied.splitlines()]
    assert all("apiSchemas" in line for line in lost)  # all else is the same
