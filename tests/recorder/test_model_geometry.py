"""What viewers draw of model files: every shape where MuJoCo has it, in every state, and meshes of few triangles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench.recorder.scenes.model import model_scene
from gpusimbench.recorder.simulators.mujoco.geometry import fewer, geometry_of, grid
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.schemas import checks
from gpusimbench.schemas.model_files import pack
from gpusimbench.schemas.view.geometry import GEOMETRY, Look, look_of
from gpusimbench.schemas.view.kinematics import product, rotate
from gpusimbench.schemas.view.motion import Motion, absolute
from tests.conftest import call
from tests.evaluator.viewing import placed, read
from tests.recorder.test_model import WALKER, _gymnasium_models

_ROWS = 20
_SHORT = ("--n-env", "2", "--runs", "1", "--steps", "20", "--phases", "capture")

_ZOO = """<mujoco>
 <asset><hfield name="hill" nrow="4" ncol="3" size="1 2 0.5 0.1" elevation="0 1 0 0 2 0 0 3 0 1 1 1"/></asset>
 <worldbody>
  <geom type="plane" size="0 3 1" euler="0 10 0"/>
  <geom type="hfield" hfield="hill" pos="5 0 0"/>
  <body name="post" pos="1 2 3" euler="10 20 30">
   <geom type="cylinder" size="0.1 0.5" pos="0 0 1"/>
   <body pos="0.1 0 0.2" euler="0 40 0">
    <geom type="ellipsoid" size="0.1 0.2 0.3" euler="0 0 50"/>
    <body pos="0 0.3 0.1" euler="5 6 7">
     <joint type="slide" axis="1 2 3" ref="0.25"/>
     <joint type="hinge" axis="3 -1 2" pos="0.1 0.2 0.3" ref="30"/>
     <joint type="ball" pos="-0.2 0.1 0"/>
     <geom type="box" size="0.1 0.2 0.3" pos="0.4 0 0"/>
     <geom type="sphere" size="0.2" group="3"/>
     <geom type="sphere" size="0.2" rgba="1 0 0 0"/>
     <body name="tip" pos="0 0 0.5" euler="0 0 9"><geom type="capsule" size="0.05 0.2"/></body>
    </body>
   </body>
  </body>
  <body name="drone"><freejoint/><geom type="box" size="0.1 0.1 0.02"/>
   <body pos="0.1 0 0"><geom type="sphere" size="0.03"/></body>
  </body>
 </worldbody>
</mujoco>"""


def _compiled(path: Path) -> MjcfModel:
    scene = model_scene("it", pack(path))
    return compile_scene(scene, dt=scene.dt, options=MjcfOptions())


def _attached(compiled: MjcfModel) -> Look:
    return look_of({}, checks.load(GEOMETRY, compiled.attachments[GEOMETRY][1]))


def _random_states(model: Any, seed: int) -> Any:
    # joints of every angle, several turns round
    rng = np.random.default_rng(seed)
    qpos = rng.normal(0, 3, (_ROWS, model.nq))
    for joint in range(model.njnt):
        begin = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}.get(int(model.jnt_type[joint]))
        if begin is not None:
            turned = qpos[:, model.jnt_qposadr[joint] + begin :][:, :4]
            turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return qpos


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model with every kind of joint and shape, off centre, turned, with references."""
    path = tmp_path_factory.mktemp("zoo") / "zoo.xml"
    path.write_text(_ZOO)
    return path


@pytest.mark.parametrize("name", ["zoo", WALKER, *_gymnasium_models()], ids=lambda path: Path(path).stem)
def test_everything_is_where_mujoco_has_it(name: Path | str, zoo: Path) -> None:
    """Place bodies and shapes to 1e-9 m where MuJoCo's own kinematics has them, in random states."""
    compiled = _compiled(zoo if name == "zoo" else Path(name))
    model, look = compiled.model, _attached(compiled)
    qpos = _random_states(model, 7)
    fields = compiled.fields("float64")
    arrays = compiled.split(qpos, np.zeros((_ROWS, model.nv)))
    motion = Motion(fields, look)
    recorded = {field.name: array for field, array in zip(fields, arrays, strict=True)}
    poses = absolute(motion.frames([recorded[field.name] for field in motion.fields]))
    by_key = {(part.group, part.name): pose for part, pose in zip(motion.parts, poses, strict=True)}
    shown = [g for g in range(model.ngeom) if model.geom_group[g] < 3 and model.geom_rgba[g, 3] > 0]
    assert sum(len(solid.shapes) for solid in look.solids) == len(shown)
    data = mujoco.MjData(model)
    for row in range(_ROWS):
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        for body, solid in enumerate(look.solids):
            if solid.group:
                at, turned = (array[row] for array in by_key[solid.group, solid.name])
                np.testing.assert_allclose(at, data.xpos[body], rtol=0, atol=1e-9)
                sign = np.sign(turned @ data.xquat[body])
                np.testing.assert_allclose(turned * sign, data.xquat[body], rtol=0, atol=1e-9)
            for shape, geom in zip(solid.shapes, (g for g in shown if model.geom_bodyid[g] == body), strict=True):
                own, how = np.array(shape.position), np.array(shape.orientation)
                if solid.group:
                    own, how = at + rotate(turned, own), product(turned, how)
                np.testing.assert_allclose(own, data.geom_xpos[geom], rtol=0, atol=1e-9)
                axes = np.stack([rotate(how, axis) for axis in np.eye(3)], axis=1)
                np.testing.assert_allclose(axes, data.geom_xmat[geom].reshape(3, 3), rtol=0, atol=1e-9)


def test_what_stands_still_is_part_of_the_world(zoo: Path) -> None:
    """Hang nothing on bodies without a joint below the world, and say what is left out."""
    look = _attached(_compiled(zoo))
    assert [solid.name for solid in look.solids if not solid.group] == ["world", "post", "body2"]
    assert [(link.name, link.parent) for link in look.links] == [
        ("body3", None), ("tip", ("robot", "body3")), ("body6", ("bodies", "drone")),
    ]  # fmt: skip
    assert [s.kind for s in look.solids[0].shapes] == ["box", "mesh"]
    assert look.solids[0].shapes[0].size == (20.0, 6.0, 1e-4)
    assert look.notes == (
        "2 shapes are not drawn, as in MuJoCo's own viewer: transparent ones, and geom groups 3 to 5",
    )


def test_what_a_model_has_beside_shapes_is_named() -> None:
    """Name in a line what MuJoCo's viewer shows and the picture has not; leave out what that viewer hides, too."""
    tendons = (
        '<spatial><site site="a"/><site site="b"/></spatial>'
        '<spatial group="4"><site site="a"/><site site="b"/></spatial>'
        '<fixed><joint joint="j" coef="1"/></fixed>'
    )
    flex = '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2" mass="1"/>'
    body = '<body><joint name="j"/><geom size=".1"/><site name="b"/></body>'

    def notes(sites: str, rest: str = "", tendon: str = "") -> list[str]:
        world = f"<worldbody>{sites}{body}{rest}</worldbody><tendon>{tendon}</tendon>"
        return json.loads(geometry_of(mujoco.MjModel.from_xml_string(f"<mujoco>{world}</mujoco>")))["simplified"]

    seen, hidden = '<site name="a" pos="0 0 1"/>', '<site name="a" rgba="1 0 0 0"/>'
    assert notes(seen, flex, tendons) == ["flexible bodies (1), spatial tendons (1) and sites (2) are not drawn"]
    assert notes(hidden, tendon=tendons) == ["spatial tendons (1) and sites (1) are not drawn"]
    assert notes(hidden) == ["sites (1) are not drawn"]


def test_large_meshes_are_simplified(tmp_path: Path) -> None:
    """Draw a ball of 20 000 triangles, twice, with as few as the file has room for, and say so."""
    points, triangles = _ball(101)
    lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    geoms = '<body><freejoint/><geom type="mesh" mesh="ball"/><geom type="mesh" mesh="ball" pos="3 0 0"/></body>'
    (tmp_path / "it.xml").write_text(
        f'<mujoco><asset><mesh name="ball" file="ball.obj"/></asset><worldbody>{geoms}</worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "it.xml"))
    data = geometry_of(model)
    assert data == geometry_of(model)
    assert len(data) < 30_000
    look = look_of({}, json.loads(data))
    one, other = look.solids[1].shapes
    assert one.mesh is not None
    assert one.mesh is other.mesh
    assert 400 < len(one.mesh.triangles) <= 800
    reach = np.linalg.norm(one.mesh.points, axis=1)
    assert (reach.min(), reach.max()) == pytest.approx((0.99, 1.0), abs=0.01)
    a, b, c = one.mesh.points[one.mesh.triangles.T]
    volume = (a * np.cross(b, c)).sum() / 6  # what is closed and turned outward encloses nearly what the ball does
    assert 0.85 < volume / (4 / 3 * np.pi) < 1
    said = f"1 meshes or height fields are drawn with {len(one.mesh.triangles)} of their {len(triangles)} triangles"
    assert look.notes[0].startswith(said)


def test_a_recording(tmp_path: Path) -> None:
    """Show the robot in the view that a recording carries, and in the page; vouch for it without the engine."""
    done = call("gsb-record", "--sim", "mujoco", "--model", WALKER, *_SHORT, "--out", tmp_path, code=0)
    (path,) = tmp_path.glob("*.mcap")
    messages, _ = read(path)
    ((_, update),) = messages["/state/view/scene/000000"]
    drawn = {e.id: [len(e.cubes), len(e.spheres), len(e.cylinders), len(e.triangles)] for e in update.entities}
    assert drawn["env0/trunk"] == [1, 0, 0, 0]
    assert drawn["env0/left_shank"] == [0, 2, 1, 1]
    assert set(drawn) == {f"env0/{name}" for name in (
        "world", "trunk", "crate", "left_thigh", "left_shank", "right_thigh", "right_shank", "body6"
    )}  # fmt: skip
    last = placed(messages["/state/view/transforms/000000"][-1][1])
    shin = np.linalg.norm(last["env0/left_shank"][0] - last["env0/left_thigh"][0])
    assert shin == pytest.approx(0.2)
    done = call("gsb-check", path, code=0)
    done = call("gsb-view", path, "--no-open", "--out", tmp_path / "view.html", code=0)
    assert "dots" not in done.stderr


def test_too_large_a_model() -> None:
    """Draw nothing of a model with more bodies than viewers take, and say so."""
    bodies = "".join('<body><freejoint/><geom size="0.1"/></body>' for _ in range(1001))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    look = look_of({}, json.loads(geometry_of(model)))
    assert (look.solids, look.links) == ((), ())
    assert look.notes == ("the model has 1002 bodies and 1001 shapes, which are too many to be drawn",)


@settings(max_examples=50)
@given(st.integers(2, 30), st.integers(2, 30), st.integers(0, 500), st.integers(0, 2**31))
def test_fewer_triangles(rows: int, columns: int, most: int, seed: int) -> None:
    """Keep to the number that is asked for, to points within the mesh's bounds, and to triangles of three points."""
    points, triangles = grid(np.random.default_rng(seed).normal(size=(rows, columns)), 2.0, 1.0)
    found = fewer(points, triangles, most)
    if found is None:
        assert most < 112
        return
    assert len(found[1]) <= most or most >= len(triangles)
    assert np.all((found[0] >= points.min(0) - 1e-12) & (found[0] <= points.max(0) + 1e-12))
    assert sorted(set(found[1].ravel().tolist())) == list(range(len(found[0])))
    assert all(len(set(corners)) == 3 for corners in found[1].tolist())


def _ball(rings: int) -> tuple[Any, Any]:
    # a closed surface: rings from pole to pole, whose first and last points coincide
    height, around = np.linspace(0, np.pi, rings), np.arange(rings) * 2 * np.pi / rings
    points = [[np.sin(h) * np.cos(a), np.sin(h) * np.sin(a), np.cos(h)] for h in height[1:-1] for a in around]
    number = np.arange((rings - 2) * rings).reshape(rings - 2, rings)
    north, south = len(points), len(points) + 1
    triangles = [[north, int(a), int(b)] for a, b in zip(number[0], np.roll(number[0], -1), strict=True)]
    triangles += [[south, int(b), int(a)] for a, b in zip(number[-1], np.roll(number[-1], -1), strict=True)]
    for upper, lower in zip(number, number[1:], strict=False):
        for a, b, c, d in zip(upper, lower, np.roll(lower, -1), np.roll(upper, -1), strict=True):
            triangles += [[int(a), int(b), int(c)], [int(a), int(c), int(d)]]
    return np.array([*points, [0, 0, 1], [0, 0, -1]]), np.array(triangles)
